"""Modules beside scenario files, each loaded from its own file under a name of its own.

A module `rule` beside a file in the folder /a is imported as "rule@/a". A module `rule` beside another file is
therefore another module, and each of the two imports the modules of its own folder. If a plain import finds the same
file, for example because a script beside it has imported it, the module keeps its plain name. Hashes and texts have
plain names, which do not depend on the folder.

The folder is part of the name, so another process on this machine imports the same module by this name; a dot in the
folder is written as %2E, because dots separate packages.
"""

import ast
import os
import re
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import find_spec, spec_from_file_location
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

from desim.config.packages import PACKAGES

NOT_OWN = {*sys.stdlib_module_names, *PACKAGES, "desim"}
"""The modules that no file beside a scenario replaces."""
_LIBRARIES = {*sys.stdlib_module_names, "networkx", "numpy", "pydantic", "scipy", "simpy"} - {"__main__"}
"""The packages whose lines say nothing about the cause of an error or of a hang."""
IMPORTING = {"__import__", "import_module", "find_spec"}
"""The functions of Python that find a module by its name."""
_FOLDER = re.compile(r"@[^.]*")


class CodeName(str):
    """A name "module:name" whose module is looked up in another folder than that of the file.

    Args:
        text: the name.
        folder: the folder.
    """

    folder: Path

    def __new__(cls, text: str, folder: Path) -> "CodeName":
        """Create the name."""
        name = super().__new__(cls, text)
        name.folder = folder
        return name

    def __reduce__(self) -> tuple[type["CodeName"], tuple[str, Path]]:
        return CodeName, (str(self), self.folder)


def plain_name(name: str) -> str:
    """Return the name of a module, function or class without the folder of its module."""
    return _FOLDER.sub("", name) if "@" in name else name


def is_of_user(frame: FrameType) -> bool:
    """Return whether a frame runs code that belongs neither to desim, nor to Python, nor to an installed package."""
    top = plain_name(str(frame.f_globals.get("__name__", ""))).partition(".")[0]
    file = Path(frame.f_code.co_filename)
    is_library = top in {"desim", "protocols"} or top in _LIBRARIES
    return not is_library and not is_installed(file) and file.is_file()


@cache
def is_installed(file: Path) -> bool:
    """Return whether a module with this file belongs to Python or to an installed package.

    Packages are installed into folders with certain names or, by `pip install --target`, beside lists of their files.
    """
    if {"site-packages", "dist-packages"} & set(file.parts) or file.is_relative_to(Path(os.__file__).parent):
        return True
    while (file.parent / "__init__.py").is_file():
        file = file.parent
    return file.name.partition(".")[0] in _listed(file.parent)


@cache
def _listed(folder: Path) -> frozenset[str]:
    """Return the names of the modules and packages in a folder that are in the lists of installed files there."""
    lists = (record.read_text(encoding="utf-8", errors="replace") for record in folder.glob("*.dist-info/RECORD"))
    return frozenset(re.split(r"[./\\,]", line, maxsplit=1)[0] for text in lists for line in text.splitlines())


def module_beside(name: str, folder: Path) -> str:
    """Return the name under which a file in a folder imports a module, given its name in the file.

    This is the plain name unless the folder has the module and a plain import would find another file, or none.
    """
    top, _, submodule = name.partition(".")
    folder = folder.resolve()
    beside = None if top in NOT_OWN or "@" in name else PathFinder.find_spec(top, [str(folder)])
    if beside is None or not _is_hidden(top, beside):
        return name
    place = str(folder).replace("%", "%25").replace(".", "%2E").replace("@", "%40")
    return ".".join(filter(None, [f"{top}@{place}", submodule]))


def computed_name_beside(name: Any, folder: str) -> Any:
    """Return `module_beside` of a name that a file computes and then imports; a relative name as it is."""
    return module_beside(name, Path(folder)) if isinstance(name, str) and name[:1] != "." else name


def _is_hidden(top: str, beside: ModuleSpec) -> bool:
    """Return whether a plain import does not find the module beside a file, but another one or none."""
    imported = sys.modules.get(top)
    try:
        plain = find_spec(top) if imported is None else imported.__spec__
    except (ImportError, ValueError):
        plain = None
    if beside.origin is None:  # a folder without __init__.py; any other module of this name precedes it
        if plain is None:
            return True
        folders = set(beside.submodule_search_locations or ())
        return plain.origin is None and folders.isdisjoint(plain.submodule_search_locations or ())
    file = getattr(imported, "__file__", None) if plain is None else plain.origin
    return file is None or Path(file).resolve() != Path(beside.origin).resolve()


def folder_in_name(name: str) -> Path | None:
    """Return the folder in the name of a module; None if it has a plain name."""
    _, at, place = name.partition(".")[0].partition("@")
    return Path(place.replace("%40", "@").replace("%2E", ".").replace("%25", "%")) if at else None


class _Finder:
    """Finds the modules whose names have a folder."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        """Return the specification of a module; None if its name has no folder, or the folder no such module."""
        folder = folder_in_name(name)
        if folder is None:
            return None
        spec = PathFinder.find_spec(plain_name(name).rpartition(".")[2], [str(folder)] if path is None else path)
        if spec is None:
            return None
        places = spec.submodule_search_locations
        if spec.origin is None:  # a folder without __init__.py
            namespace = ModuleSpec(name, None, is_package=True)
            namespace.submodule_search_locations = list(places or ())
            return namespace
        if not isinstance(spec.loader, SourceFileLoader):  # compiled code loads under the name that is built into it
            return spec
        loader = OwnLoader(name, spec.origin)
        return spec_from_file_location(name, spec.origin, loader=loader, submodule_search_locations=places)


class OwnLoader(SourceFileLoader):
    """Loads a module such that its imports find the modules beside its file.

    Attributes:
        source: the source that was loaded last.
    """

    source: bytes

    def get_code(self, fullname: str) -> CodeType:
        """Return the code; it is not cached, because other programs import the file under its plain name."""
        self.source = self.get_data(self.path)
        tree = _Renaming(folder_in_name(fullname) or Path()).visit(ast.parse(self.source, self.path))
        return self.source_to_code(ast.fix_missing_locations(tree), self.path)


class _Renaming(ast.NodeTransformer):
    """Replaces the names of modules beside the file in the imports of a module.

    The new names are part of the code. An import inside a function therefore finds the right module whenever the
    function is called, even in another process to which only the function was sent.
    """

    def __init__(self, folder: Path):
        self._folder = folder

    def visit_Import(self, node: ast.Import) -> Any:
        """Import modules beside the file by their own names, and assign them to the variables of their plain names."""
        return [
            ast.copy_location(ast.Import([alias]), node) for imported in node.names for alias in self._aliases(imported)
        ]

    def _aliases(self, alias: ast.alias) -> Iterator[ast.alias]:
        renamed = module_beside(alias.name, self._folder)
        if renamed == alias.name:
            yield alias
        elif alias.asname is not None or "." not in alias.name:
            yield ast.alias(renamed, alias.asname or alias.name)
        else:  # `import package.module` makes a variable `package`
            yield ast.alias(renamed, "_")
            yield ast.alias(module_beside(alias.name.partition(".")[0], self._folder), alias.name.partition(".")[0])

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.ImportFrom:
        """Import from a module beside the file by its own name."""
        if node.level == 0 and node.module is not None:
            node.module = module_beside(node.module, self._folder)
        return node

    def visit_Call(self, node: ast.Call) -> ast.Call:
        """Let functions that import a module by its name find the modules beside the file."""
        self.generic_visit(node)
        if importing_call(node):
            node.args[:2] = map(self._own_name, node.args[:2])  # the second one may be a package
            for keyword in node.keywords:
                if keyword.arg in {"name", "package"}:
                    keyword.value = self._own_name(keyword.value)
        return node

    def _own_name(self, name: ast.expr) -> ast.expr:
        """Return an expression that computes the own name of a module; it also works in another process."""
        if isinstance(name, ast.Starred):  # any number of names: they are looked up as they are
            return name
        code = f"__import__({__name__!r}, fromlist=['']).computed_name_beside(0, {str(self._folder)!r})"
        call: Any = ast.parse(code, mode="eval").body
        call.args[0] = name
        expression: ast.expr = ast.copy_location(call, name)
        return expression


def importing_call(node: ast.Call) -> bool:
    """Return whether a call imports a module by its name, as `importlib.import_module` does."""
    called = node.func
    name = called.id if isinstance(called, ast.Name) else getattr(called, "attr", "")
    return name in IMPORTING


def find_own_modules() -> None:
    """Let Python import modules by the names that `module_beside` returns."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
