"""The packages `protocols` and `scenarios`, installed beside `desim`: their folders, and a check that none is hidden.

Functions of higher packages that `desim.scenario` and `desim.config` call are here, too. A package or module of the
same name that comes earlier in `sys.path`, for example beside a script, hides a package.
"""

import sys
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

_SITE = Path(__file__).parents[2]
PACKAGES = ("protocols", "scenarios")
ENVIRONMENTS: dict[str, Callable[..., Any]] = {}
"""By name, the functions that make environments for learners.

`desim` hands them in: `desim.scenario` calls them, and may not import the package above it that defines them."""
MARGINS: dict[str, Callable[[Any, str], float]] = {}
"""The function, by its name, that returns how far a run is from violating a property, given the name of the property.

`desim` hands it in: `desim.scenario` calls it, and may not import the package above it that defines it."""
KINDS_OF: dict[str, Callable[[], Mapping[str, Mapping[str, str]]]] = {}
"""By package, a function that returns its kinds: for each group, "module:name" by kind.

`desim` hands them in, because the packages with kinds are above this one."""


class HiddenPackageError(ImportError):
    """Raised when another package or module of the same name hides a package that is installed beside `desim`."""


def package_folder(package: str) -> Path:
    """Return the folder of a package that is installed beside `desim`, even if another package hides it."""
    return _SITE / package


def check_visible(package: str) -> None:
    """Raise HiddenPackageError if another package or module of this name would be imported; import nothing."""
    ours = package_folder(package)
    spec = find_spec(package)
    if spec is None or spec.origin is None or not ours.is_dir():
        return
    origin = Path(spec.origin).resolve()
    if origin == (ours / "__init__.py").resolve():
        return
    raise HiddenPackageError(
        f"{origin.parent if origin.name == '__init__.py' else origin} hides the package {package!r} of desim, {ours}:"
        " rename it, or start Python with -P, which keeps the folder of a script and the working directory out of"
        " sys.path",
        name=package,
    )


class _HiddenModuleFinder:
    """The last finder in `sys.meta_path`; it explains why no finder has found a module of a hidden package."""

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None, /) -> None:
        """Raise HiddenPackageError if the module belongs to a hidden package."""
        package, _, module = name.partition(".")
        path = _SITE / name.replace(".", "/")
        ours = path.with_suffix(".py"), path / "__init__.py"
        if package in PACKAGES and module and any(file.is_file() for file in ours):
            check_visible(package)


def explain_hidden_packages() -> None:
    """Make the import of a module of a hidden package raise HiddenPackageError, not ModuleNotFoundError."""
    if not any(isinstance(finder, _HiddenModuleFinder) for finder in sys.meta_path):
        sys.meta_path.append(_HiddenModuleFinder())
