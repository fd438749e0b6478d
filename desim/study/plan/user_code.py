"""User code: the source of the modules that a run uses besides `desim` and `protocols`, and of all that they import.

A module that was edited after its import runs as it was imported, and so it is hashed: see `_as_imported`.
"""

import ast
import json
import marshal
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.metadata import PackageNotFoundError, packages_distributions, requires, version
from importlib.util import find_spec, resolve_name
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, NamedTuple

from desim.config.data_files import content_hash, opened_by
from desim.config.own_modules import OwnLoader, folder_in_name, importing_call, is_installed, module_beside, plain_name
from desim.config.traits import OURS
from desim.results.environment import NUMERICS
from desim.study.plan.assigned_values import changed_in_place, values_beside_source

HASHED_BY_NAME = {*OURS, *NUMERICS, "cloudpickle", *sys.stdlib_module_names}
"""The packages whose classes and functions are hashed by name only."""


class UserCode:
    """The hashes of user modules and of what they depend on.

    Adding a module also adds the user modules that it imports directly or indirectly, the data files that these modules
    have opened, and the versions of the installed packages that they import, except those in `HASHED_BY_NAME`. If the
    module is itself installed, all modules of its package are added instead.

    Attributes:
        code: the hash of the source of each user module, the version of each installed package, and what a caller adds,
            by name.
        files: the hash of the content of each data file, by path.
        edited: the file of each module that was edited after its import, by name.
    """

    def __init__(self) -> None:
        self.code: dict[str, str] = {}
        self.files: dict[str, str] = {}
        self.edited: dict[str, Path] = {}
        self._modules: set[str] = set()
        self._sources: dict[str, tuple[str, bytes]] = {}
        """The name and the source of each module that is imported, by the key of its hash."""

    def add(self, name: str) -> bool:
        """Add a module; return whether it has a source, or belongs to a package in `HASHED_BY_NAME`."""
        if name in self._modules or package_of(name) in HASHED_BY_NAME:
            return True
        file = None if name == "__main__" else _file(name)
        if file is None:
            return False
        self.files |= opened_by(name)
        if is_installed(file):
            self.code |= _package(package_of(name), file)
            return True
        imported = _as_imported(name, file)
        source = imported.source
        self.edited |= {plain_name(name): file} if imported.content != file.read_bytes() else {}
        self._modules.add(name)
        key = plain_name(name)
        while key in self.code:  # another module of this name lies beside another scenario file
            key += "'"
        self.code[key] = content_hash(imported.content)
        parent, folder = name.rpartition(".")[0], folder_in_name(name)
        if file.suffix == ".py":
            if name in sys.modules:
                self._sources[key] = name, source
            # To import a module is to run its parent package, too.
            names = sorted(_imported(source, name if file.stem == "__init__" else parent) | ({parent} - {""}))
            self.add_imported(names if folder is None else [module_beside(module, folder) for module in names])
        return True

    def add_imported(self, names: Iterable[str]) -> None:
        """Add modules that code may import: of an installed package only its version, because the code may not run.

        A name "package.*" stands for all modules in a package.
        """
        for module in names:
            if module.endswith(".*"):
                self.add_imported(_modules_in(module[:-2]))
                continue
            package = package_of(module)
            if (package_file := _file(package)) is None or not is_installed(package_file):
                self.add(module)
            elif package not in HASHED_BY_NAME:
                self.code |= _versions(_distributions().get(package, ()))

    def values(self) -> dict[str, dict[str, Any]]:
        """Return the values of variables that do not follow from the source of their module, by module and name."""
        state = frozenset[str]().union(*(changed_in_place(source) for _, source in self._sources.values()))
        return {
            key: values_beside_source(sys.modules[name], source, state, with_files=not _IMPORTED[name].is_late)
            for key, (name, source) in self._sources.items()
        }


class Imported(NamedTuple):
    """What is known of a module of a user."""

    spec: ModuleSpec | None
    """Its specification, which is another one after the module was reloaded; None if it has yet to be imported."""
    content: bytes
    """What is hashed: its source, or its compiled code if the source was edited before it was first read."""
    source: bytes
    """The source in which its imports are looked up."""
    is_late: bool
    """Whether it was first hashed before its import, by a run perhaps, when nothing is known of what it reads."""


_IMPORTED: dict[str, Imported] = {}
"""The imported modules of users by name, since they were first hashed."""


def _as_imported(name: str, file: Path) -> Imported:
    """Return what is known of the code of a module that runs, which is older than a file that was edited since."""
    spec = getattr(sys.modules.get(name), "__spec__", None)
    known = _IMPORTED.get(name)
    if known is None or known.spec is not spec or spec is None:
        source = spec.loader.source if spec and isinstance(spec.loader, OwnLoader) else file.read_bytes()
        is_late = spec is None if known is None else known.is_late
        known = Imported(spec, (spec and _edited_code(spec, file, source)) or source, source, is_late)
        _IMPORTED[name] = known
    return known


def _edited_code(spec: ModuleSpec, file: Path, source: bytes) -> bytes:
    """Return the compiled code of a module whose source was edited after Python compiled it; b"" if it was not.

    A source that was only saved again, or touched, gives the same code.
    """
    cached = Path(spec.cached or "")
    is_written = type(spec.loader) is SourceFileLoader and not sys.dont_write_bytecode
    if not (is_written and cached.is_file() and os.access(cached.parent, os.W_OK)):  # it may be of an older import
        return b""
    compiled, status = cached.read_bytes(), file.stat()
    flags, modified, size = (int.from_bytes(compiled[k : k + 4], "little") for k in (4, 8, 12))
    is_of_source = flags != 0 or (modified, size) == (int(status.st_mtime) & 0xFFFFFFFF, status.st_size & 0xFFFFFFFF)
    return b"" if is_of_source or _is_code_of(source, file, compiled[16:]) else compiled[16:]


def _is_code_of(source: bytes, file: Path, compiled: bytes) -> bool:
    """Return whether Python compiles a source to some code; the bytes may differ, because they depend on references."""
    try:
        return bool(SourceFileLoader(file.stem, str(file)).source_to_code(source, str(file)) == marshal.loads(compiled))
    except (SyntaxError, ValueError, TypeError, EOFError):  # one of them is not valid
        return False


@cache
def _package(name: str, file: Path) -> Mapping[str, str]:
    """Return the hash of all modules of an installed package, and the versions of its distribution and requirements.

    Args:
        name: the name of the package, or of a module without a package.
        file: the file of the module, for a module without a package.
    """
    folders = [Path(folder_name) for folder_name in getattr(sys.modules[name], "__path__", ())]
    files = [(folder, path) for folder in folders for path in sorted(folder.rglob("*.py"))] or [(file.parent, file)]
    hashes = [(path.relative_to(folder).as_posix(), content_hash(path.read_bytes())) for folder, path in files]
    distributions = _distributions().get(name, ())
    lines = [line for distribution in distributions for line in requires(distribution) or () if "extra ==" not in line]
    requirements = {re.split(r"[^\w.-]", line)[0] for line in lines} - HASHED_BY_NAME
    return {name: content_hash(json.dumps(hashes).encode()), **_versions([*distributions, *sorted(requirements)])}


_distributions = cache(packages_distributions)
"""Returns the names of the distributions of each installed package."""


def _versions(distributions: Iterable[str]) -> dict[str, str]:
    """Return the version of each distribution, without those that are not installed."""
    versions = {}
    for name in distributions:
        with suppress(PackageNotFoundError):  # such as a requirement on another platform
            versions[f"distribution {name}"] = _version(name)
    return versions


_version = cache(version)  # `version` reads a file, and each configuration asks for all packages that user code imports


def _file(name: str) -> Path | None:
    """Return the file of a module, imported or not; None if it has none."""
    if name in sys.modules:
        path = getattr(sys.modules[name], "__file__", None)
    else:
        try:
            spec = find_spec(name)
        except (ImportError, ValueError):
            return None
        path = spec.origin if spec and spec.has_location else None
    return None if path is None else Path(path)


@cache
def _imported(source: bytes, package: str) -> frozenset[str]:
    """Return the names of all modules that a source in a package may import, also within functions.

    A module that is imported by a text counts if the text is in the call, as in `import_module("rules")`.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            with suppress(ImportError):  # a relative import outside of a package
                module = resolve_name("." * node.level + (node.module or ""), package)
                names.update([module, *(f"{module}.{alias.name}" for alias in node.names)])
        elif isinstance(node, ast.Call) and importing_call(node):
            constants = (part.value for part in ast.walk(node) if isinstance(part, ast.Constant))
            texts = [text for text in constants if isinstance(text, str)]
            names.update(names_in_texts(_absolute(text, package) for text in texts))
    return frozenset(names)


def _absolute(text: str, package: str) -> str:
    """Return a text that names a module, or begins such a name, without the dots by which it is relative."""
    name = text.lstrip(".")
    dots = len(text) - len(name)
    return f"{package.rsplit('.', dots - 1)[0]}.{name}" if dots else text


def names_in_texts(texts: Iterable[str]) -> Iterator[str]:
    """Yield the names of modules that code may import by texts; "package.*" for a text that is completed later.

    An example is "rules.{}" in `import_module("rules.{}".format(name))`, and "rules." of an f-string.
    """
    for text in texts:
        name = re.split(r"[^\w.]", text, maxsplit=1)[0]
        if name.startswith("."):
            continue
        if name and name == text and not name.endswith("."):
            yield name
        elif package := name.rpartition(".")[0]:
            yield f"{package}.*"


def _modules_in(package: str) -> list[str]:
    """Return the names of the modules in a package of a user, sorted; none if it is no package, or an installed one."""
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):
        return []
    folders = [folder for folder in (spec and spec.submodule_search_locations) or () if not is_installed(Path(folder))]
    return [package, *sorted(f"{package}.{module.name}" for module in iter_modules(folders))] if folders else []


def package_of(module: Any) -> str:
    """Return the name of the outermost package of a module."""
    return str(module).partition(".")[0]
