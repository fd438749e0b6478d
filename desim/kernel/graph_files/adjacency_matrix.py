"""Adjacency matrices as text: a line per sender, and in it a number per receiver, which is 0 where there is no link.

Names of the nodes may stand in a first line and at the beginning of each line:

    ,base,uav1,uav2
    base,0,1,0
    uav1,1,0,1
    uav2,0,1,0

A symmetric matrix has edges that hold both ways. Any other matrix may have one-way links, or be half of a symmetric
matrix; the user says which.
"""

from collections.abc import Sequence
from itertools import chain
from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from desim.kernel.measured.csv_tables import plain_rows
from desim.kernel.measured.latency_file import UnclearNamesError, counts_of, names_beside
from desim.kernel.measured.measurements import number_or_nan

if TYPE_CHECKING:
    import networkx as nx

MIN_NODES = 3
"""Smallest number of nodes; with fewer, lines are edges."""


def read_matrix(file: Path, text: str, directed: bool | None) -> "nx.Graph[Any] | None":
    """Return the graph of an adjacency matrix; None if the text is none.

    A number other than 0 and 1 is the attribute `weight` of an edge, which is not read. The diagonal does not count.

    Args:
        file: the path, for error messages.
        text: the text.
        directed: whether edges are one-way; None if it is not known.

    Raises:
        ValueError: if the matrix is not symmetric and `directed` is None, or its first line may be numbers or names of
            nodes.
    """
    import networkx as nx

    lines = [line for line in text.split("\n") if line.strip() and line.strip()[0] != "#"]
    if not lines or len(lines) > len(lines[0]) + 1:  # too many for a matrix: long lists are not parsed twice
        return None
    try:
        rows = [[cell.strip() for cell in cells] for _, cells in plain_rows(text, str(file))]
        names, numbers = _names_and_numbers(rows)
    except UnclearNamesError as error:
        raise ValueError(f"{file}: {error}") from error
    except ValueError:
        return None
    size = len(numbers)
    if size < MIN_NODES or any(len(row) != size for row in numbers):
        return None
    if not names and numbers[0][1:] == [row[0] for row in numbers[1:]] and numbers[0][1:] in counts_of(size - 1):
        raise ValueError(
            f"{file}: the first line may number the nodes: write a text into its first cell, or leave it out"
        )
    if size == MIN_NODES and not names and not all(_is_link_or_none(*cell) for cell in enumerate(chain(*numbers))):
        return None  # lines of three numbers may also be edges with weights
    weights = {
        (src, dst): weight
        for src, row in enumerate(numbers)
        for dst, weight in enumerate(row)
        if weight and src != dst and isfinite(weight)
    }
    is_symmetric = all(weights.get((dst, src)) == weight for (src, dst), weight in weights.items())
    if directed is None and not is_symmetric:
        raise ValueError(
            f"{file} is a matrix that is not symmetric: set directed = true if edges are one-way, or false"
        )
    graph: nx.Graph[Any] = nx.DiGraph() if directed else nx.Graph()
    graph.add_nodes_from(names or map(str, range(size)))
    nodes = list(graph)
    for (src, dst), weight in weights.items():
        graph.add_edge(nodes[src], nodes[dst], **({} if weight == 1.0 else {"weight": weight}))
    return graph


def _is_link_or_none(index: int, number: float) -> bool:
    """Return whether a number is 0 or 1, or is missing on the diagonal of a matrix of three nodes."""
    return number in {0.0, 1.0} or (index % (MIN_NODES + 1) == 0 and isnan(number))


def _names_and_numbers(rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[float]]]:
    """Return the names of the nodes, an empty list if the matrix has none, and its numbers.

    Raises:
        ValueError: if a cell is not a number, or the names of lines and of columns differ.
    """
    names = list(names_beside(rows)) if len(rows) > MIN_NODES else []
    if len({*names}) < len(names):
        raise ValueError("the names should differ from each other")
    inner = [row[1:] for row in rows[1:]] if names else rows
    return names, [[number_or_nan(cell) for cell in row] for row in inner]
