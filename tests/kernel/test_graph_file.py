"""Graphs in files: any graph comes back from every format, and what a file cannot mean is refused or told."""

import gzip
import json
import re
import warnings as python_warnings
from contextlib import nullcontext
from pathlib import Path

import networkx as nx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from desim.config.column_names import LINK_END_WORDS, LINK_ENDS
from desim.kernel.models.graphs import Edges
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.scenario.checks import warnings
from desim.scenario.scenario import Scenario, Team
from desim.scenario.toml import load

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*edges have attributes that are not read", "ignore:.*all edges are one-way"
)


def as_json(data_of):
    return lambda graph, file: Path(file).write_text(json.dumps(data_of(graph)))


def write_table(mark):
    def write(graph, file):
        names = list(dict.fromkeys(name for *_, own in graph.edges(data=True) for name in own))
        rows = [[src, dst, *(own.get(name, "") for name in names)] for src, dst, own in graph.edges(data=True)]
        lines = [mark.join(map(str, row)) for row in [["Source", "Target", *names], *rows]]
        Path(file).write_text("\n".join(lines) + "\n")

    return write


def write_list(of):
    def write(graph, file):
        of(graph, file, comments="#")

    return write


def replaced(write, graph, file):
    """Write a table with decimal commas."""
    write(graph, file)
    Path(file).write_text(Path(file).read_text().replace(".", ","))


WRITERS = {
    "node_link.json": as_json(lambda graph: nx.node_link_data(graph, edges="edges")),
    "links.json": as_json(lambda graph: nx.node_link_data(graph, edges="links")),
    "adjacency.json": as_json(nx.adjacency_data),
    "cytoscape.json": as_json(nx.cytoscape_data),
    "net.graphml": nx.write_graphml,
    "net.GraphML": nx.write_graphml,
    "net.XML": nx.write_graphml,
    "net.gexf": nx.write_gexf,
    "net.gml": nx.write_gml,
    "net.edgelist": write_list(nx.write_edgelist),
    "net.csv": write_table(","),
    "semicolons.csv": write_table(";"),
    "commas.csv": lambda graph, file: replaced(write_table(";"), graph, file),
    "net.tsv": write_table("\t"),
    "net.net": nx.write_pajek,
    "net.adjlist": write_list(nx.write_adjlist),
}
WITHOUT_ATTRIBUTES = {"net.net", "net.adjlist"}
LISTS = {"net.edgelist", "net.csv", "semicolons.csv", "commas.csv", "net.tsv", "net.adjlist"}
"""The formats that do not say whether edges are one-way."""
EDGES_ONLY = LISTS - {"net.adjlist"}
"""The formats that have no nodes without edges."""
ATTRIBUTED = sorted(set(WRITERS) - WITHOUT_ATTRIBUTES)


def written(graph, folder, kind):
    """Write a graph, and return the path."""
    file = folder / kind
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore")  # of Pajek, about attributes
        WRITERS[kind](graph, file)
    return file


def read(file, directed=None):
    beside = {} if directed is None else {"directed": directed}
    return Edges.model_validate({"file": file.name} | beside, context={"folder": file.parent})


def links(edges):
    """Return the edges by the names of their ends, with latency and loss."""
    names = edges.names or [*map(str, range(edges.nodes))]
    return {
        (names[edge.src], names[edge.dst]): (edge.latency and edge.latency.value, edge.loss and edge.loss.p)
        for edge in edges.edges
    }


def expected(graph, kind):
    own = {} if kind in WITHOUT_ATTRIBUTES else {ends: graph.edges[ends] for ends in graph.edges}
    return {
        tuple(map(str, ends)): (own.get(ends, {}).get("latency"), own.get(ends, {}).get("loss")) for ends in graph.edges
    }


def undirected(found):
    return {frozenset(ends): value for ends, value in found.items()}


@st.composite
def graphs(draw):
    """Draw a graph with an edge: the nodes are 0 .. n - 1 in any order, or have names."""
    size = draw(st.integers(2, 6))
    names = draw(st.permutations(range(size)) | st.permutations(["uav", "n0", "b", "n1", "a7", "base"][:size]))
    graph = nx.DiGraph() if draw(st.booleans()) else nx.Graph()
    graph.add_nodes_from(names)
    numbers = st.floats(0.0, 1.0).map(lambda number: round(number, 4))
    for k in range(1, size):  # a tree, so that every node has an edge
        own = draw(st.fixed_dictionaries({}, optional={"latency": numbers, "loss": numbers}))
        graph.add_edge(names[k], names[draw(st.integers(0, k - 1))], **own)
    return graph


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize("kind", WRITERS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(graph=graphs())
def test_any_graph_comes_back_from_every_format(tmp_path, kind, graph):
    """With its names or its numbers, its direction and the attributes that the format has."""
    edges = read(written(graph, tmp_path, kind), graph.is_directed() if kind in LISTS else None)
    assert edges.directed == graph.is_directed()
    assert edges.nodes == len(graph)
    found, right = links(edges), expected(graph, kind)
    assert (found == right) if graph.is_directed() else (undirected(found) == undirected(right))
    if kind not in LISTS:  # lists have the order in which edges name the nodes
        in_order = isinstance(next(iter(graph)), str)
        assert edges.names == (tuple(graph) if in_order else ())
    assert Edges.model_validate(edges.plain()) == edges


@pytest.mark.parametrize("kind", ["node_link.json", "links.json"])
def test_nodes_that_are_tuples_come_back_from_json_which_has_lists(tmp_path, kind):
    graph = nx.grid_2d_graph(2, 2)
    edges = read(written(graph, tmp_path, kind))
    assert edges.names == tuple(map(str, graph))
    assert undirected(links(edges)) == undirected(expected(graph, kind))


@pytest.mark.slow
@settings(max_examples=30)
@given(graph=graphs())
def test_a_networkx_graph_is_the_graph_of_a_network_with_its_names(graph):
    edges = Links(graph=graph).graph
    found, right = links(edges), expected(graph, "of")
    assert (found == right) if graph.is_directed() else (undirected(found) == undirected(right))
    assert edges == Edges.of(graph)


def plain(folder, kind, **attributes):
    """Write the path from 0 to 2 with attributes of the first edge."""
    graph = nx.path_graph(3)
    graph.edges[0, 1].update(attributes)
    return written(graph, folder, kind)


CONTAINERS = {
    "gzip": lambda content: gzip.compress(content),
    "two members": lambda content: gzip.compress(content[:20]) + gzip.compress(content[20:]),
    "BOM": lambda content: b"\xef\xbb\xbf" + content,
    "CRLF": lambda content: content.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"),
    "UTF-16": lambda content: content.decode().replace("encoding='utf-8'", "").encode("utf-16"),
}


@pytest.mark.parametrize("container", CONTAINERS)
@pytest.mark.parametrize("kind", WRITERS)
def test_compression_byte_order_marks_and_line_ends_make_no_difference(tmp_path, kind, container):
    file = plain(tmp_path, kind)
    right = read(file)
    file.write_bytes(CONTAINERS[container](file.read_bytes()))
    assert read(file) == right
    assert links(right).keys() == {("0", "1"), ("1", "2")}


def told(file, **table):
    """Return the warnings about the graph of a network."""
    graph = Edges.model_validate({"file": file.name}, context={"folder": file.parent})
    scenario = Scenario(team=Team(count=3), network=Links(graph=graph), **table)
    return [why for key, why in warnings(scenario) if key == "network.graph"]


UNREAD = {
    "delay": (0.2, r"delay \(did you mean latency, in s\?\)"),
    "packetloss": (0.5, r"packetloss \(did you mean loss, from 0 to 1\?\)"),
    "packet_loss": (0.5, r"packet_loss \(did you mean loss, from 0 to 1\?\)"),
    "latency_ms": (5.0, r"latency_ms \(did you mean latency, in s\?\)"),
    "Latency": (5.0, r"Latency \(did you mean latency, in s\?\)"),
    "latncy": (5.0, r"latncy \(did you mean 'latency'\?\)"),
    "jitter": (0.1, r"jitter \(did you mean a latency with a kind"),
    "bandwidth": (100.0, r"bandwidth \(did you mean network\.medium"),
    "weight": (2.0, r"not read: weight;"),
    "mood": (2.0, r"not read: mood;"),
}


@pytest.mark.slow_but_one
@pytest.mark.parametrize("name", UNREAD)
@pytest.mark.parametrize("kind", ATTRIBUTED)
def test_an_attribute_that_is_not_read_is_named(tmp_path, kind, name):
    value, text = UNREAD[name]
    (why,) = told(plain(tmp_path, kind, **{name: value}))
    assert re.search(text, why)
    assert told(plain(tmp_path, kind, latency=0.01)) == []


NAMES_OF_ATTRIBUTES = {
    "latency, in s": "delay linkdelay propagationdelay lat ping LATENCY Link_Delay latency_ms delay(us) ping[ns]",
    "twice the latency, in s": "rtt roundtriptime round-trip-time rtt_s",
    "loss, from 0 to 1": "packetloss packetlossrate packetlossratio lossrate lossratio lossprobability plr per droprate"
    " dropprobability packeterrorrate errorrate loss_percent packet-loss[%] loss_pct",
    "1 - loss": "prr pdr reliability deliveryratio receptionratio PRR_%",
    "a latency with a kind, such as uniform": "jitter delayvariation jitter_sec",
    "network.medium, one for all links": "bandwidth bitrate datarate capacity throughput rate rate_bps bitrate_kbps"
    " bandwidth(Mbps) rate[Gbps]",
}
DRAWINGS = "id key label name color colour shape shape_type size viz graphics style description url pid parents Color"
DRAWINGS += " thickness interaction selected weight_label"
PLACES = "pos position x y z lat latitude lon lng long longitude coordinates X"


def notes_of(name, *, of_node=False):
    """Return the notes about a graph of which a node or an edge has an attribute of a name.

    Those about an edge are given as warnings, too, because a run in Python prints no notes.
    """
    graph = nx.path_graph(2)
    (graph.nodes[0] if of_node else graph.edges[0, 1])[name] = 0.5
    with python_warnings.catch_warnings(record=True) as caught:
        python_warnings.simplefilter("always")
        notes = Edges.of(graph).notes
    assert [str(warning.message) for warning in caught] == ([] if of_node else [*notes])
    return notes


@pytest.mark.parametrize("meaning", NAMES_OF_ATTRIBUTES)
def test_what_an_attribute_of_an_edge_may_mean_is_told(meaning):
    for name in NAMES_OF_ATTRIBUTES[meaning].split():
        (note,) = notes_of(name)
        assert note.startswith(f"edges have attributes that are not read: {name} (did you mean {meaning}?);")


def test_attributes_that_draw_a_graph_are_not_told_and_places_are():
    for name in DRAWINGS.split():
        assert notes_of(name) == notes_of(name, of_node=True) == ()
    for name in PLACES.split():
        (note,) = notes_of(name, of_node=True)
        assert f"not read: {name} (team.positions has initial positions, in m);" in note


OTHER_FORMATS = {
    "dot": "nx.nx_pydot.read_dot",
    "gv": "nx.nx_pydot.read_dot",
    "mtx": "scipy.io.mmread and nx.from_scipy_sparse_array",
    "g6": "nx.read_graph6",
    "s6": "nx.read_sparse6",
    "leda": "nx.read_leda",
    "npy": "nx.from_numpy_array",
    "lgl": "igraph.Graph.Read_Lgl(...).to_networkx",
    "gdf": "a script of yours",
}


@pytest.mark.parametrize("ending", OTHER_FORMATS)
def test_what_reads_another_format_is_told(tmp_path, ending):
    (tmp_path / f"net.{ending}").write_text("0 1\n")
    with pytest.raises(
        ValueError, match=rf"\.{ending} is not read; in Python, {re.escape(OTHER_FORMATS[ending])} reads it"
    ):
        read(tmp_path / f"net.{ending}")


@pytest.mark.parametrize("kind", ATTRIBUTED)
def test_milliseconds_are_noticed_and_other_texts_are_refused(tmp_path, kind):
    """50 as a latency in s is longer than the horizon; 10 ms is 0.01 s, and 10 km and 0.2 as texts are no numbers."""
    (why,) = told(plain(tmp_path, kind, latency=50.0), horizon=3.0)
    assert why == "the mean latency of an edge of 50 s is not less than the horizon of 3 s: times are in s, not ms"
    latencies = {edge.latency for edge in read(plain(tmp_path, kind, latency="10 ms")).edges}
    assert latencies - {None} == {Constant(value=0.01)}
    with pytest.raises(ValueError, match="10 km"):
        read(plain(tmp_path, kind, latency="10 km"))
    if kind not in EDGES_ONLY - {"net.edgelist"}:  # tables declare no types
        with pytest.raises(ValueError, match=r"should be a number: 0\.2 instead of the text '0\.2'"):
            read(plain(tmp_path, kind, loss="0.2"))


LAST_END = {
    "node_link.json": '"target": 2',
    "links.json": '"target": 2',
    "adjacency.json": '"id": 2}], [',
    "cytoscape.json": '"target": 2',
    "net.graphml": 'target="2"',
    "net.gexf": 'target="2"',
    "net.gml": "target 2",
    "net.net": "2 3",
}
"""The end of the last edge in the file of a path of three nodes."""


@pytest.mark.parametrize("kind", LAST_END)
def test_an_edge_to_a_node_that_is_not_declared_and_half_a_file_are_refused(tmp_path, kind):
    file = plain(tmp_path, kind)
    content, end = file.read_text(), LAST_END[kind]
    file.write_text(content.replace(end, end.replace("2" if "3" not in end else "3", "7")))
    assert file.read_text() != content
    with pytest.raises(ValueError, match=r"an edge ends at node '?7'?, which is not declared|undefined|should be two"):
        read(file)
    file.write_text(content[: len(content) // 2 if kind != "net.net" else content.rindex("2 3") + 2])
    with pytest.raises(ValueError, match="is not a graph in"):
        read(file)


NO_GRAPHS = {
    "empty.json": ("", "is not a graph: it is empty"),
    "empty.csv": ("\n", "is not a graph: it is empty"),
    "list.json": ("[]", "is not a graph in JSON: it should be an object with nodes and edges"),
    "number.json": ("7", "it should be an object with nodes and edges"),
    "nodes.json": ('{"nodes": []}', r"it should have nodes, and edges or links \(node-link\), adjacency, or elements"),
    "texts.json": ('{"nodes": ["a"], "links": []}', "its nodes should be a list of objects"),
    "ends.json": ('{"nodes": [{"id": 0}], "links": [{"source": 0}]}', "there is no 'target'"),
    "twice.json": ('{"nodes": [{"id": 0}, {"id": 0}], "links": []}', "its list of nodes has 0 twice"),
    "cut.graphml": ("<graphml>", "is not a graph in GraphML or GEXF: it is not valid XML"),
    "page.graphml": ('<?xml version="1.0"?><html/>', "its first element is <html>"),
    "json.graphml": ("nodes", "is not a graph in graphml: it does not begin like one"),
    "bomb.graphml": ('<!DOCTYPE g [<!ENTITY a "b">]><graphml/>', "should declare no document type"),
    "bomb.gexf": ('<!DOCTYPE g [<!ENTITY a "b">]><gexf/>', "should declare no document type"),
    "time.gexf": ('<gexf><graph mode="dynamic"/></gexf>', "a graph that changes in time"),
    "net.dot": ("graph { 0 -- 1 }", r"\.dot is not read; in Python, nx\.nx_pydot\.read_dot reads it"),
    "both.net": ("*Vertices 3\n*Arcs\n1 2\n*Edges\n2 3\n", "has edges and arcs"),
    "list.net": ("*Vertices 3\n*Arcslist\n1 2 3\n", r"line 2: \*Arcslist is not read"),
    "three.csv": ("0,1,2,3\n", "line 1: should have two nodes; attributes need a first line that names the columns"),
    "adjacency.txt": ("0 1 2\n1 2\n", "an adjacency list needs the ending .adjlist"),
    "ragged.csv": ("source,target,loss\n0,1\n", "line 2: should have 3 columns, has 2"),
    "commas.txt": ("source target loss\n0 1 0,5\n", "line 2: loss: '0,5' is not a number; the decimal sign is a point"),
    "signs.csv": ("source;target;loss\n0;1;0,5\n1;2;0.5\n", "either decimal points or decimal commas"),
    "columns.csv": ("a,b\n", "line 1: a, b are the names of columns, and no edge follows; if they are an edge, write"),
    "unit.csv": ("source,target,latency\n0,1,10 km\n", "line 2: latency: '10 km' is not a number"),
    "mixed.csv": ("Source,Target,Type\n0,1,Directed\n1,2,Undirected\n", "has directed and undirected edges"),
    "parallel.csv": ("source,target,loss\n0,1,0\n0,1,1\n", "edges 0 and 1 are parallel: both join nodes 0 and 1"),
    "nodes.csv": ("Id,Label\na,a\nb,b\n", "line 1: Id, Label are the columns of a table of nodes"),
    **{
        f"{name}.csv": (f"{name},x\na,a\nb,b\n", f"line 1: {name}, x are the columns of a table of nodes")
        for name in ("id", "Node", "name", "LABEL", "node_id", "NodeId", "vertex")
    },
    "numbers.csv": ("Id;Label\n1;\n2;base\n", "line 1: Id, Label are the columns of a table of nodes"),
    "title.brite": (
        "Topology: ( 2 Nodes, 1 Edges )\nNodes: ( 2 )\n",
        r"line 2: 'Nodes: \( 2 \)' is no edge, and no name",
    ),
    "behind.txt": ("a1,b2 1 0\nb2,a1 2 0\n", "line 1: 'b2 1 0' has several words, and 'a1' has one"),
    "map.cch": ("1 @A\t(1) -> <2>\n2 @B\t(1) -> <1>\n3 @C\t(0)\n", "line 1: hardly a name is in two lines"),
    "arrow.csv": ("0,1,0,0\n0,0,1,0\n0,0,0,1\n1,0,0,0\n", "is a matrix that is not symmetric: set directed = true"),
    "header.csv": ("0,1,2,3\n1,0,1,1\n2,1,0,1\n3,1,1,0\n", "the first line may number the nodes"),
    "mixed.json": (
        '{"options": {"type": "mixed"}, "nodes": [{"key": "a"}, {"key": "b"}], "edges":'
        ' [{"source": "a", "target": "b"}, {"source": "b", "target": "a", "undirected": true}]}',
        "it has directed and undirected edges",
    ),
    "some.txt": ("0 1\n1 0\n1 2\n", "has 1 of its edges in both directions and the others in one: set directed = true"),
    "cut.metis": ("4 2\n2\n1 3\n", "its first line should have the number of the lines below"),
    "once.graph": ("3 2\n2\n3\n\n", "the edge between the nodes 1 and 2 should be in both lines .*graph of METIS; if"),
    "count.metis": ("2 2\n2\n1\n", "line 1: says 2 edges, but has 1"),
    "fewer.metis": ("2 0\n2\n1\n", "line 1: says 0 edges, but has 1"),
    "far.metis": ("2 1\n2\n3\n", "line 3: 3 is no other node from 1 to 2, or is there twice"),
    "word.metis": ("2 1\nb\n1\n", "line 2: should have the numbers of the neighbours of node 1"),
    "unclear.csv": (
        ",2,0,1\n2,,1,0\n0,1,,1\n1,0,1,\n",
        "unclear.csv: 2, 0, 1 may be the names of the nodes, or numbers",
    ),
    "market.txt": ("%%MatrixMarket matrix coordinate\n2 2 1\n1 2 1\n", "Matrix Market is not read; in Python, scipy"),
    "labels.tgf": ("1 a\n2 b\n", "should have a line # between nodes and edges"),
    "far.tgf": ("1 a\n2 b\n#\n1 3\n", "line 4: should be two of the nodes above the line #"),
    "as_rel.txt": ("1|2|-1\n2|3|0\n", "line 1: '1.2.-1' is no edge, and none follows"),
    "dict.edgelist": ("0 1 {'latency': f()}\n", r"line 1: the attributes should be like \{'latency': 0\.1\}"),
    "far.net": ('*Vertices 2\n3 "c"\n', "line 2: there is no vertex 3: they are 1 .. 2"),
    "early.net": ("*Network a\n1 2\n", r"line 2: should begin with \*Vertices"),
    "inside.graphml": (
        "<graphml><graph><node id='0'><graph/></node></graph></graphml>",
        "should have one graph, and has 2, with those inside of nodes",
    ),
    "all.graphml": (
        '<graphml><key id="d0" for="all"><default>1</default></key><graph edgedefault="directed"/></graphml>',
        "the key 'd0' with a default should be for edge or for node, not for all",
    ),
    "none.gexf": ("<gexf/>", "it has no graph"),
}


@pytest.mark.parametrize("name", NO_GRAPHS)
def test_a_file_that_is_no_graph_is_refused_with_the_reason(tmp_path, name):
    text, why = NO_GRAPHS[name]
    with pytest.raises(ValueError, match=rf"{name} cannot be read: No such file|\.dot is not read"):
        read(tmp_path / name)
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=why):
        read(tmp_path / name)


def test_a_cut_or_huge_gzip_file_is_refused(tmp_path, monkeypatch):
    file = tmp_path / "net.json.gz"
    file.write_bytes(gzip.compress(b" " * 1000)[:-4])
    with pytest.raises(ValueError, match="its end is missing"):
        read(file)
    content = gzip.compress(b" " * 1000)
    file.write_bytes(content[:-8] + bytes([content[-8] ^ 1]) + content[-7:])  # another checksum
    with pytest.raises(ValueError, match=r"is not valid gzip: .*CRC check failed"):
        read(file)
    monkeypatch.setattr("desim.config.number_files.MAX_UNPACKED", 999)
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"is larger than .* when it is decompressed"):
        read(file)


GRAPHML = """<graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<key id="d0" for="edge" attr.name="latency" attr.type="double"><default>0.5</default></key>
<key id="d1" for="node" attr.name="label" attr.type="string"/>
<graph edgedefault="directed">
<node id="n0"><data key="d1">{}</data></node><node id="n1"><data key="d1">{}</data></node>
<edge source="n0" target="n1"/><edge source="n1" target="n0"><data key="d0">0.1</data></edge>
</graph></graphml>"""


@pytest.mark.parametrize(
    ("labels", "names", "first"),
    [(("Ada", "Bo"), ("Ada", "Bo"), (0, 1)), (("1", "0"), (), (1, 0)), (("x", "x"), ("n0", "n1"), (0, 1))],
)
def test_default_attributes_count_and_labels_name_the_nodes(tmp_path, labels, names, first):
    """A default of GraphML is not an attribute in networkx. Labels that are 0 .. n - 1 are the numbers."""
    (tmp_path / "net.graphml").write_text(GRAPHML.format(*labels))
    edges = read(tmp_path / "net.graphml")
    assert edges.names == names
    found = {(edge.src, edge.dst): edge.latency for edge in edges.edges}
    assert found == {first: Constant(value=0.5), first[::-1]: Constant(value=0.1)}


def test_names_that_contradict_the_labels_are_refused(tmp_path):
    nodes = [{"id": 0, "label": "1"}, {"id": 1, "label": "0"}]
    (tmp_path / "net.json").write_text(json.dumps({"nodes": nodes, "links": [{"source": 0, "target": 1}]}))
    with pytest.raises(ValueError, match=r"net\.json: node 0 has the label '1', so that its number is not clear"):
        read(tmp_path / "net.json")


def test_other_integers_are_numbered_in_ascending_order_and_this_is_told(tmp_path):
    (tmp_path / "net.txt").write_text("7 3\n3 5\n")
    edges = read(tmp_path / "net.txt")
    assert edges.names == ("3", "5", "7")
    assert [(edge.src, edge.dst) for edge in edges.edges] == [(2, 0), (0, 1)]
    assert edges.notes == ("its nodes have the numbers 3 .. 7, and here 0 .. 2, in the same order (`names`)",)
    with pytest.raises(ValueError, match="the graph has 3 nodes, the network 4"):
        edges(4)


def test_lists_may_be_directed_and_no_other_format_may_be_told_to_be(tmp_path):
    (tmp_path / "net.txt").write_text("# a comment\n0 1\n1 0\n1 2\n3\n")
    assert len(read(tmp_path / "net.txt", directed=True).edges) == 3
    edges = read(tmp_path / "net.txt", directed=False)
    assert (len(edges.edges), edges.nodes) == (2, 4)
    with pytest.raises(ValueError, match=r"directed is only for edge lists, .* and matrices: .* is JSON"):
        read(plain(tmp_path, "node_link.json"), directed=True)


@pytest.mark.parametrize(("type_of_edges", "directed"), [("Directed", True), ("undirected", False)])
def test_a_column_of_types_says_whether_a_list_is_directed(tmp_path, type_of_edges, directed):
    """The only edge that is listed leads one way, or both."""
    file = tmp_path / "net.csv"
    file.write_text(f"Source,Target,Type\n0,1,{type_of_edges}\n")
    graph = read(file)(2)
    assert [graph.has_edge(0, 1), graph.has_edge(1, 0)] == [True, not directed]
    with pytest.raises(ValueError, match=rf"a column Type, which says {type_of_edges.lower()}: leave out directed"):
        read(file, directed=not directed)


SAME = {
    "names of columns in a comment": ("net.txt", "% of the lab\n# from to latency\n0 1 0.5\n"),
    "blank lines before the numbers of METIS": ("net.metis", "\n \n% a comment\n2 1\n2\n1\n"),
    "names and values in Pajek": ("net.net", "*Vertices 2\n*Edges\n1 2 1 latency 0.5 c Blue\n"),
    "a list of elements, as in cytoscape.js": (
        "net.json",
        '{"elements": [{"data": {"source": 0, "target": 1, "latency": 0.5}}, {"data":{"id": 0}}, {"data": {"id": 1}}]}',
    ),
    "a latency with its unit, as in Shadow": (
        "net.gml",
        'graph [ node [ id 0 ] node [ id 1 ] edge [ source 0 target 1 latency "500 ms" ] ]',
    ),
    "a latency with its unit in a list": ("net.csv", "source,target,latency\n0,1,500000us\n"),
    "GML without labels": ("net.gml", "graph [ node [ id 0 ] node [ id 1 ] edge [ source 0 target 1 latency 0.5 ] ]"),
}


@pytest.mark.parametrize(("name", "text"), SAME.values(), ids=SAME)
def test_an_edge_of_half_a_second_may_be_written_in_rarer_forms(tmp_path, name, text):
    """METIS has no attributes, and numbers nodes from 1, as Pajek does."""
    (tmp_path / name).write_text(text)
    edges = read(tmp_path / name)
    assert edges.nodes == 2
    assert [(edge.src, edge.dst) for edge in edges.edges] == [(0, 1)]
    assert edges.edges[0].latency == (None if name == "net.metis" else Constant(value=0.5))


def test_attributes_of_nodes_of_the_graph_and_of_functions_are_named():
    graph = nx.path_graph(3)
    graph.graph.update(delay=0.1, name="a graph")
    graph.nodes[0].update(pos=(1, 2), label="a", speed=3)
    with pytest.warns(UserWarning, match=r"^the graph has attributes that are not read: delay"):
        edges = Edges.of(graph)
    assert edges.notes == (
        "nodes have attributes that are not read: pos (team.positions has initial positions, in m), speed; no attribute"
        " of a node is read",
        "the graph has attributes that are not read: delay (did you mean latency, in s?); give them to its edges",
    )

    def function(size):
        made = nx.path_graph(size)
        made.edges[0, 1].update(packetloss=0.5, latency=9.0)
        return made

    scenario = Scenario(team=Team(count=3), network=Links(graph=function), horizon=10.0)
    found = [why for key, why in warnings(scenario) if key == "network.graph"]
    assert [why.split(" (")[0] for why in found] == [
        "edges have attributes that are not read: packetloss",
        "the mean latency of an edge of 9 s is more than a tenth of the horizon of 10 s: times are in s, not ms",
    ]


@pytest.mark.parametrize("graph", [nx.path_graph(3), nx.DiGraph([("a", "b")]), nx.grid_2d_graph(2, 2)])
def test_a_scenario_takes_a_networkx_graph_and_its_file_repeats_it(graph):
    scenario = Scenario(team=Team(count=len(graph)), network=Links(graph=graph))
    assert Scenario.model_validate(scenario.plain()).network.graph == Edges.of(graph)


def test_parallel_edges_that_differ_and_loops_of_networkx_are_refused():
    with pytest.raises(ValueError, match="edges 0 and 1 are parallel: both join nodes a and b"):
        Links(graph=nx.MultiGraph([("a", "b"), ("b", "a", {"loss": 0.1})]))
    with pytest.raises(ValueError, match="no node should be linked to itself"):
        Scenario(team=Team(count=1), network=Links(graph=nx.Graph([(0, 0)])))


TEXTS = {
    "10 ms": "should be a number, in s: 0.01 instead of the text '10 ms'",
    "0.2": "should be a number: 0.2 instead of the text '0.2'",
    "5%": "should be a number from 0 to 1: 0.05 instead of the text '5%'",
    "1,5": "should be a number: 1.5 instead of the text '1,5'",
    "3 km": "should be a number without a unit",
}


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("key", ["latency", "loss"])
def test_a_number_as_a_text_is_refused_with_what_to_write(key, text):
    with pytest.raises(ValueError, match=TEXTS[text].replace("(", r"\(")):
        Links(**{key: text})
    with pytest.raises(ValueError, match=TEXTS[text]):
        Edges(edges=[{"src": 0, "dst": 1, key: text}])


def test_an_edge_of_a_file_has_the_models_of_its_attributes(tmp_path):
    (edge, _) = read(plain(tmp_path, "net.csv", latency=0.25, loss=0.5)).edges
    assert (edge.latency, edge.loss) == (Constant(value=0.25), Bernoulli(p=0.5))


@pytest.mark.parametrize(("key", "meant"), [("delay", "latency"), ("packetloss", "loss"), ("packet_loss", "loss")])
def test_an_edge_in_a_scenario_file_has_known_keys_only(tmp_path, key, meant):
    (tmp_path / "s.toml").write_text(
        f'network.graph = {{ kind = "edges", edges = [{{ src = 0, dst = 1, {key} = 0.2 }}] }}\n'
    )
    with pytest.raises(ValueError, match=rf"s\.toml:1: network\.graph\.edges\.0\.{key}: unknown key, .*'{meant}'"):
        load(tmp_path / "s.toml")


def test_a_trace_on_an_edge_that_may_end_before_the_run_gives_a_warning():
    trace = {"kind": "trace", "table": "t,value\n0,0.1\n1,0.2\n", "after": "error"}
    graph = Edges(edges=[{"src": 0, "dst": 1, "latency": trace}])
    found = dict(warnings(Scenario(team=Team(count=2), network=Links(graph=graph), horizon=9.0)))
    assert found["network.graph"].startswith("a message that is sent later than 2 s ends the run with an error")


@pytest.mark.parametrize(
    ("key", "number", "why"), [("loss", 50, "less than or equal to 1"), ("latency", -1, "than or")]
)
def test_a_number_that_is_not_valid_is_refused_with_its_edge(tmp_path, key, number, why):
    (tmp_path / "g.csv").write_text(f"source,target,{key}\na,b,0\nb,c,{number}\n")
    with pytest.raises(ValueError, match=rf"g\.csv: the {key} of the edge from b to c: should be .*{why}"):
        Edges(file=str(tmp_path / "g.csv"))


def test_a_link_between_names_is_refused_with_their_numbers():
    graph = {"kind": "edges", "edges": [{"src": 0, "dst": 1}], "names": ["boat", "uav"]}
    with pytest.raises(ValueError, match=r"dst of link 0 should be a number; the number of uav is 1"):
        Links(graph=graph, link=[{"src": 0, "dst": "uav", "latency": 0.1}])


@pytest.mark.parametrize("ends", [*LINK_ENDS, *LINK_END_WORDS], ids="-".join)
@pytest.mark.parametrize("mark", [" ", ",", "\t"])
def test_nodes_may_have_the_names_of_columns(tmp_path, ends, mark):
    """The first line is an edge if a node below has one of its names, or if it has a number."""
    file = tmp_path / "g.txt"
    a, b = ends
    file.write_text(f"{a}{mark}{b}\n{b}{mark}c\n")
    assert Edges(file=str(file)).names == (a, b, "c")
    file.write_text(f"{a}{mark}{b}{mark}1.5\nd{mark}e{mark}2\n")
    assert Edges(file=str(file)).names == (a, b, "d", "e")
    file.write_text(f"{a}{mark}{b}\nboat{mark}uav\n")
    assert Edges(file=str(file)).names == ("boat", "uav")
    file.write_text(f"{a}{mark}{b}\n1{mark}0\n")
    assert Edges(file=str(file)).names == ()


@pytest.mark.slow
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    ends=st.sets(st.tuples(st.integers(1, 5), st.integers(1, 5)).filter(lambda pair: pair[0] < pair[1]), min_size=1),
    code=st.sampled_from(["", " 0", " 1", " 10", " 011", " 111 2"]),
    name=st.sampled_from(["g.graph", "g.metis", "g.txt"]),
)
def test_a_graph_of_metis_comes_back_with_any_weights(tmp_path, ends, code, name):
    """Line i has the neighbours of node i; a list of edges would have others, and one between the two numbers."""
    digits, _, number = code.strip().zfill(3).partition(" ")
    before = ["7"] * (int(digits[0]) + int(digits[1]) * int(number or 1))
    lines = [f"% a comment\n5 {len(ends)}{code}"]
    for node in range(1, 6):
        neighbours = sorted({*(b for a, b in ends if a == node), *(a for a, b in ends if b == node)})
        weighted = [text for k in neighbours for text in ([str(k), "3"] if digits[2] == "1" else [str(k)])]
        lines.append(" ".join(before + weighted))
    (tmp_path / name).write_text("\n".join(lines) + "\n")
    edges = read(tmp_path / name)
    assert edges.nodes == 5
    assert {(edge.src + 1, edge.dst + 1) for edge in edges.edges} == ends
    with pytest.raises(ValueError, match="is the format of METIS, which says it"):
        read(tmp_path / name, directed=True)


@pytest.mark.parametrize(
    ("code", "before", "beside"),
    [
        ("", "", ""),
        (" 100", "7 ", ""),
        (" 010", "8 ", ""),
        (" 110 2", "7 8 9 ", ""),
        (" 001", "", " 5"),
        (" 11", "8 ", " 5"),
    ],
)
def test_sizes_and_weights_of_metis_are_no_neighbours(tmp_path, code, before, beside):
    rows = (f"{before}{' '.join(f'{k}{beside}' for k in row)}" for row in ([2], [1, 3], [2]))
    (tmp_path / "g.graph").write_text("\n".join([f"3 2{code}", *rows, ""]))
    assert [(edge.src, edge.dst) for edge in read(tmp_path / "g.graph").edges] == [(0, 1), (1, 2)]


def test_a_list_of_edges_may_have_the_ending_of_metis(tmp_path):
    (tmp_path / "g.graph").write_text("0 1\n1 2\n2 0\n")
    assert len(read(tmp_path / "g.graph").edges) == 3


def test_a_trivial_graph_has_labels_of_nodes_and_edges(tmp_path):
    """The labels are no nodes."""
    (tmp_path / "g.tgf").write_text("1 First node\n2 Second\n3\n#\n1 2 an edge\n2 3\n")
    edges = read(tmp_path / "g.tgf")
    assert [(edge.src, edge.dst) for edge in edges.edges] == [(0, 1), (1, 2)]


XML_TWICE = """<graphml xmlns="http://graphml.graphdrawing.org/xmlns">
<key id="d0" for="edge" attr.name="latency" attr.type="double"/>
<key id="d1" for="edge" attr.name="latency" attr.type="double"/>
<graph edgedefault="undirected"><node id="0"/><node id="1"/>
<edge source="0" target="1"><data key="{first}">0.1</data><data key="{second}">0.2</data></edge></graph></graphml>"""
GEXF_TWICE = """<gexf xmlns="http://www.gexf.net/1.2draft" version="1.2"><graph defaultedgetype="undirected">
<attributes class="edge"><attribute id="0" title="latency" type="float"/>
<attribute id="1" title="latency" type="float"/></attributes>
<nodes><node id="0" label="0"/><node id="1" label="1"/></nodes><edges><edge id="0" source="0" target="1"><attvalues>
<attvalue for="{first}" value="0.1"/><attvalue for="{second}" value="0.2"/></attvalues></edge></edges></graph></gexf>"""


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("g.txt", "a b\nc d\n", "line 1: a b may be an edge or the names of the columns"),
        ("g.txt", "0 1\n1 {}\n", r"line 2: 1 \{\} is no edge"),
        ("g.adjlist", "0 1\n1 {}\n", r"line 2: 1 \{\} is no edge"),
        ("g.txt", "0 1 {'latency': 0.1, 'latency': 0.2}\n", "line 1: has 'latency' twice"),
        ("g.json", '{"nodes": [{"id": 0}, {"id": 1, "id": 2}], "links": []}', "an object has 'id' twice"),
        ("g.net", '*Vertices\n1 "a"\n', "line 1: .Vertices should be followed by their number"),
        ("g.csv", "source,target,latency,latency\n0,1,0.1,0.2\n", "line 1: has 'latency' twice"),
        ("g.csv", "source,source,target\n0,1,2\n", "line 1: has 'source' twice"),
        ("g.tgf", "1 a\n1 b\n#\n1 1\n", "the list of nodes has '1' twice"),
        ("g.net", '*Vertices 2\n1 "a"\n1 "b"\n*Edges\n1 2\n', "the list of vertices has '1' twice"),
        ("g.net", "*Vertices 2\n*Edges\n1 2 1 latency 0.1 latency 0.2\n", "line 3: has 'latency' twice"),
        (
            "g.json",
            '{"nodes": [{"id": 0}, {"id": 1}], "links": [{"source": 0, "target": 1}], "edges": [{"source": 1}]}',
            "it should have edges or links, and has both",
        ),
        ("g.graphml", XML_TWICE.format(first="d0", second="d0"), "the edge from 0 to 1 has 'latency' twice"),
        ("g.graphml", XML_TWICE.format(first="d0", second="d1"), "the edge from 0 to 1 has 'latency' twice"),
        ("g.gexf", GEXF_TWICE.format(first="0", second="0"), "the edge from 0 to 1 has 'latency' twice"),
        ("g.gexf", GEXF_TWICE.format(first="0", second="1"), "the edge from 0 to 1 has 'latency' twice"),
    ],
)
def test_what_is_read_in_two_ways_or_twice_is_refused(tmp_path, name, text, why):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=why):
        Edges(file=str(tmp_path / name))


PARALLEL = nx.MultiGraph([("a", "b", {"weight": 1}), ("b", "a", {"weight": 2}), ("b", "c", {}), ("a", "b", {})])


@pytest.mark.parametrize("kind", ["networkx", "links.json", "net.graphml", "net.gml", "table.csv"])
def test_an_edge_that_is_repeated_counts_once_and_this_is_told(tmp_path, kind):
    """A third of the graphs of the Topology Zoo have such edges; networkx refuses them in GML that does not say so."""
    file = tmp_path / kind
    if kind == "net.gml":
        edges = "".join(f"edge [ source {src} target {dst} ]\n" for src, dst in ["01", "10", "12", "01"])
        nodes = "".join(f'node [ id {k} label "{name}" ]\n' for k, name in enumerate("abc"))
        file.write_text(f"graph [\n{nodes}{edges}]\n")
    elif kind == "table.csv":
        file.write_text("source,target,weight\na,b,1\nb,c,2\na,b,3\na,b,4\n")
    elif kind != "networkx":
        WRITERS[kind](PARALLEL, file)
    with pytest.warns(UserWarning, match="not read: weight") if kind == "networkx" else nullcontext():
        graph = Edges.of(PARALLEL) if kind == "networkx" else read(file)
    assert [(edge.src, edge.dst) for edge in graph.edges] == [(0, 1), (1, 2)]
    assert graph.names == ("a", "b", "c")
    assert any(note.startswith("2 of its edges repeat another one") for note in graph.notes)


@pytest.mark.parametrize("kind", ["net.graphml", "links.json"])
def test_a_file_whose_edges_are_all_one_way_is_told_and_other_directed_graphs_are_not(tmp_path, kind):
    for edges, is_told in [([(0, 1), (1, 2)], True), ([(0, 1), (1, 0), (1, 2)], False), ([(0, 1)], False)]:
        WRITERS[kind](nx.DiGraph(edges), tmp_path / kind)
        assert any("all edges are one-way" in note for note in read(tmp_path / kind).notes) == is_told
    assert not Edges.of(nx.DiGraph([(0, 1), (1, 2)])).notes
    (tmp_path / "g.txt").write_text("0 1\n1 2\n")
    assert not Edges(file=str(tmp_path / "g.txt"), directed=True).notes


GRAPHOLOGY = (
    '{"options": {"type": "TYPE", "multi": false}, "nodes": [{"key": "x", "attributes": {"label": "base"}},'
    ' {"key": "y", "attributes": {"label": "uav"}}], "edges": [{"key": "0", "source": "y", "target": "x",'
    ' "attributes": {"latency": 0.5}}]}'
)
CYTOSCAPE = '[{"data": {"id": "x"}}, {"data": {"id": "y"}}, {"data": {"id": "e", "source": "y", "target": "x"}}]'
GEXF = """<gexf xmlns="http://www.gexf.net/1.3" version="1.3"><graph defaultedgetype="undirected">
<nodes><node id="x" label="base"/><node id="y" label="uav"/></nodes><edges><edge source="y" target="x"/></edges></graph>
</gexf>"""


def test_graphs_of_gephi_and_of_pages_are_read(tmp_path):
    for kind in ("directed", "undirected"):
        (tmp_path / "g.json").write_text(GRAPHOLOGY.replace("TYPE", kind))
        graph = read(tmp_path / "g.json")
        assert (graph.names, graph.directed) == (("base", "uav"), kind == "directed")
        assert [edge.latency for edge in graph.edges] == [Constant(value=0.5)]
        assert not graph.directed or graph.edges[0].src == 1
    for name, text, names in [("c.json", CYTOSCAPE, ("x", "y")), ("g.gexf", GEXF, ("base", "uav"))]:
        (tmp_path / name).write_text(text)
        graph = read(tmp_path / name)
        assert (graph.names, [{edge.src, edge.dst} for edge in graph.edges]) == (names, [{0, 1}])


@pytest.mark.parametrize("mark", [" ", ",", ";", "\t"])
@pytest.mark.parametrize("header", ["none", "numbers", "names"])
@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(size=st.integers(3, 7), seed=st.integers(0, 99), directed=st.booleans())
def test_an_adjacency_matrix_is_the_graph_that_it_is_of(tmp_path, mark, header, size, seed, directed):
    graph = nx.gnp_random_graph(size, 0.5, seed=seed, directed=directed)
    names = {"none": [], "numbers": [str(node) for node in graph], "names": [f"uav{node}" for node in graph]}[header]
    rows = [[str(int(graph.has_edge(src, dst))) for dst in graph] for src in graph]
    if names:
        rows = [["-" if mark == " " else "", *names], *([name, *row] for name, row in zip(names, rows, strict=True))]
    file = tmp_path / "matrix.txt"
    file.write_text("\n".join(mark.join(row) for row in rows) + "\n")
    made = Edges(file=str(file), directed=True) if directed else read(file)
    assert {(edge.src, edge.dst) for edge in made.edges} == set(graph.edges)
    assert made.names == (tuple(names) if header == "names" else ())
    assert made.nodes == size


def test_three_lines_whose_diagonal_is_missing_are_a_matrix(tmp_path):
    (tmp_path / "g.txt").write_text("nan 1 1\n1 nan 0\n1 0 nan\n")
    assert [(edge.src, edge.dst) for edge in read(tmp_path / "g.txt").edges] == [(0, 1), (0, 2)]
    for text in (",1,0\n1,,1\n0,1,\n", "- 1 0\n1 - 1\n0 1 -\n"):  # 1 and 0 are no names of two nodes
        (tmp_path / "g.txt").write_text(text)
        assert [(edge.src, edge.dst) for edge in read(tmp_path / "g.txt").edges] == [(0, 1), (1, 2)]
    (tmp_path / "g.txt").write_text("nan 1\n1 nan\n")
    with pytest.raises(ValueError, match="'nan' is probably no name of a node"):
        read(tmp_path / "g.txt")


def test_three_lines_with_names_are_a_matrix_whatever_their_numbers(tmp_path):
    """Without names, they may be edges with weights."""
    (tmp_path / "costs.csv").write_text(",x,y,z\nx,0,2,7\ny,2,0,1\nz,7,1,0\n")
    made = read(tmp_path / "costs.csv")
    assert made.names == ("x", "y", "z")
    assert [(edge.src, edge.dst) for edge in made.edges] == [(0, 1), (0, 2), (1, 2)]


def test_links_of_one_node_to_names_of_several_words_are_a_star(tmp_path):
    (tmp_path / "star.csv").write_text("base,uav 1\nbase,uav 2\nbase,uav 3\n")
    assert read(tmp_path / "star.csv").names == ("base", "uav 1", "uav 2", "uav 3")


def test_a_matrix_on_one_side_of_the_diagonal_may_be_either_and_a_table_of_edges_is_none(tmp_path):
    (tmp_path / "m.txt").write_text("1 1 0 1\n0 1 1 0\n0 0 0 0\n0 0 0 0\n")
    with pytest.raises(ValueError, match="is a matrix that is not symmetric: set directed = true"):
        read(tmp_path / "m.txt")
    for directed in (False, True):
        made = read(tmp_path / "m.txt", directed=directed)
        assert [(edge.src, edge.dst) for edge in made.edges] == [(0, 1), (0, 3), (1, 2)]
        assert made.directed is directed
    (tmp_path / "e.csv").write_text("source,target,latency,loss\n0,1,0,0\n1,2,0,0\n2,3,0,0\n3,0,0,0\n")
    assert len(read(tmp_path / "e.csv").edges) == 4
    (tmp_path / "w.txt").write_text("0 1 5\n1 2 3\n2 0 4\n")
    assert [(edge.src, edge.dst) for edge in read(tmp_path / "w.txt").edges] == [(0, 1), (0, 2), (1, 2)]


@pytest.mark.parametrize(
    "text", ["# source target\na b c\nb c\n", "a,b,c\nb,c,\n", "a: b c\nb: c\nc:\n", 'a; "b"; c\nb; c\n']
)
def test_an_adjacency_list_may_have_commas_colons_and_comments(tmp_path, text):
    (tmp_path / "net.adjlist").write_text(text)
    made = read(tmp_path / "net.adjlist")
    assert made.names == ("a", "b", "c")
    assert [(edge.src, edge.dst) for edge in made.edges] == [(0, 1), (0, 2), (1, 2)]


def test_whole_floats_are_numbers_of_nodes(tmp_path):
    file = tmp_path / "g.txt"
    file.write_text("1.0 0.0\n")
    for graph in (Edges(file=str(file)), Edges.of(nx.DiGraph([(1.0, 0.0)]))):
        assert [(edge.src, edge.dst) for edge in graph.edges] == [(1, 0)]


@pytest.mark.parametrize(
    "header",
    [
        "Device From,Device To,Latency",
        "source_region,destination_region,rtt_ms",
        "kbps,ip.src,ip.dst",
        "Time,srcNode,dstNode",
        "time_tx,time,node_tx,node_rx",
        "SendingRegion,kbps,ReceivingRegion",
        "node_id,neighbor_id,distance",
    ],
)
def test_words_in_their_names_tell_the_columns_of_the_ends(tmp_path, header):
    """The names of both differ by one word."""
    names = header.split(",")
    src = next(k for k, name in enumerate(names) if re.search("(?i)from|source|src|node_tx|sending|node_id", name))
    dst = next(k for k, name in enumerate(names) if re.search("(?i)to|dest|dst|node_rx|receiving|neighbor", name))
    rows = [[*"7" * len(names)] for _ in range(2)]
    rows[0][src], rows[0][dst], rows[1][src], rows[1][dst] = "Rome", "Oslo", "Oslo", "Bonn"
    (tmp_path / "g.csv").write_text("\n".join([header, *map(",".join, rows)]))
    made = read(tmp_path / "g.csv")
    assert made.names == ("Rome", "Oslo", "Bonn")
    assert [(edge.src, edge.dst) for edge in made.edges] == [(0, 1), (1, 2)]


@pytest.mark.parametrize(
    "text", ["tx1,rx1\ntx2,rx2\nbase,relay\n", "src-a dst-a\nsrc-b dst-b\nsrc-c dst-c\n", "tx1,rx1\n"]
)
def test_nodes_with_such_words_in_their_names_are_no_columns(tmp_path, text):
    file = tmp_path / "g.csv"
    file.write_text(text)
    assert len(Edges(file=str(file)).edges) == text.count("\n")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("timestamp,latency\n2018-04-01T19:42:45,19\n2018-04-01T20:42:47,21\n", "line 1: .* of a table over time"),
        ("date,event\n2018-04-01,START\n2018-04-02,STOP\n", "line 1: .* of a table over time"),
        ("clients,delay\n5,10.2\n10,15.1\n", "line 2: '10.2' is probably no name of a node"),
        ("1041.51;-952.47;142.2\n1041.49;-952.38;142.1\n", "line 1: '1041.51' is probably no name"),
        ("source,target,t\na,b,1\nsource,target,t\nb,c,2\n", "line 3: repeats the names of the columns"),
        ("rssi,lqi\n-71,88\n-75,72\n", "line 2: '-71' is probably no name"),
        ("rate: 5\nscan: '/scan'\n", "line 1: 'rate:' is probably no name"),
        ('# "quoted"\nrate: 5\nscan: 7\n', "line 2: 'rate:' is probably no name"),
        ('Topology,Memory\n"29\n 27",28248\n', "line 2: a quote is not closed"),
        ("a,b\nb,\n", "line 2: should have two nodes; a node without edges is a line with its name only"),
        ("source,target\na,b\n,b\n", "line 3: should have two nodes"),
        (
            "# Directed graph (each pair once): web.txt\n# Nodes: 3\n0\t1\n1\t2\n",
            "comment '# Directed graph .*set directed",
        ),
        ("% asym positive\n% 2 3 3\n1 2\n2 3\n", "the comment '% asym positive': set directed = true"),
    ],
)
def test_other_tables_are_no_graph_and_a_comment_that_edges_are_one_way_counts(tmp_path, text, why):
    (tmp_path / "g.txt").write_text(text)
    with pytest.raises(ValueError, match=why):
        read(tmp_path / "g.txt")


@pytest.mark.parametrize(
    "text", ["# Directed graph: a.txt\n0 1\n1 0\n", "# Undirected graph: a.txt\n0 1\n", "% sym\n0 1\n"]
)
def test_a_comment_does_not_count_where_all_edges_hold_both_ways(tmp_path, text):
    (tmp_path / "g.txt").write_text(text)
    assert [(edge.src, edge.dst) for edge in read(tmp_path / "g.txt").edges] == [(0, 1)]


@pytest.mark.parametrize("line", ["0 1", "1 0", "2 2"])
def test_a_repeated_edge_and_one_to_its_own_node_need_no_reverse_edge(tmp_path, line):
    (tmp_path / "g.txt").write_text(f"0 1\n1 0\n{line}\n")
    edges = read(tmp_path / "g.txt").edges
    assert [(edge.src, edge.dst) for edge in edges] == [(0, 1), *([(2, 2)] if line == "2 2" else [])]


def test_comments_may_precede_a_graph_of_pajek_and_empty_rows_follow_a_list(tmp_path):
    (tmp_path / "g.net").write_text('% one\n% two\n\n*Network x\n*vertices 2\n1 "a b"\n2 "c"\n*edges\n1 2\n')
    assert read(tmp_path / "g.net").names == ("a b", "c")
    (tmp_path / "g.net").write_text('*vertices 2%two\n1 "50 % up"\n2 5%  % a "comment"\n*edges%one\n1 2%"c"\n')
    assert read(tmp_path / "g.net").names == ("50 % up", "5%")
    (tmp_path / "g.csv").write_text("source,target\na,b\n,\n")
    assert read(tmp_path / "g.csv").names == ("a", "b")


def test_white_space_around_labels_does_not_count_and_is_no_label(tmp_path):
    """As in GraphML of yEd, whose labels are in lines of their own."""
    labels = [" boat\n  ", "\n uav"]
    graph = nx.Graph([("n0", "n1")])
    nx.set_node_attributes(graph, dict(zip(graph, labels, strict=True)), "label")
    assert Edges.of(graph).names == ("boat", "uav")
    graph.nodes["n1"]["label"] = "\n   "
    assert Edges.of(graph).names == ("n0", "n1")


def test_numbers_with_a_fraction_are_names_where_the_first_line_names_the_columns(tmp_path):
    (tmp_path / "g.csv").write_text("source,target\n1.1,1.2\n1.2,2.1\n")
    assert read(tmp_path / "g.csv").names == ("1.1", "1.2", "2.1")


def test_one_edge_is_no_graph_of_metis_without_edges(tmp_path):
    for name, edges in (("g.txt", [(1, 0)]), ("g.metis", [])):
        (tmp_path / name).write_text("1 0\n")
        assert [(edge.src, edge.dst) for edge in read(tmp_path / name).edges] == edges


def test_a_first_line_with_one_name_is_a_node_without_edges(tmp_path):
    (tmp_path / "g.txt").write_text("base\n0 1\n")
    assert read(tmp_path / "g.txt").names == ("base", "0", "1")
    (tmp_path / "c.txt").write_text("# nothing\n")
    with pytest.raises(ValueError, match=r"c\.txt is not a graph: it has comments only"):
        read(tmp_path / "c.txt")


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"graph": "net.graphml"}, 'graph: a file needs a kind: { kind = "edges", file = "net.graphml" }'),
        ({"graph": {"file": "net.csv.gz"}}, 'a file needs a kind: { kind = "edges", file = "net.csv.gz" }'),
        ({"loss": "rtt.csv"}, 'file = "rtt.csv" }; kinds that read a file: trace, signal_trace'),
        ({"graph": "net"}, "graph.kind: there is no 'net'; allowed: complete"),
    ],
)
def test_a_file_without_a_kind_is_refused_with_the_kinds_that_read_one(keys, why):
    with pytest.raises(ValueError, match=re.escape(why)):
        Links(**keys)


CITIES = [("New York", "Boston"), ("Los Angeles", "San Diego"), ("Santa Fe", "El Paso")]


@pytest.mark.parametrize("sign", [",", ";", "\t", " "])
def test_pairs_with_names_of_several_words_need_quotes_or_a_header(tmp_path, sign):
    """Without them they may be lines of a text; with spaces between names, only quotes tell where a name ends."""
    file = tmp_path / "g.csv"
    quoted = "".join(f'"{src}"{sign}"{dst}"\n' for src, dst in CITIES)
    for text in (quoted, f"source{sign}target\n{quoted}"):
        file.write_text(text)
        graph = read(file)
        assert [(graph.names[edge.src], graph.names[edge.dst]) for edge in graph.edges] == CITIES
    file.write_text("".join(f'" {src}"{sign}"{dst} "\n' for src, dst in CITIES))  # as a spreadsheet may have them
    assert len(read(file).edges) == len(CITIES)
    file.write_text(quoted.replace('"', ""))
    with pytest.raises(ValueError, match=r"put names in quotes, or name the columns|should have two nodes"):
        read(file)
    file.write_text("".join(f'It says "{src}{sign}{dst}" here\n' for src, dst in CITIES))
    with pytest.raises(ValueError, match=r"put names in quotes, or name the columns|should have two nodes"):
        read(file)


@pytest.mark.parametrize(
    ("key", "table", "why"),
    [
        ("team", {"positions": "a.csv"}, 'should be a list or a table: { kind = "recorded", file = "a.csv" }'),
        ("wall", "a.svg", 'should be a list: [[wall]] with file = "a.svg"'),
        ("wall", [{"line": "a.wkt"}], 'should be a list; a file is another key: file = "a.wkt"'),
        ("evader", {"strategy": {"kind": "recorded", "waypoints": "a.csv"}}, 'another key: file = "a.csv"'),
        ("environment", {"flow": {"kind": "recorded", "velocities": "a.csv"}}, 'another key: file = "a.csv"'),
        ("network", {"latency": {"kind": "empirical", "values": "a.txt"}}, 'another key: file = "a.txt"'),
        ("network", {"latency": {"kind": "matrix", "values": "a.txt"}}, 'another key: file = "a.txt"'),
        ("network", {"graph": {"kind": "edges", "edges": "a.csv"}}, 'another key: file = "a.csv"'),
        ("network", {"loss": {"kind": "trace", "table": "a.csv"}}, 'another key: file = "a.csv"'),
    ],
)
def test_a_file_in_place_of_a_list_is_refused_with_the_key_that_reads_it(key, table, why):
    with pytest.raises(ValueError, match=re.escape(why)):
        Scenario(**{key: table})


def test_the_attributes_of_edges_that_are_read_are_not_told_as_unread(tmp_path):
    """Latency, loss and order, and nothing else."""
    (tmp_path / "g.csv").write_text("source,target,latency,loss,order,ordr\n0,1,0.5,0.25,fifo,fifo\n")
    graph = {"kind": "edges", "file": str(tmp_path / "g.csv")}
    (edge,) = Edges(file=graph["file"]).edges
    assert (edge.latency, edge.loss.p, edge.order) == (Constant(value=0.5), 0.25, "fifo")
    scenario = Scenario(team={"count": 2}, network={"graph": graph})
    (found,) = [why for _, why in warnings(scenario) if "not read" in why]
    assert found == (
        "edges have attributes that are not read: ordr (did you mean 'order'?);"
        " those of an edge that are read are latency, loss, order"
    )


def test_edges_that_differ_by_direction_are_one_way_if_all_have_both(tmp_path):
    file = tmp_path / "e.csv"
    header = "source,target,latency\n"
    for rows, count in (("a,b,.1\nb,a,.2\nb,c,.1\nc,b,.1\n", 4), ("a,b,.1\nb,a,.2\n", 2), ("a,b,.1\nb,a,.1\n", 1)):
        file.write_text(header + rows)
        assert len(Edges(file=str(file)).edges) == count
        assert len(Edges(file=str(file), directed=True).edges) == rows.count("\n")
    file.write_text(header + "a,b,.1\nb,a,.2\nb,c,.1\n")
    with pytest.raises(ValueError, match="edges 0 and 1 are parallel"):
        Edges(file=str(file))


def test_a_line_of_one_word_is_a_node_and_one_of_several_words_a_title(tmp_path):
    file = tmp_path / "e.csv"
    edges = "Rome,New York\nRome,Bern\nBern,New York\n"
    file.write_text(f"Oslo\n{edges}")
    assert set(Edges(file=str(file)).names) == {"Oslo", "Rome", "Bern", "New York"}
    file.write_text(f"Rome,Bern\nLinks of 2024\n{edges}")
    with pytest.raises(ValueError, match="line 2: 'Links of 2024' is no edge, and no name of a node"):
        Edges(file=str(file))


@pytest.mark.parametrize("sign", [",", ";", "\t", " ", ", "])
def test_a_list_may_begin_with_a_node_without_edges(tmp_path, sign):
    file = tmp_path / "e.csv"
    file.write_text(f"# c\nOslo\nBern\nRome{sign}Bonn\n")
    graph = Edges(file=str(file))
    assert (graph.names, [(edge.src, edge.dst) for edge in graph.edges]) == (("Oslo", "Bern", "Rome", "Bonn"), [(2, 3)])
