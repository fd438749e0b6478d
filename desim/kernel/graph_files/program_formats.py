"""Graphs in the text formats of other programs: METIS, Pajek and the Trivial Graph Format of yEd.

Unlike lists, these formats declare their nodes. The graphs are those of networkx, with texts as nodes.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from desim.config.number_files import number_of
from desim.config.number_texts import counted
from desim.config.tables import check_once
from desim.kernel.graph_files.edge_lists import NamedEdge, attribute_of, listed_graph

if TYPE_CHECKING:
    import networkx as nx


def read_metis(file: Path, text: str) -> "nx.Graph[Any] | None":
    """Return the graph in the format of METIS; None if the text does not have as many lines as its first one says.

    The first line has the numbers of nodes and edges and perhaps a code for weights. Line i of the other lines has the
    neighbours of node i, from 1, so that each edge is there twice. Weights and sizes of nodes are not read.

    Raises:
        ValueError: if the lines are no such graph.
    """
    import networkx as nx

    lines = [entry for entry in enumerate(text.split("\n"), 1) if not entry[1].lstrip().startswith("%")]
    while lines and not lines[0][1].strip():
        del lines[0]
    head = lines[0][1].split() if lines else []
    if not 2 <= len(head) <= 4 or not all(map(str.isdecimal, head)):
        return None
    size, edge_count, code = int(head[0]), int(head[1]), (head[2] if len(head) > 2 else "").zfill(3)
    rows = lines[1:]
    while len(rows) > size and not rows[-1][1].strip():
        rows.pop()
    if len(rows) != size or not set(code) <= {"0", "1"} or len(code) > 3:
        return None
    # The digits of the code say whether a line begins with the size of its node, whether weights of the node follow
    # (one, or as many as the first line says), and whether each neighbour is followed by the weight of the edge.
    skipped = int(code[0]) + (int(head[3]) if len(head) > 3 else 1) * int(code[1])
    step = 2 if code[2] == "1" else 1
    weights: dict[tuple[int, int], str] = {}
    for node, (line, row) in enumerate(rows, 1):
        cells = row.split()[skipped:]
        if not all(map(str.isdecimal, cells[::step])) or len(cells) % step:
            raise ValueError(f"{file}, line {line}: should have the numbers of the neighbours of node {node}")
        for neighbour, weight in zip(map(int, cells[::step]), cells[step - 1 :: step], strict=True):
            if not 1 <= neighbour <= size or neighbour == node or (node, neighbour) in weights:
                reason = f"{neighbour} is no other node from 1 to {size}, or is there twice"
                raise ValueError(f"{file}, line {line}: {reason}")
            weights[node, neighbour] = weight if step == 2 else ""
    if one_way := next((ends for ends in weights if weights.get(ends[::-1]) != weights[ends]), None):
        raise ValueError(f"{file}: the edge between the nodes {one_way[0]} and {one_way[1]} should be in both lines")
    if len(weights) != 2 * edge_count:
        raise ValueError(f"{file}, line {lines[0][0]}: says {counted(edge_count, 'edge')}, but has {len(weights) // 2}")
    graph: nx.Graph[Any] = nx.MultiGraph()
    graph.add_nodes_from(map(str, range(1, size + 1)))
    for (node, neighbour), weight in weights.items():
        if node < neighbour:
            graph.add_edge(str(node), str(neighbour), **({"weight": number_of(weight)} if weight else {}))
    return graph


def read_trivial(file: Path, text: str, directed: bool | None) -> "nx.Graph[Any]":
    """Return the graph in the Trivial Graph Format: nodes with labels, a line #, and edges with labels.

    Raises:
        ValueError: if it has no line #, or a line is no edge.
    """
    lines = [line.split(maxsplit=2) for line in text.split("\n")]
    if ["#"] not in lines:
        raise ValueError(f"{file}: should have a line # between nodes and edges")
    separator = lines.index(["#"])
    nodes = [cells[0] for cells in lines[:separator] if cells]
    check_once(nodes, f"{file}: the list of nodes")
    edges: list[NamedEdge] = []
    for number, cells in enumerate(lines[separator + 1 :], separator + 2):
        if cells and not (len(cells) > 1 and {*cells[:2]} <= {*nodes}):
            raise ValueError(f"{file}, line {number}: should be two of the nodes above the line #")
        if cells:
            edges.append((cells[0], cells[1], {"label": cells[2]} if len(cells) > 2 else {}))
    return listed_graph(file, nodes, edges, directed)


def read_pajek(file: Path, text: str) -> "nx.Graph[Any]":
    """Return the graph in a file of Pajek with a list of edges or of arcs.

    Raises:
        ValueError: if the file has other parts, edges as well as arcs, or an invalid line.
    """
    import networkx as nx

    labels, edges, edge_parts, part = dict[str, str](), list[NamedEdge](), set[str](), ""
    vertices = list[str]()
    for number, line in enumerate(text.split("\n"), 1):
        place = f"{file}, line {number}"
        word = r"(?<=\s)\S+|[^\s%]+" if part == "*vertices" else r"[^\s%]+"  # a name may have %, as networkx writes it
        cells = [cell.strip('"') for cell in re.findall(rf'"[^"]*"|%.*|{word}', line) if cell[0] != "%"]
        if not cells:
            continue
        if cells[0].startswith("*"):
            part = cells[0].lower()
            if part not in {"*network", "*vertices", "*edges", "*arcs"}:
                raise ValueError(f"{place}: {cells[0]} is not read; allowed: *Network, *Vertices, *Edges, *Arcs")
            if part == "*vertices":
                if len(cells) < 2 or not cells[1].isdecimal():
                    raise ValueError(f"{place}: *Vertices should be followed by their number")
                labels = {str(k): str(k) for k in range(1, int(cells[1]) + 1)}
        elif part == "*vertices":
            if cells[0] not in labels:
                raise ValueError(f"{place}: there is no vertex {cells[0]}: they are 1 .. {len(labels)}")
            labels[cells[0]] = cells[1] if len(cells) > 1 else cells[0]
            vertices.append(cells[0])
        elif part in {"*edges", "*arcs"}:
            if len(cells) < 2 or not {*cells[:2]} <= labels.keys():
                raise ValueError(f"{place}: should be two vertices from 1 to {len(labels)}")
            pairs = [*zip(cells[3::2], cells[4::2], strict=False)]
            check_once((name for name, _ in pairs), f"{place}:")
            attributes = {name: attribute_of(name, value, place) for name, value in pairs}
            weight = {"weight": attribute_of("weight", cells[2], place)} if len(cells) > 2 else {}
            edge_parts.add(part)
            edges.append((cells[0], cells[1], weight | attributes))
        else:
            raise ValueError(f"{place}: should begin with *Vertices")
    check_once(vertices, f"{file}: the list of vertices")
    if len(edge_parts) > 1:
        raise ValueError(f"{file} has edges and arcs: all should be of one type")
    graph: nx.Graph[Any] = nx.MultiDiGraph() if "*arcs" in edge_parts else nx.MultiGraph()
    graph.add_nodes_from((vertex, {"label": label}) for vertex, label in labels.items())
    graph.add_edges_from(edges)
    return graph
