"""The strings below the fields of a model, which describe them: read from its source when somebody asks.

pydantic does so for every model as it is made (`use_attribute_docstrings`), which takes longer than a short run.
"""

import ast
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from inspect import cleandoc, get_annotations, getsource
from itertools import pairwise
from types import MappingProxyType

Docs = Mapping[str, str]
"""What each name in a class is, if a string below it says so."""


def docs_of(model: type) -> Docs:
    """Return the string below each annotated name of a class, or of one it derives from, if there is one."""
    found: dict[str, str] = {}
    for each in reversed(model.__mro__):
        own = _docs(each.__module__).get(each.__qualname__, {})
        found = {**{name: text for name, text in found.items() if name not in get_annotations(each)}, **own}
    return found


@cache
def _docs(module: str) -> Mapping[str, Docs]:
    """Return the strings below names in each class of a module; none if its source is not at hand."""
    try:
        tree = ast.parse(getsource(sys.modules[module]))
    except (KeyError, OSError, TypeError):
        return MappingProxyType({})
    return MappingProxyType(dict(_classes(tree, "")))


def _classes(node: ast.AST, above: str) -> Iterator[tuple[str, Docs]]:
    """Yield the qualified name of each class within a node of a syntax tree, and the strings below names in it."""
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.ClassDef):
            yield above + inner.name, dict(_strings(inner))
            yield from _classes(inner, f"{above}{inner.name}.")
        else:
            within = f"{above}{inner.name}.<locals>." if isinstance(inner, ast.FunctionDef) else above
            yield from _classes(inner, within)


def _strings(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for field, below in pairwise(node.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, cleandoc(text)
