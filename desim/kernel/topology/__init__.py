"""Which nodes are linked at an instant: the graph, the range check of moving nodes, and the search for close nodes.

The topology is read at every transmission: measure the benchmarks of moving nodes before and after a change.
"""
