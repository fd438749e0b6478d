"""What a function takes from outside of a run: clocks, random numbers without the run's seed, and the process.

The function is not called: its instructions are read, and the names in them are looked up.
"""

import builtins
import os
import platform
import random
import re
import secrets
import socket
import sys
import time
import uuid
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from datetime import date, datetime
from dis import get_instructions
from functools import lru_cache
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple, Self

import numpy as np

CLOCKS = {
    **{getattr(time, name): f"time.{name}" for name in ("sleep", "time", "time_ns", "monotonic", "monotonic_ns")},
    **{getattr(datetime, name): f"datetime.{name}" for name in ("now", "utcnow", "today")},
    date.today: "date.today",
}
"""The names of the functions that wait for the clock of the computer, or read it, in place of simulated time.

`time.perf_counter` is not among them, because a model may measure how long a computation takes.
"""
NOW = {getattr(time, name): f"time.{name}()" for name in ("localtime", "gmtime", "ctime", "asctime")}
"""The names of the functions that read this clock if they are called without a time."""
ENTROPY = {
    **{getattr(secrets, name): f"secrets.{name}" for name in secrets.__all__ if name != "compare_digest"},
    **{uuid.uuid1: "uuid.uuid1", uuid.uuid4: "uuid.uuid4", os.urandom: "os.urandom"},
    random.SystemRandom: "random.SystemRandom",
}
"""The names of the functions that return different random numbers in each run."""
SEEDED = {
    np.random.default_rng: "numpy.random.default_rng()",
    np.random.RandomState: "numpy.random.RandomState()",
    random.Random: "random.Random()",
}
"""The names of the generators of random numbers that differ in each run if they are created without a seed."""
PROCESS = {
    **{getattr(os, name): f"os.{name}" for name in ("getenv", "getlogin")},
    **{socket.gethostname: "socket.gethostname", platform.node: "platform.node"},
    hash: "hash()",
}
"""The names of the functions whose results differ from process to process; the hash of a text does."""
GENERATORS = ((random.random.__self__, "random"), (np.random.random.__self__, "numpy.random"))  # type: ignore[attr-defined]
"""The generators that all code of a process shares, with the names of their modules."""
VARIABLES = ((os.environ, "os.environ"), (sys.argv, "sys.argv"))
"""The variables of a process, with their names."""
BETWEEN = frozenset({"PUSH_NULL", "PRECALL", "RESUME", "NOP", "EXTENDED_ARG"})
"""The instructions that may lie between the one that reads a name and the one that calls it."""


class Use(NamedTuple):
    """A dotted name that a function reads."""

    names: tuple[str, ...]
    module: str
    """The module that the first name denotes, if the function imports it; else ""."""
    is_called_alone: bool
    """Whether the name is called without arguments."""


class Outside(NamedTuple):
    """The names of what a function takes from outside of a run."""

    clocks: set[str]
    """Clocks that it reads or waits for."""
    entropy: set[str]
    """Sources of random numbers."""
    process: set[str]
    """What differs from process to process."""
    generators: set[str]
    """Generators of random numbers that all code shares."""

    @classmethod
    def of_all(cls, parts: Iterable["Outside"]) -> Self:
        """Return the sources of several functions in one."""
        return cls(*(set[str]().union(*names) for names in zip(cls(set(), set(), set(), set()), *parts, strict=True)))


def outside_sources(function: FunctionType) -> Outside:
    """Return the names of what a function takes from outside of a run."""
    clocks, entropy, process, generators = set[str](), set[str](), set[str](), set[str]()
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    enclosing = {name: cell.cell_contents for name, cell in cells if cell != CellType()}  # an empty cell has no value
    namespace = ChainMap(enclosing, function.__globals__)
    for use in _uses(function.__code__):
        source = _denoted(use, namespace)
        prefixes = [_denoted(use._replace(names=use.names[:k]), namespace) for k in range(1, len(use.names) + 1)]
        process |= {name for variable, name in VARIABLES if any(prefix is variable for prefix in prefixes)}
        generators |= {name for generator, name in GENERATORS if getattr(source, "__self__", None) is generator}
        try:
            defines_hash = source is hash and function.__name__ == "__hash__"  # `__hash__` usually calls `hash`
            process |= {PROCESS[source]} if source in PROCESS and not defines_hash else set()
            clocks |= {CLOCKS[source]} if source in CLOCKS else set()
            clocks |= {NOW[source]} if use.is_called_alone and source in NOW else set()
            entropy |= {ENTROPY[source]} if source in ENTROPY else set()
            entropy |= {SEEDED[source]} if use.is_called_alone and source in SEEDED else set()
        except TypeError:  # an object without a hash is in none of the tables
            continue
    return Outside(clocks, entropy, process, generators)


def _denoted(use: Use, namespace: Mapping[str, Any]) -> Any:
    """Return what a dotted name denotes; None if only running code of a user would tell."""
    first, *others = use.names
    denoted = sys.modules.get(use.module) if use.module else namespace.get(first, vars(builtins).get(first))
    for name in others:
        if not isinstance(denoted, ModuleType | type):
            return None
        try:
            denoted = getattr(denoted, name, None)
        except Exception:  # a package that imports others when they are first named may lack one of them
            return None
    return denoted


@lru_cache(maxsize=256)
def _uses(code: CodeType) -> frozenset[Use]:
    """Return the dotted names that a function, and the functions inside it, read."""
    steps = [step for step in _steps(code) if step[0] not in BETWEEN]
    imported = dict(_imports(steps))
    uses = set()
    for k, (operation, name) in enumerate(steps):
        if operation != "LOAD" or (name in {*code.co_varnames, *code.co_cellvars} and name not in imported):
            continue  # a local variable that is no import
        module, *inner = imported.get(name, "").split(":")
        names, end = [name, *inner], k + 1
        while steps[end][0] == "ATTRIBUTE":
            names.append(steps[end][1])
            end += 1
        uses.add(Use(tuple(names), module, steps[end] == ("CALL", 0)))
    return frozenset(uses).union(*map(_uses, inner_code(code)))


def _steps(code: CodeType) -> Iterator[tuple[str, Any]]:
    """Yield the instructions of a function, in a form that all versions of Python have in common.

    Names are loaded ("LOAD") and stored ("STORE"), by some instructions two at once; "ATTRIBUTE" reads an attribute.
    """
    for item in get_instructions(code):
        if item.opname in {"LOAD_ATTR", "LOAD_METHOD"}:
            yield "ATTRIBUTE", item.argval
        elif item.opname.startswith(("LOAD_", "STORE_")) and item.opname != "LOAD_CONST":
            names = item.argval if isinstance(item.argval, tuple) else (item.argval,)
            yield from zip(re.findall("LOAD|STORE", item.opname), names, strict=False)
        else:
            yield item.opname, item.arg if item.opname == "CALL" else item.argval


def _imports(steps: list[tuple[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield the variables of a function that are imported in it, each with "module", or "module:name"."""
    module, inner = "", ""
    for operation, name in steps:
        if operation == "IMPORT_NAME":
            module, inner = name, ""
        elif operation == "IMPORT_FROM":
            inner = f":{name}"
        elif operation == "STORE" and module:
            yield name, module + inner
            module = module if inner else ""  # `from module import a, b` stores several names


def inner_code(code: CodeType) -> list[CodeType]:
    """Return the code of the functions inside a function."""
    return [item for item in code.co_consts if isinstance(item, CodeType)]
