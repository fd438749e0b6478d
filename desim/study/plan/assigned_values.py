"""Values of the variables of a user's module that do not follow from its source.

Of one kind are constants that a program has replaced since the import, as in `my_rules.GAIN = 2.0`. A constant is a
variable of the module, or an attribute of a class in it, that the source sets once, to a literal. What code of the
module itself changes is no constant, and neither is a collection or a counter that code of another module of the run
changes: it is the state of a run, of which `desim.config.shared_state` warns.

Of the other kind is what a module or a class in it reads from a file at its import, as in
`WEIGHTS = np.load("weights.npy")`. A call reads a file if a word of its name says so, or if it calls a function of the
module that does, as in `WEIGHTS = _weights()`.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Set
from enum import Enum
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from desim.config.code_variables import ADDING

PLAIN = (int, float, bool, str, bytes, complex, type(None))
"""The types of plain values without parts."""
CHANGING = ADDING | {"pop", "popitem", "clear", "setdefault", "insert", "remove", "discard", "sort", "reverse"}
"""The methods that change a collection."""
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
"""A word in a name, as in `load_weights` or `DictReader`."""
READING = {
    *("read", "reads", "reader", "load", "loads", "open", "fromfile", "genfromtxt", "loadtxt", "loadmat", "memmap"),
    *("imread", "mmread"),
}
"""The words in names of functions that read files. What `open_data` opens is hashed already."""


def values_beside_source(
    module: ModuleType, source: bytes, state: Set[str], *, with_files: bool = True
) -> dict[str, Any]:
    """Return the present values of the variables of a module that do not follow from its source, by name.

    They are the constants whose values differ from those in the source, and what the module has read from files.
    "Class.name" is an attribute of a class.

    Args:
        module: the module.
        source: its source.
        state: the names of variables that modules of the run change in others, see `changed_in_place`.
        with_files: whether what the module has read from files is returned.
    """
    constants = _constants(source)
    assigned = {
        name: value
        for name, value in _present(module, constants)
        if _may_differ(value, name) and _text(value) != constants[name]
    }
    values = assigned | dict(_present(module, _names_from_files(source) if with_files else ()))
    return {name: value for name, value in values.items() if _last_part(name) not in state}


def _present(module: ModuleType, names: Iterable[str]) -> Iterator[tuple[str, Any]]:
    """Yield the name and the value of each variable that the module has."""
    for name in names:
        owner, _, attribute = name.rpartition(".")
        holder = vars(module).get(owner) if owner else module
        if isinstance(holder, type | ModuleType) and attribute in vars(holder):
            yield name, vars(holder)[attribute]


def _may_differ(value: Any, name: str) -> bool:
    """Return whether a value may have been assigned; Python itself makes others of some literals in a class."""
    return "." not in name or not (isinstance(value, Enum) or hasattr(value, "__set__"))


@cache
def _names_from_files(source: bytes) -> tuple[str, ...]:
    """Return the names of the variables that a module reads from files at its import, sorted."""
    tree = ast.parse(source)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    reading = {function.name for function in functions if _reads(function, set())}
    names = {*_names_read(tree.body, reading)}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            names.update(f"{node.name}.{name}" for name in _names_read(node.body, reading))
    changed = set(_changed(tree))
    return tuple(sorted(name for name in names if _last_part(name) not in changed))


def _names_read(body: list[ast.stmt], reading: Set[str]) -> Iterator[str]:
    """Yield the names that those of some statements set that read files, themselves or by functions of the module."""
    kinds = (ast.Assign, ast.AnnAssign, ast.With, ast.For, ast.Try, ast.If)
    for statement in (statement for statement in body if isinstance(statement, kinds) and _reads(statement, reading)):
        parts = ast.walk(statement)
        yield from (part.id for part in parts if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store))


def _reads(node: ast.AST, reading: Set[str]) -> bool:
    """Return whether code calls a function that reads a file, by the words in its name or if it is one of `reading`."""
    called = {_last_name(part.func) for part in ast.walk(node) if isinstance(part, ast.Call)}
    words = {word.lower() for name in called for word in WORD.findall(name)}
    return "open_data" not in called and not (words.isdisjoint(READING) and called.isdisjoint(reading))


@cache
def _constants(source: bytes) -> Mapping[str, str]:
    """Return the constants of a module and their values in its source, as texts; "Class.name" is one of a class."""
    tree = ast.parse(source)
    changed = set(_changed(tree))
    constants = dict(_literals(tree.body))
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            constants |= {f"{node.name}.{name}": text for name, text in _literals(node.body)}
    return {name: text for name, text in constants.items() if _last_part(name) not in changed}


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
    yield from map(_last_name, _changed_in_place(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Global):
            yield from node.names
        elif isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load):
            yield node.attr


@cache
def changed_in_place(source: bytes) -> frozenset[str]:
    """Return the names of the collections and counters of other modules that code of a module may change.

    What it assigns in other modules does not count: it may be a program that sets their constants.
    """
    tree = ast.parse(source)
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    aliases = [alias for node in imports for alias in node.names]
    imported = {alias.asname or alias.name.partition(".")[0]: alias.name for alias in aliases}
    changed = [(_root(target), _last_name(target)) for target in _changed_in_place(tree)]
    return frozenset(imported[root] if name == root else name for root, name in changed if root in imported)


def _changed_in_place(tree: ast.Module) -> Iterator[ast.expr]:
    """Yield expressions for the collections and counters that code of a module may change."""
    for node in ast.walk(tree):
        if isinstance(node, ast.AugAssign):
            yield node.target
        elif isinstance(node, ast.Subscript):
            yield from [] if isinstance(node.ctx, ast.Load) else [node.value]
        elif isinstance(node, ast.Attribute) and node.attr in CHANGING:
            yield node.value


def _root(node: ast.expr) -> str:
    """Return the name of the variable with which an expression begins."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return getattr(node, "id", "")


def _last_part(name: str) -> str:
    return name.rpartition(".")[2]


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
