"""Code that a file names as "module:name": when it may be imported, its import, and the name of a definition."""

from collections.abc import Mapping
from functools import cache, reduce
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import Any

from pydantic import PydanticUserError, ValidationInfo

from desim.config.own_modules import CodeName, find_own_modules, module_beside, plain_name
from desim.config.packages import KINDS_OF
from desim.config.suggestion import did_you_mean
from desim.config.trust import ALLOW_HINT, is_trusted

find_own_modules()


def definition_of(value: Any) -> Any:
    """Return the function or class that defines a value: a function itself, or the class of an object."""
    return value if isinstance(value, FunctionType) else type(value)


def import_name(definition: Any) -> str:
    """Return the `kind` "module:name" that selects a function or class without an entry point.

    Code that `exec` runs in a dict of its own has no module, and counts as that of a script.
    """
    module = definition.__module__
    return f"{plain_name(module) if isinstance(module, str) else '__main__'}:{definition.__qualname__}"


IMPORTED = "^[^:]+:[^:]+$"
"""Matches a kind "module:name"."""


def is_unlisted_import(kind: Any) -> bool:
    """Return whether a kind is a "module:name" that neither `KINDS_OF` nor a `desim.*` entry point refers to."""
    return isinstance(kind, str) and ":" in kind and kind not in _named_by_entry_points()


def entry_points_of(group: str) -> list[EntryPoint]:
    """Return the entry points of a group: those of other distributions, then one for each kind in `KINDS_OF`.

    No distribution needs to declare the latter.
    """
    tables = [kinds().get(group, {}) for kinds in KINDS_OF.values()]
    listed = [EntryPoint(kind, definition, group) for table in tables for kind, definition in table.items()]
    return [*entry_points(group=group), *listed]


def refusal(kind: str) -> str:
    """Return the error message for an untrusted file that names code."""
    return f"{kind!r} names code to be run; {ALLOW_HINT}"


@cache
def _named_by_entry_points() -> Mapping[str, EntryPoint]:
    """Return all entry points of groups `desim.*`, those of `KINDS_OF` included, by "module:name"."""
    groups = set(entry_points().groups).union(*(kinds() for kinds in KINDS_OF.values()))
    points = (point for group in groups if group.startswith("desim.") for point in entry_points_of(group))
    return MappingProxyType({f"{point.module}:{point.attr}": point for point in points})


def load_named(kind: str, folder: Path | None) -> Any:
    """Import and return the object "module:name"; the name may have dots, for example "module:Outer.Inner".

    An object that `KINDS_OF` or an entry point of a group `desim.*` lists is loaded as an entry point. A module
    that lies in `folder` precedes any other of its name, except those of Python and of desim; modules of one name in
    different folders are different modules, and each imports the modules beside it (`desim.config.own_modules`).

    An import runs the code of the module. If the object is not listed (`is_unlisted_import`), the caller must first
    check that the file that names the object is trusted.

    Raises:
        ValueError: if the object cannot be imported.
    """
    module, _, name = kind.partition(":")
    where, package = "", module
    folder = kind.folder if isinstance(kind, CodeName) else folder
    point = _named_by_entry_points().get(kind)
    if point is None and folder is not None:
        where = f"; also searched in the folder of the file, {folder.absolute()}"
        package = module_beside(module, folder)
    place = package.removeprefix(module.partition(".")[0]).partition(".")[0]
    try:
        return reduce(getattr, name.split("."), import_module(package)) if point is None else point.load()
    except AttributeError as error:
        hint = did_you_mean(error.name, dir(error.obj)) if error.name else ""
        raise ValueError(f"{kind!r} cannot be imported: {_without(place, error)}{hint}{where}") from error
    except (ImportError, SyntaxError, ValueError) as error:
        raise ValueError(f"{kind!r} cannot be imported: {_without(place, error)}{where}") from error
    except PydanticUserError as error:  # an invalid definition of a model, such as a field without a type
        raise ValueError(f"{kind!r} cannot be imported: {error.message}") from error
    except SystemExit as error:
        raise ValueError(f"{kind!r} cannot be imported: {module} calls exit({error.code!r})") from error


def named_in_file(kind: str, info: ValidationInfo) -> Any:
    """Import and return the object "module:name" that a file names; see `load_named`.

    Raises:
        ValueError: if the object cannot be imported, or is not listed and the file is not trusted.
    """
    if is_unlisted_import(kind) and not is_trusted(info):
        raise ValueError(refusal(kind))
    return load_named(kind, (info.context or {}).get("folder"))


def _without(place: str, error: Exception) -> str:
    """Return the text of an error with plain names of modules."""
    return str(error).replace(place, "") if "@" in place else str(error)
