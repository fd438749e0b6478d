"""Code that a file names as "module:name": when it may be imported, its import, and the name of a definition."""

from collections.abc import Callable, Mapping
from functools import cache, reduce
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from traceback import walk_tb
from types import FunctionType, MappingProxyType
from typing import Any

from pydantic import PydanticUserError, ValidationInfo

from desim.config.own_modules import NOT_OWN, CodeName, find_own_modules, is_of_user, module_beside, plain_name
from desim.config.packages import KINDS_OF, HiddenPackageError
from desim.config.suggestion import did_you_mean
from desim.config.trust import ALLOW_HINT, is_trusted

find_own_modules()


def definition_of(value: Any) -> Any:
    """Return the function or class that defines a value: a function itself, or the class of an object."""
    return value if isinstance(value, FunctionType) else type(value)


def import_name(definition: Any) -> str:
    """Return the `kind` "module:name" that selects a function or class without an entry point.

    Code that `exec` runs in a dict of its own has no module; its name is that of code in a script, "__main__:name".
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

    No distribution needs to declare the kinds in `KINDS_OF`.
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
    that lies in `folder` precedes any other of its name, except those of Python and of desim. Modules of one name in
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
        if (top := module.partition(".")[0]) in NOT_OWN:
            own = folder.absolute() / f"{top}.py"
            where = f"; Python and desim do not import {own}: a module of theirs has this name" if own.exists() else ""
        package = module_beside(module, folder)
    at_folder = package.removeprefix(module.partition(".")[0]).partition(".")[0]
    look_up = (lambda: reduce(getattr, name.split("."), import_module(package))) if point is None else point.load
    return imported(kind, look_up, at_folder, where)


def imported(kind: str, look_up: Callable[[], Any], at_folder: str = "", where: str = "") -> Any:
    """Return the object "module:name" that a function imports.

    Args:
        kind: "module:name".
        look_up: the function, whose import runs the code of the module.
        at_folder: the part "@FOLDER" of the name under which the module is imported, which errors leave out; "" if the
            name has none.
        where: the end of an error, which says where the module was looked for.

    Raises:
        ValueError: if the object cannot be imported. The message names the line of the user's code that raised an
            exception; the cause of the error is this exception.
        HiddenPackageError: if another package hides one of desim.
    """
    try:
        return look_up()
    except (HiddenPackageError, MemoryError):
        raise
    except AttributeError as error:
        hint = did_you_mean(error.name, dir(error.obj)) if error.name else ""
        raise _import_error(kind, f"{_without(at_folder, error)}{hint}", error, where) from error
    except (ImportError, SyntaxError, ValueError) as error:
        raise _import_error(kind, _without(at_folder, error), error, where) from error
    except PydanticUserError as error:  # an invalid definition of a model, such as a field without a type
        raise _import_error(kind, str(error.message), error) from error
    except SystemExit as error:
        text = f"{kind.partition(':')[0]} calls exit({error.code!r})"
        raise _import_error(kind, text, error) from error
    except Exception as error:
        text = f"{type(error).__name__}: {_without(at_folder, error)}".removesuffix(": ")
        raise _import_error(kind, text, error) from error


def named_in_file(kind: str, info: ValidationInfo) -> Any:
    """Import and return the object "module:name" that a file names; see `load_named`.

    Raises:
        ValueError: if the object cannot be imported, or is not listed and the file is not trusted.
    """
    if is_unlisted_import(kind) and not is_trusted(info):
        raise ValueError(refusal(kind))
    return load_named(kind, (info.context or {}).get("folder"))


def _import_error(kind: str, text: str, error: BaseException, where: str = "") -> ValueError:
    """Return the error about an object that cannot be imported, with the file and the line of a user that raised it.

    A SyntaxError has them in its text already.
    """
    module = kind.partition(":")[0].partition(".")[0]  # the user's, even if it is installed
    calls = [] if isinstance(error, SyntaxError) else walk_tb(error.__traceback__)
    places = [
        f" ({frame.f_code.co_filename}, line {line})"
        for frame, line in calls
        if is_of_user(frame) or plain_name(str(frame.f_globals.get("__name__"))).partition(".")[0] == module
    ]
    return ValueError(f"{kind!r} cannot be imported: {text}{''.join(places[-1:])}{where}")


def _without(at_folder: str, error: Exception) -> str:
    """Return the text of an error with plain names of modules."""
    return str(error).replace(at_folder, "") if "@" in at_folder else str(error)
