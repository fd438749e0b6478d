"""Graphs as text: edge lists and adjacency lists, as networkx graphs whose nodes are texts.

Few lists say whether edges are one-way, in a column Type or a comment. A line of an edge list is an edge: its ends,
and possibly attributes, named in a header or as Python writes a dict. A line with one name is a node without edges.

    source,target,latency,loss
    uav1,uav2,0.05,0.1
"""

import csv
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from desim.config.column_names import COLUMNS, LINK_END_WORDS, LINK_ENDS, columns_of_ends
from desim.config.number_files import is_number_text, number_of
from desim.config.number_texts import counted, seconds_in
from desim.config.tables import check_once
from desim.kernel.measured.csv_tables import separator_in, with_points

if TYPE_CHECKING:
    import networkx as nx
DICT_ITEM = re.compile(r"""(?:'[^']*'|"[^"]*"|[^,'"])+""")
"""Matches an item of a dict."""
NAME_AND_VALUE = re.compile(r"""\s*(['"])(.*?)\1\s*:\s*(?:(['"])(.*?)\3|([\w.+-]+))\s*""")
"""Matches the name and the value of an item: a text or a word, such as a number."""


class EdgeRow(NamedTuple):
    """A line of a list."""

    line: int
    cells: list[str]
    attributes: dict[str, Any]
    """The attributes that the line gives as a dict."""


NamedEdge = tuple[str, str, dict[str, Any]]
"""The ends and the attributes of an edge."""
OF_NODES = frozenset({"id", "node", "name", "label", "node_id", "nodeid", "vertex"})
"""Names of the first column of a table of nodes, in lower case."""
OVER_TIME = frozenset({*COLUMNS["t"]} - {"t"})
"""Names of the first column of a table over time, in lower case; not t, which may be a node."""
ONE_WAY = re.compile(r"[#%]\s*(directed\b|asym\b)", re.IGNORECASE)
"""Matches the comment of a list whose edges are one-way: of SNAP and of KONECT."""
QUOTED = re.compile(r'"((?:[^"\n]|"")*)"')
"""Matches a text in quotes, in one line."""
WITH_DICT = re.compile(r"(\S+)\s+(\S+)\s*(\{.*\})")
"""Matches an edge as `networkx.write_edgelist` writes it."""


def read_edge_list(file: Path, text: str, directed: bool | None) -> "nx.Graph[Any]":
    """Return the graph in an edge list; `directed`: whether edges are one-way, None if it is not known.

    Raises:
        ValueError: if a line is no edge; the message names the file and the line.
    """
    header, rows = _table_of(file, text)
    src, dst = columns_of_ends(header) or (0, 1)
    types, nodes, edges = set[str](), list[str](), list[NamedEdge]()
    for line, cells, attributes in rows:
        if len(cells) == 1:
            nodes.append(cells[0])
            continue
        if len(cells) != len(header):
            raise ValueError(f"{file}, line {line}: should have {counted(len(header), 'column')}, has {len(cells)}")
        place = f"{file}, line {line}"
        if not (cells[src] and cells[dst]):
            raise ValueError(f"{place}: should have two nodes; a node without edges is a line with its name only")
        texts = {name: cells[k] for k, name in enumerate(header) if name and k not in {src, dst} and cells[k]}
        types |= {text.lower() for name, text in texts.items() if name.lower() == "type"}
        named = {name: attribute_of(name, text, place) for name, text in texts.items() if name.lower() != "type"}
        edges.append((cells[src], cells[dst], named | attributes))
    # SNAP and KONECT say in the first lines that edges are one-way.
    comment = next((line for line in text.split("\n", 9)[:9] if ONE_WAY.match(line.strip())), "")
    return listed_graph(file, nodes, edges, _directed_by(file, types, directed), comment.strip())


def _table_of(file: Path, text: str) -> tuple[list[str], list[EdgeRow]]:
    """Return the names of the columns of an edge list, and its rows.

    Raises:
        ValueError: if a row is probably no edge, or has attributes without a name.
    """
    delimiter = _delimiter(text)
    lines = _rows(file, text, delimiter)
    if not lines:
        raise ValueError(f"{file} is not a graph: it has comments only")
    header, rows = _header_of(file, lines)
    if rows and all(len(row.cells) == 1 for row in rows):
        place = f"{file}, line {rows[0].line}"
        raise ValueError(f"{place}: {rows[0].cells[0][:40]!r} is no edge, and none follows: write both ends of each")
    if delimiter in {";", "\t"}:  # then numbers may have decimal commas
        with_decimal_points = with_points(((row.line, row.cells) for row in rows), list, str(file))
        rows = [row._replace(cells=cells) for row, (_, cells) in zip(rows, with_decimal_points, strict=True)]
    if not columns_of_ends(header):
        _check_names(file, rows)
        long_names = {name.strip() for row in rows for name in row.cells[:2] if len(name.split()) > 1}
        quoted = {match[1].replace('""', '"').strip() for match in QUOTED.finditer(text)} if long_names else set()
        if not long_names <= quoted:  # several words in quotes are certainly one name
            _check_form(file, rows)
    if not header:
        is_weighted = all(len(row.cells) == 3 and is_number_text(row.cells[2]) for row in rows)
        header = ["source", "target", *(["weight"] if is_weighted else [])]
        if too_long := [row for row in rows if len(row.cells) > len(header)]:
            raise ValueError(
                f"{file}, line {too_long[0].line}: should have two nodes; attributes need a first line that names the"
                " columns, such as source,target,latency,loss; an adjacency list needs the ending .adjlist"
            )
    check_once(filter(None, header), f"{file}, line {lines[0].line}:")
    return header, rows


def _directed_by(file: Path, types: set[str], directed: bool | None) -> bool | None:
    """Return whether edges are one-way, given the values in the column Type; see `read_edge_list`."""
    if not types & {"directed", "undirected"}:
        return directed
    if len(types) > 1:
        raise ValueError(f"{file} has directed and undirected edges: all should be of one type")
    if directed is not None and directed != ("directed" in types):
        raise ValueError(f"{file} has a column Type, which says {'un' if directed else ''}directed: leave out directed")
    return "directed" in types


def read_adjacency_list(file: Path, text: str, directed: bool | None) -> "nx.Graph[Any]":
    """Return the graph in an adjacency list, a node and its neighbours in each line; see `read_edge_list`.

    Spaces, commas or semicolons separate names. A colon may follow the first name, if it does so in all lines.
    """
    text = re.sub(r"(?m)^[ \t]*[#%].*", "", text)
    text = re.sub(r'("[^"\n]*")|[,;]', lambda part: part[1] or " ", text)
    rows = [row.cells for row in _rows(file, text, "")]
    nodes = [cells[0] for cells in rows]
    if all(node.endswith(":") for node in nodes):
        nodes = [node.removesuffix(":") for node in nodes]
    edges = [(node, end, dict[str, Any]()) for node, cells in zip(nodes, rows, strict=True) for end in cells[1:]]
    return listed_graph(file, nodes, edges, directed)


def _delimiter(text: str) -> str:
    """Return the sign that separates the cells of a list, by the first line with several; "": white space."""
    lines = (line for line in text.split("\n") if line.strip() and line.strip()[0] not in "#%")
    first = next((line for line in lines if re.search(r"\S[\s,;]+\S", line)), "")
    return separator_in(first.partition("{")[0])


def _rows(file: Path, text: str, delimiter: str) -> list[EdgeRow]:
    """Return the lines of a list with their cells, without comments.

    A comment that names the columns is kept.
    """
    lines = text.split("\n")

    def cells_of(line: str) -> list[str]:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]

    def words_of(line: str) -> list[str]:
        return [word.strip('"') for word in re.findall(r'"[^"]*"|\S+', line)]

    split: Callable[[str], list[str]] = cells_of if delimiter else words_of
    rows: list[EdgeRow] = []
    for number, line in enumerate(lines, 1):
        stripped = line.strip(" \r" if delimiter == "\t" else None)  # a row of a table may end in empty cells
        if stripped and stripped[0] in "#%":
            names = split(stripped.lstrip("#% "))
            if not rows and columns_of_ends(names):
                rows.append(EdgeRow(number, names, {}))
        elif match := None if delimiter else WITH_DICT.fullmatch(stripped):
            rows.append(EdgeRow(number, [match[1], match[2]], _dict_attributes(match[3], f"{file}, line {number}")))
        elif stripped.strip():
            if (
                delimiter
                and any(cell.lstrip().startswith('"') for cell in stripped.split(delimiter))
                and stripped.count('"') % 2
            ):
                raise ValueError(f"{file}, line {number}: a quote is not closed; a name is in one line")
            cells = split(stripped)
            if not any(cells):  # as the last rows of a spreadsheet
                continue
            if any(cell.startswith("{") for cell in cells[:2]):
                reason = f"{' '.join(cells)[:40]} is no edge; multiline lists are not read"
                raise ValueError(f"{file}, line {number}: {reason}")
            rows.append(EdgeRow(number, cells, {}))
    return rows


def _dict_attributes(text: str, place: str) -> dict[str, Any]:
    """Return the attributes that a text gives as Python writes a dict of numbers and texts."""
    inside = text[1:-1].strip()
    pairs = [NAME_AND_VALUE.fullmatch(item) for item in DICT_ITEM.findall(inside)] if inside else []
    if None in pairs or (inside and not pairs):
        raise ValueError(f"{place}: the attributes should be like {{'latency': 0.1}} (got {text[:40]})")
    entries = [(pair[2], pair[4], pair[5]) for pair in pairs if pair is not None]
    check_once((name for name, *_ in entries), f"{place}:")
    # No name: unlike in a cell, a loss may be a word, the kind of a model.
    return {name: attribute_of("", word, place) if quoted is None else quoted for name, quoted, word in entries}


def _header_of(file: Path, rows: list[EdgeRow]) -> tuple[list[str], list[EdgeRow]]:
    """Return the names of the columns, empty if they are not named, and the other rows.

    Nodes may be called a and b, too: a first line whose names occur below, or that has a number, is an edge.

    Raises:
        ValueError: if the first line may be both, or no other follows.
    """
    if len(rows[0].cells) < 2:
        return [], rows
    first, below = rows[0].cells, rows[1:]
    nodes = {cell for row in below for cell in row.cells[:2]}
    has_numbers = bool(nodes) and all(map(str.isdecimal, nodes))
    is_above_numbers = has_numbers and not any(cell.isdecimal() for cell in first[:2])
    if not columns_of_ends(first):
        name = first[0].lower()
        subject = "of nodes" if name in OF_NODES else "over time" if name in OVER_TIME else ""
        if subject and nodes and nodes.isdisjoint(first[:2]) and not any(map(is_number_text, first)):
            raise ValueError(
                f"{file}, line {rows[0].line}: {', '.join(first)[:60]} are the columns of a table {subject}; those of"
                " edges are source and target"
            )
        return (first, below) if is_above_numbers else ([], rows)
    if len(first) > 2 and (repeated := next((row.line for row in below if row.cells == first), 0)):
        raise ValueError(f"{file}, line {repeated}: repeats the names of the columns: it should be left out")
    if any(map(is_number_text, first)) or (not has_numbers and not nodes.isdisjoint(first[:2])):
        return [], rows
    is_plain = (first[0].lower(), first[1].lower()) in {*LINK_ENDS, *LINK_END_WORDS}
    # Nodes may be called tx1 and rx1, too.
    if not has_numbers and not is_plain and (not below or any(columns_of_ends(row.cells[:2]) for row in below)):
        return [], rows
    # Single letters, such as `a b` above `c d`, may be either.
    if len(first) == 2 and nodes and max(map(len, nodes)) == 1 == max(map(len, first)) and not has_numbers:
        reason = f"{first[0]} {first[1]} may be an edge or the names of the columns: write source and target above"
        raise ValueError(f"{file}, line {rows[0].line}: {reason}")
    if not below:
        reason = f"{', '.join(first)[:60]} are the names of columns, and no edge follows"
        raise ValueError(f"{file}, line {rows[0].line}: {reason}; if they are an edge, write source and target above")
    return first, below


MAX_DISTINCT = 0.9
"""Largest ratio of the different names to all names in lines that are probably edges; in a tree, it is about 1/2.

In disjoint pairs all names differ, so a list of such pairs with names of several words needs a header, or quotes.
"""


def _check_names(file: Path, rows: Sequence[EdgeRow]) -> None:
    """Raise ValueError if an end is a key with a colon, nan, inf, or a number that is negative or no integer.

    Such lines are probably YAML, or a table of measurements.
    """
    for line, cells, _ in rows:
        for name in cells[:2] if len(cells) > 1 else ():
            if name.endswith(":") or (is_number_text(name) and not _is_count(number_of(name))):
                advice = "if it is, name the columns in a first line, such as source,target"
                raise ValueError(f"{file}, line {line}: {name!r} is probably no name of a node; {advice}")


def _is_count(number: float) -> bool:
    return number >= 0.0 and number.is_integer()


def _check_form(file: Path, rows: Sequence[EdgeRow]) -> None:
    """Raise ValueError if rows without a header are probably no edges, but some text with spaces.

    Each of these is a sign: a title (a line of one cell with several words); different first names of one word, and
    second names that all have several; hardly a name that is in two lines.
    """
    edges = [row.cells for row in rows if len(row.cells) == 2]
    names = [name for cells in edges for name in cells]
    title = next((row for row in rows if len(row.cells) == 1 and len(row.cells[0].split()) > 1), None)
    have_spaces = [[len(name.split()) > 1 for name in side] for side in zip(*edges, strict=True)]
    if title is not None:
        reason = f"{title.cells[0][:40]!r} is no edge, and no name of a node"
    elif edges and len({first for first, _ in edges}) > 1 and all(have_spaces[1]) and not any(have_spaces[0]):
        reason = f"{edges[0][1][:40]!r} has several words, and {edges[0][0][:40]!r} has one"
    elif len(edges) > 2 and len(set(names)) > MAX_DISTINCT * len(names) and any(map(any, have_spaces)):
        reason = "hardly a name is in two lines"
    else:
        return
    line = (title or rows[0]).line
    raise ValueError(
        f"{file}, line {line}: {reason}: each line should be an edge; if these are edges, put names in quotes, or name"
        " the columns in a first line, such as source,target"
    )


def attribute_of(name: str, cell: str, place: str) -> Any:
    """Return an attribute: a number if it looks like one.

    A loss should be a number, and a latency a number or a time with its unit.
    """
    try:
        return number_of(cell)
    except ValueError as error:
        if name == "loss" or (name == "latency" and seconds_in(cell) is None):
            raise ValueError(f"{place}: {name}: {error}") from error
        return cell


def listed_graph(
    file: Path, nodes: Sequence[str], edges: Sequence[NamedEdge], directed: bool | None, comment: str = ""
) -> "nx.Graph[Any]":
    """Return the graph of a list; an undirected edge may be listed in both directions.

    If all edges are listed in both directions, and those of some differ, edges are one-way.

    Args:
        file: the path, for error messages.
        nodes: nodes, perhaps without edges.
        edges: the edges.
        directed: whether edges are one-way; None if it is not known.
        comment: a comment of the file which says that edges are one-way; it counts if some have no reverse edge.

    Raises:
        ValueError: if `directed` is None, some edges have no reverse edge, and either others have one or there is a
            comment.
    """
    import networkx as nx

    # Parallel edges are kept, to be refused if they differ.
    graph: nx.Graph[Any] = nx.MultiDiGraph() if directed else nx.MultiGraph()
    graph.add_nodes_from(nodes)
    listed: dict[tuple[str, str], dict[str, Any]] = {}
    reverse_count = 0
    for src, dst, attributes in edges:
        if not directed and src != dst and listed.get((dst, src)) == attributes and (src, dst) not in listed:
            reverse_count += 1
        else:
            graph.add_edge(src, dst, **attributes)
        listed[src, dst] = attributes
    ways = sum(src != dst for src, dst in listed)  # a repeated edge, or one to its own node, has no reverse edge
    if directed is None and reverse_count < ways / 2 and all((dst, src) in listed for src, dst in listed):
        return listed_graph(file, nodes, edges, directed=True)  # the two directions of an edge differ
    if directed is None and (reverse_count or comment) and reverse_count < ways / 2:
        sign = (
            f"the comment {comment[:40]!r}"
            if comment
            else f"{reverse_count} of its edges in both directions and the others in one"
        )
        raise ValueError(f"{file} has {sign}: set directed = true if edges are one-way, or false")
    return graph
