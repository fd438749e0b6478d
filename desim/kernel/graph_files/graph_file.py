"""Graphs in files of many formats, as networkx graphs whose nodes have any names.

The content determines the format: JSON (node-link, adjacency, Cytoscape or graphology), GraphML, GEXF, GML, Pajek,
METIS, an adjacency matrix, or else an edge list. Only adjacency lists and the Trivial Graph Format are known by their
endings, `.adjlist` and `.tgf`.
"""

import json
import re
from collections.abc import Callable, Collection
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from desim.config.number_files import check_comments, content_of, text_of_file
from desim.config.tables import check_once, object_once
from desim.kernel.graph_files.adjacency_matrix import read_matrix
from desim.kernel.graph_files.edge_lists import read_adjacency_list, read_edge_list
from desim.kernel.graph_files.program_formats import read_metis, read_pajek, read_trivial

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    import networkx as nx

FORMATS = (
    "JSON (node-link, adjacency, Cytoscape, graphology), GraphML, GEXF, GML, Pajek, METIS, TGF, an edge list,"
    " an adjacency list or an adjacency matrix"
)
XML = re.compile(rb"(\xef\xbb\xbf|\xff\xfe|\xfe\xff)?\s*\x00?<")
GML = re.compile(r"(\s*#[^\n]*\n|\s*(Creator|Version|Comment)\b[^\n]*\n|\s)*graph\s*\[", re.IGNORECASE)
UNREAD = {
    ".dot": "nx.nx_pydot.read_dot",
    ".gv": "nx.nx_pydot.read_dot",
    ".mtx": "scipy.io.mmread and nx.from_scipy_sparse_array",
    ".g6": "nx.read_graph6",
    ".s6": "nx.read_sparse6",
    ".leda": "nx.read_leda",
    ".npy": "nx.from_numpy_array",
    ".lgl": "igraph.Graph.Read_Lgl(...).to_networkx",
    ".dl": "igraph.Graph.Read_DL(...).to_networkx",
    ".gdf": "a script of yours",
}
"""The functions that read graphs of formats that desim does not read, by the ending of the file."""
METIS = {".metis", ".chaco", ".graph"}
"""The endings of graphs in the format of METIS; an edge list may end in `.graph`, too."""


def read_graph(file: Path, directed: bool | None = None) -> "nx.Graph[Any]":
    """Return the graph in a file; parallel edges are kept, and nodes are in the order of the file.

    Args:
        file: the path; the file may be compressed by gzip.
        directed: whether edges are one-way; only for lists and matrices, which do not state it.

    Raises:
        ValueError: if the file cannot be read, or is not a graph in one of these formats.
    """
    suffixes = [suffix.lower() for suffix in file.suffixes if suffix.lower() != ".gz"]
    ending = suffixes[-1] if suffixes else ""
    if ending in UNREAD:
        raise ValueError(_not_read(file, ending, UNREAD[ending]))
    content = content_of(file)
    if XML.match(content):
        form, read = _xml_reader(file, content)
    else:
        form, read = _text_reader(file, ending, text_of_file(file), directed)
    is_list = form in {"an edge list", "an adjacency list", "an adjacency matrix"}
    if directed is not None and not is_list:
        raise ValueError(
            f"directed is only for edge lists, adjacency lists and matrices: {file} is {form}, which says it"
        )
    try:
        graph = read()
    except Exception as error:  # the readers of networkx raise many types of exception for malformed input
        if is_list:
            raise
        missing = "there is no " if isinstance(error, KeyError) else ""
        raise ValueError(f"{file} is not a graph in {form.removeprefix('a ')}: {missing}{error}") from error
    if is_list and any("latency" in attributes for *_, attributes in graph.edges(data=True)):
        check_comments(text_of_file(file), file, "s")
    return graph


def _not_read(file: Path, form: str, function: str) -> str:
    """Return why a file is refused in a format that a function of Python reads."""
    return (
        f"{file}: {form} is not read; in Python, {function} reads it, and a networkx graph can be the graph of the"
        f" network. Allowed: {FORMATS}"
    )


Reader = Callable[[], "nx.Graph[Any]"]
NODES = "its list of nodes"


def _text_reader(file: Path, ending: str, text: str, directed: bool | None) -> tuple[str, Reader]:
    """Return the name of the format of a text, and its reader."""
    begin = text.lstrip()
    if not begin:
        raise ValueError(f"{file} is not a graph: it is empty")
    if begin[0] in "{[" or ending == ".json":
        return "JSON", lambda: _from_json(text)
    if GML.match(text):
        return "GML", lambda: _from_gml(text)
    if re.match(r"(%[^\n]*\n\s*)*\*", begin):
        return "the format of Pajek", lambda: read_pajek(file, text)
    if ending in {".graphml", ".gexf", ".gml", ".net", ".paj"}:
        raise ValueError(f"{file} is not a graph in {ending[1:]}: it does not begin like one")
    if ending == ".adjlist":
        return "an adjacency list", lambda: read_adjacency_list(file, text, directed)
    if ending == ".tgf":
        return "an edge list", lambda: read_trivial(file, text, directed)
    if begin.lower().startswith("%%matrixmarket"):
        raise ValueError(_not_read(file, "Matrix Market", UNREAD[".mtx"]))
    metis = _metis(file, ending, text)
    if metis is not None:
        return "the format of METIS", lambda: metis
    matrix = read_matrix(file, text, directed)
    if matrix is not None:
        return "an adjacency matrix", lambda: matrix
    return "an edge list", lambda: read_edge_list(file, text, directed)


def _metis(file: Path, ending: str, text: str) -> "nx.Graph[Any] | None":
    """Return the graph in the format of METIS; None if the text is a list of edges.

    Raises:
        ValueError: if the ending is one of METIS, and the text begins like a graph of METIS but is invalid; or if the
            ending belongs to METIS alone, and the text does not begin like one.
    """
    try:
        graph = read_metis(file, text)
    except ValueError as error:
        if ending in METIS:
            hint = "; if it is an edge list, its ending should be .edgelist" if ending == ".graph" else ""
            raise ValueError(f"{error} (as a graph of METIS{hint})") from error
        return None
    if graph is None and ending in METIS - {".graph"}:
        raise ValueError(f"{file} is not a graph of METIS: its first line should have the number of the lines below")
    # Without edges, it is more probably a list: the line `1 0` is an edge in a list, and one node in METIS.
    return graph if ending in METIS or (graph is not None and graph.number_of_edges()) else None


# JSON


def _from_json(text: str) -> "nx.Graph[Any]":
    """Return the graph in JSON in a form that networkx writes."""
    import networkx as nx

    data = json.loads(text, object_pairs_hook=object_once)
    if isinstance(data, list) and data and all(isinstance(item, dict) and "data" in item for item in data):
        data = {"elements": data}  # of cytoscape.js, too
    if not isinstance(data, dict):
        raise ValueError("it should be an object with nodes and edges")
    if "elements" in data:
        return _from_cytoscape(data)
    if "adjacency" in data and "nodes" in data:
        check_once((node["id"] for node in data["nodes"]), NODES)
        _check_ends({node["id"] for node in data["nodes"]}, (edge["id"] for row in data["adjacency"] for edge in row))
        return nx.adjacency_graph(data)
    if data.get("edges") and data.get("links"):
        raise ValueError("it should have edges or links, and has both")
    key = "edges" if "edges" in data else "links"  # networkx before 3.4 writes "links"
    if key not in data or "nodes" not in data:
        raise ValueError("it should have nodes, and edges or links (node-link), adjacency, or elements (Cytoscape)")
    for part in ("nodes", key):
        if not (isinstance(data[part], list) and all(isinstance(element, dict) for element in data[part])):
            raise ValueError(f"its {part} should be a list of objects")
    if data["nodes"] and all("key" in node and "id" not in node for node in data["nodes"]):
        data = _of_graphology(data)
        key = "edges"
    names = [_hashable(node.get("id", k)) for k, node in enumerate(data["nodes"])]
    check_once(names, NODES)
    _check_ends(set(names), (_hashable(edge[end]) for edge in data[key] for end in ("source", "target")))
    return nx.node_link_graph({**data, "multigraph": True}, edges=key)  # keeps parallel edges


def _of_graphology(data: dict[str, Any]) -> dict[str, Any]:
    """Return a graph of graphology (sigma.js, Gephi), whose nodes have keys and attributes, in node-link form."""
    kind = data.get("options", {}).get("type", "mixed")
    are_one_way = {not edge.get("undirected", kind == "undirected") for edge in data["edges"]}
    if len(are_one_way) > 1:
        raise ValueError("it has directed and undirected edges: all should be of one type")
    nodes = [{"id": node["key"], **node.get("attributes", {})} for node in data["nodes"]]
    edges = [
        {"source": edge["source"], "target": edge["target"], **edge.get("attributes", {})} for edge in data["edges"]
    ]
    return {"directed": True in are_one_way, "nodes": nodes, "edges": edges}


def _from_cytoscape(data: dict[str, Any]) -> "nx.Graph[Any]":
    """Return a graph in JSON of Cytoscape; its nodes are named by `value`, as networkx writes them, or by `id`."""
    import networkx as nx

    elements = data["elements"]
    if isinstance(elements, list):  # of cytoscape.js
        edges = [element for element in elements if "source" in element["data"]]
        elements = {"nodes": [element for element in elements if element not in edges], "edges": edges}
    nodes = [node["data"] for node in elements.get("nodes", ())]
    names = {str(node["id"]): _hashable(node.get("value", node["id"])) for node in nodes}
    check_once((str(node["id"]) for node in nodes), NODES)
    graph: nx.Graph[Any] = nx.MultiDiGraph() if data.get("directed") else nx.MultiGraph()
    for node in nodes:
        attributes = {key: value for key, value in node.items() if key not in {"id", "value"}}
        graph.add_node(names[str(node["id"])], **attributes)
    edges = [edge["data"] for edge in elements.get("edges", ())]
    _check_ends(names, (str(edge[end]) for edge in edges for end in ("source", "target")))
    for edge in edges:
        attributes = {key: value for key, value in edge.items() if key not in {"source", "target", "id", "key"}}
        graph.add_edge(names[str(edge["source"])], names[str(edge["target"])], **attributes)
    return graph


def _hashable(name: Any) -> Any:
    """Return the name of a node as networkx reads it: a list becomes a tuple."""
    return tuple(map(_hashable, name)) if isinstance(name, list) else name


def _check_ends(nodes: Collection[Any], ends: Any) -> None:
    """Raise ValueError if an end of an edge is not a declared node; networkx would add it."""
    for end in ends:
        if end not in nodes:
            raise ValueError(f"an edge ends at node {end!r}, which is not declared")


# XML and GML


def _xml_reader(file: Path, content: bytes) -> tuple[str, Reader]:
    """Return the name of the format of an XML file, and its reader."""
    from xml.etree.ElementTree import ParseError, fromstring

    try:
        _check_plain(content)
        root = fromstring(content)
    except (ValueError, ParseError) as error:
        raise ValueError(f"{file} is not a graph in GraphML or GEXF: {error}") from error
    except Exception as error:  # of expat
        raise ValueError(f"{file} is not a graph in GraphML or GEXF: it is not valid XML: {error}") from error
    tag = root.tag.rpartition("}")[2]
    if tag == "graphml":
        return "GraphML", lambda: _from_graphml(root, content)
    if tag == "gexf":
        return "GEXF", lambda: _from_gexf(root, content)
    raise ValueError(f"{file} is not a graph in GraphML or GEXF: its first element is <{tag}>")


def _check_plain(xml: bytes) -> None:
    """Raise ValueError if XML declares a document type, whose entities could expand to any amount of text."""
    from xml.parsers.expat import ParserCreate

    def refuse(*_: object) -> None:
        raise ValueError("it should declare no document type (<!DOCTYPE ...>)")

    parser = ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(xml, True)


def _from_graphml(root: "Element", content: bytes) -> "nx.Graph[Any]":
    import networkx as nx

    graphs = root.findall(".//{*}graph")
    if len(graphs) != 1:
        raise ValueError(f"it should have one graph, and has {len(graphs)}, with those inside of nodes")
    for key in root.iterfind(".//{*}key"):
        if key.get("for", "all") == "all" and key.find("{*}default") is not None:
            raise ValueError(f"the key {key.get('id')!r} with a default should be for edge or for node, not for all")
    names = {key.get("id"): key.get("attr.name") or key.get("id") for key in root.iterfind(".//{*}key")}
    for element in _elements(graphs[0]):
        check_once((names.get(data.get("key")) for data in element.findall("{*}data")), _name_of(element))
    return _with_defaults(_quietly(lambda: nx.read_graphml(BytesIO(content))))


def _from_gexf(root: "Element", content: bytes) -> "nx.Graph[Any]":
    import networkx as nx

    graph = root.find("{*}graph")
    if graph is None:
        raise ValueError("it has no graph")
    if graph.get("mode") == "dynamic":
        raise ValueError("a graph that changes in time (mode dynamic) is not read")
    titles: dict[tuple[str | None, str | None], str | None] = {}
    for attributes in graph.iterfind("{*}attributes"):
        for attribute in attributes.iterfind("{*}attribute"):
            titles[attributes.get("class"), attribute.get("id")] = attribute.get("title")
    for element in _elements(graph):
        kind = element.tag.rpartition("}")[2]
        values = element.findall("{*}attvalues/{*}attvalue")
        check_once((titles.get((kind, value.get("for") or value.get("id"))) for value in values), _name_of(element))
    content = content.replace(b"http://www.gexf.net/1.3", b"http://gexf.net/1.3")  # the name that networkx knows
    return _with_defaults(_quietly(lambda: nx.read_gexf(BytesIO(content))))


def _elements(graph: "Element") -> list["Element"]:
    """Return the nodes and the edges of a graph.

    Raises:
        ValueError: if a node is declared twice, or an edge ends at a node that is not declared.
    """
    nodes, edges = graph.findall(".//{*}node"), graph.findall(".//{*}edge")
    names = [node.get("id") for node in nodes]
    check_once(names, NODES)
    _check_ends(set(names), (edge.get(end) for edge in edges for end in ("source", "target")))
    return [*nodes, *edges]


def _name_of(element: "Element") -> str:
    """Return what a node or an edge is called in an error message."""
    if source := element.get("source"):
        return f"the edge from {source} to {element.get('target')}"
    return f"node {element.get('id')}"


def _with_defaults(graph: "nx.Graph[Any]") -> "nx.Graph[Any]":
    """Give the edges the default attributes of a file, which networkx keeps for itself."""
    defaults = graph.graph.pop("edge_default", {})
    for *_, attributes in graph.edges(data=True):
        for name, value in defaults.items():
            attributes.setdefault(name, value)
    graph.graph.pop("node_default", None)
    return graph


def _quietly(read: Reader) -> "nx.Graph[Any]":
    """Return what a reader of networkx returns, without its warnings about parts that have no effect in desim."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read()


def _from_gml(text: str) -> "nx.Graph[Any]":
    """Return the graph in GML; its nodes are named by their labels, if all have different ones, or by their ids."""
    import networkx as nx

    if not re.search(r"^\s*multigraph\s+\d", text, re.MULTILINE):  # without it, networkx refuses parallel edges
        text = re.sub(r"\bgraph\s*\[", "graph [ multigraph 1 ", text, count=1, flags=re.IGNORECASE)
    graph: nx.Graph[Any] = nx.parse_gml(text, label=None)  # type: ignore[call-overload]
    labels = {node: attributes.get("label") for node, attributes in graph.nodes(data=True)}
    if None in labels.values() or len(set(map(str, labels.values()))) < len(labels):
        return graph
    relabelled: nx.Graph[Any] = nx.relabel_nodes(graph, labels)
    for _, attributes in relabelled.nodes(data=True):
        del attributes["label"]
    return relabelled
