"""Communication graphs from files: GraphML, GML, GEXF, JSON and edge lists, with the names and attributes they contain.

A new format is one entry in `graph_file`. What a file says of an edge becomes a link model in
`desim.kernel.models.graphs`; `graph_attributes` names what is not read.
"""
