"""The identity of the runs of a configuration: a hash of its parameters, user code and data files.

User code is any function or class from outside of the packages `desim` and `protocols`. The hash of a user object (such
a function, or an instance of such a class) covers

- the values that it holds;
- the source of its module and of the user modules that this module imports, directly or indirectly;
- the versions of the installed packages that these modules import, except those in `HASHED_BY_NAME`;
- the content of the data files that it declares or that these modules have opened (`desim.config.data_files`).

If its module belongs to an installed package, all modules of the package are hashed. If the object is defined in a
script or a notebook, its compiled code, the globals that this code reads and the modules that it imports are hashed
instead of the source, because the rest of the script may change.

The globals of a module and the attributes of its functions and classes count through its source
(`desim.study.plan.user_code`). Of the values that a program assigns to them later, those of constants distinguish runs
(`desim.study.plan.assigned_values`).
"""

import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from dis import get_instructions
from functools import cache, cached_property
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from struct import Struct
from types import CodeType, FunctionType, MappingProxyType, ModuleType, NoneType
from typing import Any, NamedTuple
from weakref import WeakSet

import cloudpickle
import numpy as np
from pydantic import BaseModel

from desim.config.caller_warnings import warn_caller
from desim.config.code_variables import DISPATCHING
from desim.config.data_files import DataFileError, content_hash, declared, opened_by
from desim.config.errors import Problem
from desim.config.named_code import definition_of
from desim.config.own_modules import IMPORTING, plain_name
from desim.config.shared_state import StateWarning
from desim.config.traits import OURS
from desim.scenario.overrides import ScenarioError
from desim.scenario.scenario import Scenario
from desim.study.plan.assigned_values import PLAIN
from desim.study.plan.user_code import HASHED_BY_NAME, UserCode, names_in_texts, package_of

UNSWEPT = MappingProxyType(
    {
        "seed": "the number of seeds is sweep.reps",
        "name": "a name changes nothing in a run",
        "sweep": "it is the same for all configurations",
    }
)
"""The keys that are no part of a configuration, and why they cannot be swept."""
CODE = ("code", "names", "varnames", "freevars", "consts", "exceptiontable", "flags")
COUNTS = ("argcount", "posonlyargcount", "kwonlyargcount")
"""The attributes of compiled code that do not depend on where its source lies, without their prefix `co_`; `COUNTS`
are numbers of arguments."""
PICKLED = {NoneType, bool, int, float, list, dict}
"""The types whose pickle is the same in every process."""
WRAPPED = {cached_property: "func", type(cache(len)): "__wrapped__", Struct: "format"}
"""The types that cannot be pickled, each with the attribute from which its objects are made."""
GENERATED = {
    *("__module__", "__dict__", "__weakref__", "__doc__", "__annotations__", "__orig_bases__"),
    *("__annotations_cache__", "__conditional_annotations__"),
    *("__firstlineno__", "__static_attributes__", "__parameters__", "__type_params__", "__abstractmethods__"),
    *("_abc_impl", "__protocol_attrs__", "__dataclass_fields__", "__dataclass_params__"),
    *("__class_vars__", "__private_attributes__", "__signature__"),
}
"""The attributes that Python, dataclasses and pydantic add to a class, without methods and `__pydantic_*`."""
ANNOTATORS = {"__annotate__", "__annotate_func__"}
"""The methods with which Python 3.14 evaluates the annotations of a class."""
MAX_TEXT = 40
"""The length up to which the text of a value is not hashed."""
ADVICE = "store plain values instead, or leave it out in the __getstate__ of the class that holds it"


class Identity(NamedTuple):
    """The identity of the runs of a configuration, apart from their seeds."""

    key: str
    """A hash of the parameters, the user code and the data files, 16 hexadecimal digits."""
    sources: Mapping[str, str]
    """The hashes of user modules, of functions and classes of scripts, and of data files, and the versions of installed
    packages that user code imports. A key is a description, for example "the code of my_rules"."""


def identify(scenario: Scenario) -> Identity:
    """Return the identity of the runs of a scenario; the same in every process with the same version of Python.

    The hashes of data files are sorted by the names of the files without their folders, which may differ between
    machines. If two files swap their contents, the key changes only if their names differ.

    Raises:
        ScenarioError: if an object has no stable hash, or a data file cannot be read; the message names the key of the
            object.
    """
    pickler = StablePickler(UserCode())
    for key, value in _user_objects(scenario):
        try:
            pickler.dump((key, value))
        except DataFileError as error:
            raise ScenarioError(Problem(str(error), key)) from error
        except Exception as error:  # code of the object may raise anything
            raise ScenarioError(Problem(f"has no stable hash: {error}; {ADVICE}", key)) from error
    _warn_of_edited(pickler.user)
    code = code_with_values(pickler.user)
    files = [file for _, file in sorted((Path(path).name, content) for path, content in pickler.user.files.items())]
    content = [tables(scenario), pickler.digest(), code, files]
    sources = {f"the code of {name}": text for name, text in code.items()}
    sources |= {f"the content of {path}": content for path, content in pickler.user.files.items()}
    return Identity(content_hash(json.dumps(content, sort_keys=True).encode()), sources)


def code_with_values(user: UserCode) -> dict[str, str]:
    """Return the hash of the code of each module, and the values of its variables that do not follow from the code.

    An example is "985ccc9e980c32ba, GAIN = 2.0". Values that are no short plain data are hashed, too, and functions
    among them may add modules.
    """
    texts: dict[tuple[str, str], str] = {}
    looked_up = 0
    while looked_up < len(user.code):
        looked_up = len(user.code)
        for key, values in user.values().items():
            for name, value in values.items():
                if (key, name) not in texts:
                    texts[key, name] = _text_of_value(value, user)
    code = dict(user.code)
    for (key, name), text in sorted(texts.items()):
        code[key] += f", {name} = {text}"
    return code


def _text_of_value(value: Any, user: UserCode) -> str:
    """Return the value itself if it is short, a hash of it, or its type if it has no stable hash, as an open file."""
    value = value.item() if isinstance(value, np.generic) else value
    if type(value) in PLAIN and len(repr(value)) <= MAX_TEXT:
        return repr(value)
    try:
        return StablePickler(user).digest(value)
    except Exception:  # code of the object may raise anything
        return f"{type(value).__module__}.{type(value).__qualname__}"


def _warn_of_edited(user: UserCode) -> None:
    """Warn of modules that were edited after their import, and whose hash is that of the older code, which runs."""
    for name, file in user.edited.items():
        text = (
            f"{name}: {file.name} was edited after it was imported, and the code from before the edit runs: reload the"
            " module (importlib.reload) or start Python again"
        )
        warn_caller(text, StateWarning)


def object_hash(value: Any) -> str:
    """Return a hash of an object, its user code and its data files; the same in every process, as in `identify`.

    Raises:
        Exception: if the object has no stable hash.
    """
    pickler = StablePickler(UserCode())
    digest = pickler.digest(value)
    _warn_of_edited(pickler.user)
    content = [digest, code_with_values(pickler.user), sorted(pickler.user.files.values())]
    return content_hash(json.dumps(content, sort_keys=True).encode())


def tables(scenario: Scenario) -> dict[str, Any]:
    """Return the part of a configuration that a scenario file can express, as JSON-compatible tables."""
    values: dict[str, Any] = json.loads(scenario.model_dump_json(exclude=set(UNSWEPT)))
    return values


def _user_objects(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each callable or model of the user in a scenario, or in a part of it, with its dotted key."""
    members: Any = ()
    if (callable(value) or isinstance(value, BaseModel)) and package_of(definition_of(value).__module__) not in OURS:
        yield key, value
    elif isinstance(value, BaseModel):
        members = [(name, vars(value)[name]) for name in type(value).model_fields if key or name not in UNSWEPT]
    elif isinstance(value, tuple | list):
        members = enumerate(value)
    for name, member in members:
        yield from _user_objects(member, f"{key}.{name}" if key else str(name))


class StablePickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickles objects and code of equal content to equal bytes in every process; the bytes are only hashed.

    The bytes depend on aliases: two references to one list, dict or object give other bytes than references to two
    equal ones.

    The bytes of cloudpickle itself differ between processes. They depend on the order of sets and on the identity of
    equal strings, and contain the folder of a script and a random number for each class.

    Args:
        user: receives the modules and the data files of the objects, and the code of functions and classes of scripts.
    """

    def __init__(self, user: UserCode):
        self._content = BytesIO()
        super().__init__(self._content)
        self.user = user

    def digest(self, *values: Any) -> str:
        """Pickle more objects, and return the hash of all objects pickled so far."""
        for value in values:
            self.dump(value)
        return content_hash(self._content.getvalue())

    def persistent_id(self, value: Any) -> Any:
        """Return a substitute for an object whose pickle depends on the process; None for any other object.

        The data files that the object declares are added to `user`. A module is added, too, and so is the module of a
        function or class that can be imported.

        Raises:
            TypeError: if the object is a set, but no plain `set` or `frozenset`, because its order is not stable.
            DataFileError: if a declared data file cannot be hashed.
        """
        kind = type(value)
        if kind in PICKLED:
            return None
        # New texts and lists, so that it does not matter whether equal texts or tuples are one object.
        if kind in {str, bytes}:
            return repr(value)
        if kind is tuple:
            return list(value)
        if kind in {set, frozenset}:
            return kind.__name__, sorted(StablePickler(self.user).digest(member) for member in value)
        if isinstance(value, set | frozenset | WeakSet):
            raise TypeError(f"{kind.__qualname__!r} objects have no stable order")
        if kind is np.ndarray and not value.dtype.hasobject:
            return "array", str(value.dtype), value.shape, content_hash(value.tobytes())
        if kind is FunctionType or (package_of(kind.__module__) not in HASHED_BY_NAME and not isinstance(value, type)):
            self.user.files |= declared(value)
        if isinstance(value, ModuleType | FunctionType | type) and (name := self._import_name(value)):
            return name
        return None

    def reducer_override(self, value: Any) -> Any:
        """Return the reduced value of an object, as its `__reduce__` would; NotImplemented for the default."""
        kind = type(value)
        if kind is CodeType:
            parts = [getattr(value, f"co_{name}") for name in CODE + COUNTS]
            parts[CODE.index("names")] = tuple(map(plain_name, value.co_names))
        elif kind is FunctionType and value.__code__ is DISPATCHING:
            parts = [value.__qualname__, value.__wrapped__, dict(value.registry)]
        elif kind is FunctionType:
            has_source = self._add_code(value, value.__code__)
            names = () if has_source else sorted(globals_read(value.__code__) & value.__globals__.keys())
            if not has_source:
                self.user.add_imported(sorted(_imported(value.__code__)))
            reads = {name: value.__globals__[name] for name in names}
            captured = value.__closure__, value.__defaults__, value.__kwdefaults__, vars(value)
            parts = [value.__qualname__, value.__code__, reads, *captured]
        elif isinstance(value, type):
            members = {name: member for name, member in vars(value).items() if not _is_generated(name, member)}
            self._add_code(value, [member.__code__ for member in members.values() if isinstance(member, FunctionType)])
            parts = [value.__qualname__, value.__bases__, members]
        elif kind in WRAPPED:
            parts = [getattr(value, WRAPPED[kind])]
        elif isinstance(value, BaseModel):
            fields = [vars(value)[name] for name in kind.model_fields]
            parts = [fields, value.__pydantic_extra__, value.__pydantic_private__]
        elif cached := [name for name in getattr(value, "__dict__", ()) if _is_cached(kind, name)]:
            make, args, state, *iterators = value.__reduce_ex__(4)  # cached values follow from the others
            return make, args, {name: member for name, member in state.items() if name not in cached}, *iterators
        else:
            return super().reducer_override(value)
        return object, (), [kind, *parts]  # the state, unlike the arguments, may contain the object itself

    def _import_name(self, value: Any) -> str:
        """Return the name "module:name" by which a module, function or class can be imported, and add its module.

        Return "" if it cannot be imported, or if its module has no source and does not belong to a package in
        `HASHED_BY_NAME`.
        """
        module, name = (value.__name__, "") if isinstance(value, ModuleType) else (value.__module__, value.__qualname__)
        if module == "builtins":  # some of its types, such as NoneType, cannot be looked up
            return f"{module}:{name}"
        try:
            imported = attrgetter(name)(sys.modules[module]) if name else sys.modules[module]
        except (AttributeError, KeyError):  # a class or function that a function made
            return ""
        return f"{plain_name(module)}:{name}" if imported is value and self.user.add(module) else ""

    def _add_code(self, definition: Any, code: Any) -> bool:
        """Add the source of the module of a function or class, and return True.

        If the module has no source, add the code of the function or class instead, and return False.
        """
        module = str(definition.__module__)
        if self.user.add(module):
            return True
        self.user.files |= opened_by(module)
        if "<" not in definition.__qualname__:  # the names of lambdas and of local functions are not unique
            self.user.code[f"{plain_name(module)}:{definition.__qualname__}"] = StablePickler(UserCode()).digest(code)
        return False


def globals_read(code: CodeType) -> set[str]:
    """Return the names of the globals that a function and the functions inside it read.

    If it calls `globals`, each of its texts may be one of these names, as in `globals()["GAIN"]`.
    """
    operations = list(_operations(code))
    names = {name for operation, name in operations if operation in {"LOAD_GLOBAL", "LOAD_NAME"}}
    return names.union(_texts(operations)) if "globals" in names else names


def _imported(code: CodeType) -> set[str]:
    """Return the names of the modules that a function and the functions inside it may import, also by a text."""
    names, module = set[str](), ""
    operations = list(_operations(code))
    if IMPORTING & {name for operation, name in operations if operation.startswith("LOAD_")}:
        names.update(names_in_texts(_texts(operations)))
    for operation, name in operations:
        if operation == "IMPORT_NAME":
            module = name
            names.add(module)
        elif operation == "IMPORT_FROM":  # of a function, or of a module in a package
            names.add(f"{module}.{name}")
    return names


def _texts(operations: Iterable[tuple[str, Any]]) -> list[str]:
    """Return the constants among the arguments of operations that are texts."""
    return [constant for operation, constant in operations if operation == "LOAD_CONST" and isinstance(constant, str)]


def _operations(code: CodeType) -> Iterator[tuple[str, Any]]:
    """Yield the operations of a function, and then of the functions inside it, each with its argument."""
    yield from ((instruction.opname, instruction.argval) for instruction in get_instructions(code))
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _operations(constant)


def _is_generated(name: str, attribute: Any) -> bool:
    """Return whether Python, dataclasses or pydantic added an attribute to a class.

    A method counts as added only if its name is in `ANNOTATORS`.
    """
    is_method = isinstance(attribute, FunctionType | staticmethod | classmethod | property)
    is_generated = name in GENERATED or name.startswith("__pydantic_")
    return name in ANNOTATORS or (is_generated and not is_method)


def _is_cached(kind: type, name: str) -> bool:
    return isinstance(getattr(kind, name, None), cached_property)
