"""Nested tables and lists, as TOML and JSON have them: the values at places, and names that are given twice."""

from collections.abc import Iterable, Iterator
from functools import reduce
from operator import getitem
from typing import Any

from desim.config.errors import KeyPath


def holds(node: Any, key: Any) -> bool:
    """Return whether a table contains a key, or a list has an index."""
    return key in node if isinstance(node, dict) else isinstance(node, list | tuple) and key in range(len(node))


def value_at(tables: Any, place: KeyPath) -> Any:
    """Return the value at a place in tables."""
    return reduce(getitem, place, tables)


def nested(node: Any, place: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the place and the value of everything in a table or list; a table or list comes before its content."""
    inner = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list | tuple) else ()
    for key, value in inner:
        yield (*place, key), value
        yield from nested(value, (*place, key))


def check_once(names: Iterable[str | None], owner: str) -> None:
    """Raise ValueError if a name is given twice: some readers take its first value, others its last.

    None stands for a thing without a name, of which there may be several.
    """
    seen = set[str | None]()
    for name in names:
        if name is not None and name in seen:
            raise ValueError(f"{owner} has {name!r} twice")
        seen.add(name)


def object_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON (`object_pairs_hook`); raise ValueError if it has a key twice."""
    check_once((name for name, _ in pairs), "an object")
    return dict(pairs)
