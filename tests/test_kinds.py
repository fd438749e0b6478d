"""A kind brings its own verbs: no module asks whether a model is of a kind of another module's family."""

import ast
from collections import defaultdict
from functools import cache
from importlib import import_module
from inspect import unwrap
from pathlib import Path
from types import FunctionType

import pytest
from pydantic import BaseModel

from desim.config.choice import OneOf
from desim.config.model_parts import markers_of
from desim.config.traits import is_ours
from tests.test_architecture import nodes_of

ROOT = Path(__file__).parent.parent
RECORDED = "a trace records a crash or a partition as such, also one that is a part of a user's fault"
ALLOWED = {
    RECORDED: {
        "desim.analysis.knowledge": "Crash",
        "desim.analysis.quantities": "Crash",
        "desim.analysis.timeline": "Crash",
        "desim.testing.messages": "Crash Partition",
    },
    "a plan of faults draws them, and of the entries of a scenario it takes those that are faults": {
        "desim.kernel.models.fault_plans": "ClockSkew Crash Fault",
    },
    "a check of a family has parts for the bases that users derive from": {
        "desim.testing.faults": "ByzantineFault ClockSkew Fault Window",
        "desim.testing.flows": "UniformFlow",
    },
    "what is no fault is refused, by the bases that users derive from": {
        "desim.kernel.fault_injection": "Crash Fault",
    },
    "a contention, an airtime by node, or a tuned radio needs the fields of the base of the built-in media": {
        "desim.kernel.channel.air": "LoRa",
        "desim.kernel.stepped_arguments": "ClockSkew Complete Fault",
        "desim.kernel.link_layer.estimates": "Radio",
        "desim.kernel.models.medium": "LoRaInterference",
        "desim.scenario.misfits": "Radio",
        "desim.scenario.simultaneous": "Reliable Crash",
        "desim.study.ablation.imperfections": "LoRa",
    },
    "a transport is of a closed family; a dissemination derives from two of its kinds": {
        "desim.kernel.transport.layer": "Reliable",
        "desim.kernel.transport.sender": "Coded",
    },
    "parameters of one built-in kind, which other tables name": {
        "desim.kernel.models.links": "Edges NamedTable",
        "desim.pursuit.sensing.noisy_sensing": "Noiseless",
        "desim.pursuit.sensing.sensing": "Noiseless",
        "desim.scenario.players": "RecordedMotion",
    },
    "warnings about the parameters of one built-in kind; a kind of a user has none": {
        "desim.kernel.stepped_arguments": "Edges",
        "desim.scenario.liar_warnings": "ByzantineFault FalseAnnouncements Liar RandomLies Reputation Selective Silent"
        " Slander Trimmed",
        "desim.scenario.motion_warnings": "ClockSkew",
        "desim.scenario.link_warnings": "Disk Edges LinkTrace LoRa QuasiUnitDisk Radio Reliable Window",
    },
    "a figure of link traces, one for each unit": {
        "desim.view.pictures.link_traces": "LatencyTrace LinkTrace SignalTrace"
    },
}
"""The modules that ask for kinds of other modules, by the reason."""


def modules():
    """Return the modules of the product, by path."""
    found = {}
    for path in sorted([*ROOT.glob("desim/**/*.py"), *ROOT.glob("protocols/**/*.py")]):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] != "__main__":
            found[path] = import_module(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return found


def families():
    """Return all families: the `OneOf` of a module, and those of fields."""
    found = []
    for module in modules().values():
        for value in vars(module).values():
            if isinstance(value, OneOf):
                found.append(value)
            if isinstance(value, type) and issubclass(value, BaseModel):
                found += [each for info in value.model_fields.values() for each in markers_of(info)]
    return [each for each in found if isinstance(each, OneOf)]


def kinds():
    """Return the kinds of the open families, with their bases; a user cannot add to a closed one."""
    found = {kind for family in families() if not family.is_closed for kind in family.choices().values()}
    bases = {base for kind in found for base in kind.__mro__ if is_ours(base)}
    return {base for base in bases if not base.__module__.startswith("desim.config")}


def asked(nodes, module):
    """Yield the classes of which code asks whether a value is an instance: isinstance, issubclass, and match."""
    names = dict(vars(module))
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module and is_ours(type("", (), {"__module__": node.module})):
            names |= {
                alias.asname or alias.name: getattr(import_module(node.module), alias.name, None)
                for alias in node.names
            }
    for node in nodes:
        if isinstance(node, ast.MatchClass):
            parts = [node.cls]
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in {"isinstance", "issubclass"}:
            parts = [node.args[1]]
        else:
            continue
        for part in (inner for each in parts for inner in ast.walk(each)):
            if isinstance(part, ast.Name):
                value = names.get(part.id)
                for kind in value if isinstance(value, tuple) else getattr(value, "__args__", (value,)):
                    if isinstance(kind, type):
                        yield kind


@pytest.mark.slow
def test_no_module_asks_for_a_kind_of_another_family():
    """A kind that a user adds is then not forgotten. Give it an attribute or a method with a default instead.

    `type(model) is Kind`, of a fast path, is never true of a kind of a user, which then takes the plain way.
    """
    every, found = kinds(), set()
    for path, module in modules().items():
        for kind in asked(nodes_of(path), module):
            if kind in every and kind.__module__ != module.__name__:
                found.add((module.__name__, kind.__name__))
    allowed = {(module, kind) for each in ALLOWED.values() for module, names in each.items() for kind in names.split()}
    assert found - allowed == set()
    assert allowed - found == set(), "no longer needed"


# Parameters of one name.

SEVERAL_DEFAULTS = {
    *("at_once", "budget", "cause", "confidence", "count", "draws", "end", "example", "first", "limit", "memory"),
    *("message", "most", "name", "now", "phase", "runs", "speed", "symmetric", "unit"),
}
"""The names of parameters that have another meaning, or another usual value, from function to function."""


@cache
def defaults():
    """Return the functions of the product by the name of a parameter and its default, a number, a text or a flag."""
    found = defaultdict(lambda: defaultdict(list))
    for module in modules().values():
        owners = [
            kind for kind in vars(module).values() if isinstance(kind, type) and kind.__module__ == module.__name__
        ]
        for value in [value for owner in (module, *owners) for value in vars(owner).values()]:
            function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
            if isinstance(function, FunctionType) and function.__module__ == module.__name__:
                plain = unwrap(function)
                names, code = plain.__defaults__ or (), plain.__code__
                last = code.co_varnames[code.co_argcount - len(names) : code.co_argcount]
                for name, default in {**dict(zip(last, names, strict=True)), **(plain.__kwdefaults__ or {})}.items():
                    if isinstance(default, bool | int | float | str):
                        found[name][repr(default)].append(plain.__qualname__)
    return found


def test_parameters_of_one_name_have_one_default():
    several = {name for name, by_default in defaults().items() if len(by_default) > 1}
    assert several == SEVERAL_DEFAULTS, {name: dict(defaults()[name]) for name in several ^ SEVERAL_DEFAULTS}
    assert sum(len(functions) for by_default in defaults().values() for functions in by_default.values()) > 200
