"""The names that a package exports, each of which is imported on first access."""

import re
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from pathlib import Path

from desim.config.suggestion import did_you_mean

_IMPORT = re.compile(r"^    from (\S+) import (\w+) as \2\b", re.MULTILINE)


def homes_of_exports(file: str) -> dict[str, str]:
    """Return the module of each name that a package exports, in the order of its source.

    The package imports these names for type checkers, `from MODULE import NAME as NAME`, so no list repeats them.
    """
    source = Path(file).read_text(encoding="utf-8")
    return {name: home for home, name in _IMPORT.findall(source)}


def lazy_exports(
    package: str, file: str, elsewhere: Callable[[], Mapping[str, str]] = dict[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return the functions `__getattr__` and `__dir__` of a package, and its names for a star import.

    Args:
        package: the name of the package.
        file: its source, which imports its names for type checkers.
        elsewhere: returns, by missing name, the import that users mean; see `missing_export`.
    """
    homes = homes_of_exports(file)

    def export(name: str) -> object:
        if name not in homes:
            raise missing_export(package, name, homes, elsewhere())
        return getattr(import_module(homes[name]), name)

    return export, lambda: sorted(homes), sorted(homes)


def missing_export(package: str, name: str, names: Collection[str], elsewhere: Mapping[str, str]) -> Exception:
    """Return the error for a name that a package does not export.

    Args:
        package: the name of the package.
        name: the missing name.
        names: the names that it exports.
        elsewhere: by missing name, the import that users mean. The error about one of these names is an ImportError,
            because Python replaces the text of an AttributeError in `from package import name`.
    """
    imports = {export: f"from {package} import {export}" for export in names} | dict(elsewhere)
    meant = elsewhere.get(name)
    if meant is None and name != name.lower():  # a name in lower case may be that of a module
        meant = {key.lower(): text for key, text in imports.items()}.get(name.lower())
    if meant is not None:
        return ImportError(f"{package} has no {name!r}: write {meant}", name=package)
    return AttributeError(f"module {package!r} has no attribute {name!r}{did_you_mean(name, names)}")
