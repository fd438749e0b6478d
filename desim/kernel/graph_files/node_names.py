"""Numbers for the nodes of a graph that may have any names, and the names by number.

1. If the labels or the names of the nodes are 0 .. n - 1, each node keeps its number.
2. If the nodes have other integers, they are numbered in ascending order.
3. Otherwise the nodes are numbered in the order of the graph: of a file, the order in which it names them.
"""

import re
from collections.abc import Sequence
from operator import index
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import networkx as nx

LABELS = ("label", "name")
"""The attributes in which programs keep the names of nodes that their users see."""
SHOWN = 5
"""Number of names in a message."""


class Numbering(NamedTuple):
    """The numbers of the nodes of a graph."""

    numbers: dict[Any, int]
    """The number of each node."""
    names: tuple[str, ...]
    """The name of each node by number; empty if the names are the numbers."""
    is_shifted: bool
    """Whether the names are integers other than the numbers."""


def numbered(graph: "nx.Graph[Any]") -> Numbering:
    """Return the numbers of the nodes of a graph.

    Raises:
        ValueError: if both the nodes and their labels are 0 .. n - 1, in different orders.
    """
    nodes = list(graph)
    name_integers, labels = _integers(nodes), _labels(graph)
    label_integers = None if labels is None else _integers(labels)
    plain_numbers = set(range(len(nodes)))
    names_are_plain, labels_are_plain = (
        integers is not None and set(integers) == plain_numbers for integers in (name_integers, label_integers)
    )
    if names_are_plain and labels_are_plain and name_integers != label_integers:
        k = next(k for k in range(len(nodes)) if name_integers[k] != label_integers[k])  # type: ignore[index]
        raise ValueError(f"node {nodes[k]!r} has the label {labels[k]!r}, so that its number is not clear")  # type: ignore[index]
    if labels_are_plain and label_integers is not None:
        numbers = label_integers
    elif names_are_plain and name_integers is not None:
        numbers = name_integers
    else:
        order = range(len(nodes)) if name_integers is None else sorted(range(len(nodes)), key=name_integers.__getitem__)
        numbers = [0] * len(nodes)
        for number, k in enumerate(order):
            numbers[k] = number
    texts = [_name(*pair) for pair in zip(nodes if labels is None else labels, numbers, strict=True)]
    names = tuple(text for _, text in sorted(zip(numbers, texts, strict=True)))
    is_plain = names == tuple(map(str, range(len(nodes))))
    is_shifted = (
        not (names_are_plain or labels_are_plain) and (name_integers if labels is None else label_integers) is not None
    )
    return Numbering(dict(zip(nodes, numbers, strict=True)), () if is_plain else names, is_shifted)


def _name(node: Any, number: int) -> str:
    """Return the name of a node: its text, or its type and number if the text has an address, which differs by run."""
    kind: Any = type(node)
    is_default = kind.__repr__ is object.__repr__ and kind.__str__ is object.__str__
    return f"{kind.__name__} {number}" if is_default else str(node)


def shortened(names: Sequence[str]) -> str:
    """Return the first names, in the order of their numbers, as a text."""
    return ", ".join([*names[:SHOWN], *(["..."] if len(names) > SHOWN else [])])


def _labels(graph: "nx.Graph[Any]") -> list[Any] | None:
    """Return the labels of the nodes, without white space around them, if all have different ones."""
    for key in LABELS:
        values = (attributes.get(key) for _, attributes in graph.nodes(data=True))
        labels = [label.strip() if isinstance(label, str) else label for label in values]
        if labels and None not in labels and "" not in labels and len(set(map(str, labels))) == len(labels):
            return labels
    return None


def _integers(names: Sequence[Any]) -> list[int] | None:
    """Return names as integers if all are different integers, or texts of their decimal digits; else None."""
    converted = [_integer(name) for name in names]
    integers = [number for number in converted if number is not None]
    return integers if len(set(integers)) == len(names) else None


def _integer(name: Any) -> int | None:
    """Return a name as an integer if it is one, also a whole float such as 1.0; None for any other."""
    if isinstance(name, str):
        name = re.sub(r"(?<=\d)\.0+$", "", name)  # as tables write integers of columns with missing values
        is_digits = name.isascii() and name.removeprefix("-").isdecimal()
        return int(name) if is_digits and str(int(name)) == name else None
    if isinstance(name, float) and name.is_integer():
        return int(name)
    try:
        return None if isinstance(name, bool) else index(name)  # also of numpy
    except TypeError:
        return None
