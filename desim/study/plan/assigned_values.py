"""Values of the variables of a user's module that do not follow from its source.

Of one kind are constants that a program has replaced since the import, as in `my_rules.GAIN = 2.0`.
The source of the module does not tell them, so they are a part of the hash of its code. A constant is a variable of
the module, or an attribute of a class in it, that the source sets once, to a literal. What code of the module itself
changes is no constant: it is the state of a run, of which `desim.config.shared_state` warns.

Of the other kind is what a module reads from a file at its import, as in `WEIGHTS = np.load("weights.npy")`.
"""

import ast
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from desim.config.code_variables import ADDING

PLAIN = (int, float, bool, str, bytes, complex, type(None))
"""The types of plain values without parts."""
CHANGING = ADDING | {"pop", "popitem", "clear", "setdefault", "insert", "remove", "discard", "sort", "reverse"}
"""The methods that change a collection."""
READING = {
    *("open", "load", "loads", "loadtxt", "genfromtxt", "fromfile", "loadmat", "read_text", "read_bytes", "DictReader"),
    *("read_csv", "read_parquet", "read_json", "read_excel", "read_table", "read_pickle", "read_graphml", "reader"),
}
"""The names of functions that read files. What `open_data` opens is hashed already."""


def assigned_values(module: ModuleType, source: bytes) -> dict[str, str]:
    """Return the present values of constants that differ from the source of a module, by name, as texts."""
    values = {}
    for name, literal in _constants(source).items():
        owner, _, attribute = name.rpartition(".")
        holder = vars(module).get(owner) if owner else module
        if isinstance(holder, type | ModuleType) and attribute in vars(holder):
            text = _text(vars(holder)[attribute])
            if text is not None and text != literal:
                values[name] = text
    return values


def values_from_files(module: ModuleType, source: bytes) -> dict[str, Any]:
    """Return the present values of the variables that a module has read from files at its import, by name."""
    return {name: vars(module)[name] for name in _names_from_files(source) if name in vars(module)}


@cache
def _names_from_files(source: bytes) -> tuple[str, ...]:
    tree = ast.parse(source)
    names = set[str]()
    for statement in tree.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign | ast.With | ast.For | ast.Try | ast.If):
            parts = list(ast.walk(statement))
            called = {_last_name(part.func) for part in parts if isinstance(part, ast.Call)}
            if called & READING and "open_data" not in called:
                names.update(
                    part.id for part in parts if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
                )
    return tuple(sorted(names - set(_changed(tree))))


@cache
def _constants(source: bytes) -> Mapping[str, str]:
    """Return the constants of a module and their values in its source, as texts; "Class.name" is one of a class."""
    tree = ast.parse(source)
    changed = set(_changed(tree))
    constants = dict(_literals(tree.body))
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            constants |= {f"{node.name}.{name}": text for name, text in _literals(node.body)}
    return {name: text for name, text in constants.items() if name.rpartition(".")[2] not in changed}


def _literals(body: list[ast.stmt]) -> Iterator[tuple[str, str]]:
    """Yield the names that some statements set once, to a literal, and the literals as texts."""
    stored = Counter(
        part.id
        for statement in body
        if not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        for part in ast.walk(statement)
        if isinstance(part, ast.Name) and not isinstance(part.ctx, ast.Load)
    )
    for statement in body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None or len(targets) > 1:
            continue
        (target,) = targets
        try:
            text = _text(ast.literal_eval(statement.value))
        except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
            continue
        if isinstance(target, ast.Name) and stored[target.id] == 1 and text is not None and target.id[:2] != "__":
            yield target.id, text


def _changed(tree: ast.Module) -> Iterator[str]:
    """Yield the names of variables and attributes that code of a module may change while it runs."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Global):
            yield from node.names
        elif isinstance(node, ast.Attribute | ast.Subscript) and not isinstance(node.ctx, ast.Load):
            yield node.attr if isinstance(node, ast.Attribute) else _last_name(node.value)
        elif isinstance(node, ast.Attribute) and node.attr in CHANGING:
            yield _last_name(node.value)


def _last_name(node: ast.expr) -> str:
    """Return the name of the variable or attribute that an expression reads, or in which it looks up items."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _text(value: Any) -> str | None:
    """Return a text that tells values apart, the same for numbers of numpy; None if a value is more than plain data."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    kind = type(value)
    if kind in PLAIN:
        return repr(value)
    if kind in {list, tuple, set, frozenset}:
        texts = [_text(item) for item in value]
        ordered = texts if kind in {list, tuple} else sorted(map(str, texts))
        return None if None in texts else f"{kind.__name__}({', '.join(map(str, ordered))})"
    if kind is dict:
        pairs = [(_text(key), _text(item)) for key, item in value.items()]
        return None if any(None in pair for pair in pairs) else f"dict({pairs})"
    return None
