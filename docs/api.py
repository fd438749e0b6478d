"""The pages of the Python interface: what a script imports, in groups, each with a sentence.

A public name belongs to the group of its module. Modules that are not listed here are internal and have no page.
"""

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from inspect import isclass, isfunction
from types import MappingProxyType, ModuleType
from typing import Any

from pydantic import BaseModel

import desim
import protocols


@dataclass(frozen=True)
class Section:
    """A part of a page: its title, a sentence, and the names in it."""

    title: str
    text: str
    homes: tuple[str, ...] = ()
    """The modules, or packages, whose names in the facades `desim` and `protocols` belong here."""
    names: tuple[str, ...] = ()
    """Further names that are imported from their own modules, as "module.name"."""


@dataclass(frozen=True)
class Page:
    """A page: its title, a sentence, and its sections."""

    title: str
    text: str
    sections: tuple[Section, ...] = field(default=())


PAGES: Mapping[str, Page] = MappingProxyType(
    {
        "run": Page(
            "Run, measure, look",
            "The functions of a script, and what they return.",
            (
                Section(
                    "Scenario files",
                    "Read scenario files and their data.",
                    ("desim.scenario.toml", "desim.scenario.examples", "desim.config.data_files"),
                ),
                Section("One run", "Run a scenario once.", ("desim.simulation.run",)),
                Section(
                    "Many runs",
                    "Vary keys over many seeds, and ask which imperfection costs what.",
                    ("desim.study",),
                    ("desim.study.results.result.SweepResult", "desim.study.results.explanation.Explanation"),
                ),
                Section(
                    "Numbers",
                    "Metrics are computed from the trace of a run.",
                    ("desim.analysis", "desim.kernel.core.trace_file"),
                    ("desim.analysis.metrics.Summary", "desim.analysis.metrics.Metric"),
                ),
                Section("Pictures and pages", "Draw a run, replay it, or play with its keys.", ("desim.view",)),
            ),
        ),
        "scenario": Page(
            "A scenario",
            "An experiment is one immutable value; its parts are the tables of a scenario file.",
            (
                Section("Scenario", "The whole, and its small tables.", ("desim.scenario.scenario",)),
                Section("Players", "The team and the evaders.", ("desim.scenario.players",)),
                Section("Announcements", "What is announced, and when.", ("desim.pursuit.team.announcements",)),
            ),
        ),
        "network": Page(
            "The network",
            "Latency, loss, range, graph, channel and transport are independent keys of `Links`.",
            (
                Section("Links", "The table `network`.", ("desim.kernel.models.links",)),
                Section(
                    "Coherence",
                    "How long, and how far, fading and shadows of links last.",
                    ("desim.kernel.models.coherence",),
                ),
                Section(
                    "Latency",
                    "One-way times of messages.",
                    ("desim.kernel.models.latency", "desim.kernel.models.latency_by_link"),
                ),
                Section(
                    "Loss",
                    "Which messages are lost.",
                    ("desim.kernel.models.loss", "desim.kernel.models.common_losses"),
                ),
                Section("Range and reception", "Who hears whom by distance.", ("desim.kernel.models.reception",)),
                Section("Walls", "What blocks radio, sight and motion, and how much.", ("desim.kernel.walls",)),
                Section("Graphs", "Which pairs have a link.", ("desim.kernel.models.graphs",)),
                Section(
                    "Channel",
                    "Bitrate, queues, access to a shared channel, and interference.",
                    ("desim.kernel.models.medium", "desim.kernel.models.access", "desim.kernel.models.interference"),
                ),
                Section("Transport", "Acknowledgement, repetition, coding.", ("desim.kernel.models.transport",)),
                Section(
                    "Measured and emulated links",
                    "Links that follow a table, and those of Linux's netem.",
                    ("desim.kernel.measured", "desim.kernel.models.netem"),
                ),
            ),
        ),
        "faults": Page(
            "Faults, lies and clocks",
            "What breaks down, who lies, whom a pursuer trusts, and whose clock is wrong.",
            (
                Section(
                    "Faults",
                    "The entries of `fault` that break something, and those that draw them.",
                    ("desim.kernel.models.faults", "desim.kernel.models.fault_plans"),
                ),
                Section("Lies", "The entries of `fault` that deceive.", ("desim.pursuit.byzantine",)),
                Section(
                    "Trust",
                    "Which announcements are believed.",
                    ("desim.pursuit.team.trust", "desim.pursuit.team.judges"),
                ),
                Section(
                    "Clocks",
                    "Clocks that are wrong, and how nodes agree on the time.",
                    ("desim.kernel.models.clock_skew", "desim.kernel.clock_sync"),
                ),
            ),
        ),
        "motion": Page(
            "Evaders and motion",
            "How evaders flee, and how bodies move.",
            (
                Section("Evader strategies", "The kinds of `evader.strategy`.", ("desim.pursuit.evaders",)),
                Section(
                    "Bodies",
                    "Limits of acceleration and turning, and how a pursuer steers.",
                    ("desim.pursuit.motion.dynamics", "desim.pursuit.motion.guidance"),
                ),
                Section(
                    "Wind and currents",
                    "The medium in which bodies move.",
                    ("desim.pursuit.motion.environment", "desim.pursuit.motion.flow"),
                ),
            ),
        ),
        "sensing": Page(
            "Sensing",
            "What a pursuer sees of evaders and teammates, with which errors, and how it estimates the rest.",
            (Section("Sensing and tracking", "The table `sensing`.", ("desim.pursuit.sensing",)),),
        ),
        "protocols": Page(
            "Protocols",
            "How pursuers decide; the page [Protocols](../protocols.md) compares papers, assumptions and messages.",
            (
                Section(
                    "Rules",
                    "The kinds of `protocol`.",
                    tuple(
                        f"protocols.{module}"
                        for module in (
                            *("sap", "best_response", "binary_log_linear", "fictitious_play", "regret_matching"),
                            *("local_min", "cbaa", "cbba", "server", "geometric", "centralised", "policy"),
                        )
                    ),
                ),
                Section("Schedules", "When a pursuer decides.", ("protocols.schedules",)),
                Section("Temperatures", "How random the choices are.", ("protocols.temperature",)),
                Section("Disseminations", "How announcements spread.", ("protocols.dissemination",)),
            ),
        ),
        "live": Page(
            "Live",
            "A scenario in real time, between processes; see [Live](../../howto/live.md).",
            (
                Section(
                    "Runs",
                    "One process per pursuer, over UDP.",
                    names=(
                        "desim.live.live_runs.run",
                        "desim.live.live_runs.runs",
                        "desim.live.result.LiveResult",
                        "desim.live.result.Conduct",
                        "desim.live.wall_clock.Lateness",
                    ),
                ),
                Section(
                    "Agreement",
                    "Live and simulated runs of the same seeds.",
                    names=(
                        "desim.live.agreement.compare",
                        "desim.live.agreement.Agreement",
                        "desim.live.agreement.Row",
                    ),
                ),
                Section(
                    "Your own robot",
                    "A pursuer in an asyncio program.",
                    names=("desim.live.node.Node",),
                ),
                Section(
                    "Errors",
                    "Why a run cannot begin.",
                    names=(
                        "desim.live.refusals.NotLiveError",
                        "desim.live.lobby.LiveError",
                        "desim.live.namespaces.NamespaceError",
                    ),
                ),
            ),
        ),
        "learning": Page(
            "Learning",
            "Environments of PettingZoo, and what pursuers observe in them; see [Learning](../../howto/learning.md).",
            (
                Section(
                    "Environments",
                    "A run in which the caller decides for the pursuers.",
                    ("desim.learning",),
                    (
                        "desim.learning.environments.AECPursuit",
                        "desim.learning.environments.ParallelPursuit",
                        "desim.learning.playing.play",
                    ),
                ),
                Section(
                    "Rewards",
                    "Functions of a step.",
                    names=(
                        "desim.learning.rewards.Step",
                        "desim.learning.rewards.wonderful_life",
                        "desim.learning.rewards.team",
                    ),
                ),
                Section(
                    "Observations",
                    "What a pursuer knows, as named numbers.",
                    names=(
                        "desim.pursuit.team.observation.observation",
                        "desim.pursuit.team.observation.observation_names",
                        "desim.pursuit.team.observation.Own",
                        "desim.pursuit.team.observation.OfEvader",
                        "desim.pursuit.team.observation.OfPursuer",
                    ),
                ),
            ),
        ),
        "own": Page(
            "Models of your own",
            "What a protocol sees of its pursuer, and the classes to derive from; see"
            " [Protocols](../../howto/protocols.md).",
            (
                Section("The agent", "What a protocol is called with.", names=("desim.pursuit.team.agent.Agent",)),
                Section(
                    "Rules",
                    "Base classes of protocols with parameters.",
                    names=("protocols.rule.Rule", "protocols.rule.LearningRule", "protocols.rule.argmax"),
                ),
                Section(
                    "Models",
                    "The base class of all parameters: immutable, checked, read from files.",
                    names=("desim.config.model.Value",),
                ),
            ),
        ),
        "kernel": Page(
            "The network without a pursuit",
            "Message passing in simulated time for SimPy processes of your own; see"
            " [The network](../../explanation/network.md#the-kernel-alone).",
            (
                Section(
                    "In a simulator of your own",
                    "A network that your loop steps; see"
                    " [Use the network in your simulator](../../howto/stepped_network.md).",
                    (
                        "desim.kernel.stepped_network",
                        "desim.kernel.stepped_networks",
                        "desim.adapters.wrap",
                        "desim.kernel.fates",
                    ),
                    (
                        "desim.kernel.stepped_network.ReceivedMessage",
                        "desim.kernel.stepped_network.LostMessage",
                        "desim.kernel.core.events.Trace",
                    ),
                ),
                Section(
                    "Network and clock",
                    "A network on a clock; links are those of [the network](network.md).",
                    names=(
                        "desim.kernel.network.Network",
                        "desim.kernel.core.clock.Clock",
                        "desim.kernel.core.clock.NodeClock",
                        "desim.kernel.core.clock.Phase",
                        "desim.kernel.core.records.Record",
                    ),
                ),
            ),
        ),
    }
)
"""The pages by file name, in order."""


def facades() -> dict[str, str]:
    """Return the module of each public name of `desim` and `protocols`, by the name that a script imports."""
    homes = {f"desim.{name}": desim._HOMES[name] for name in (*desim.__all__, "open")}
    return homes | {f"protocols.{name}": getattr(protocols, name).__module__ for name in protocols.__all__}


def names_in(section: Section) -> list[str]:
    """Return the names in a section, first those of the facades, in the order of its modules and then as they stand."""
    public = facades()
    return [
        *(
            name
            for home in section.homes
            for name, module in public.items()
            if module == home or module.startswith(f"{home}.")
        ),
        *section.names,
    ]


def public_names() -> dict[str, str]:
    """Return the name that a script imports, by the name where the object is defined."""
    names = [name for page in PAGES.values() for section in page.sections for name in names_in(section)]
    return {
        f"{thing.__module__}.{thing.__qualname__}": name
        for name in names
        if hasattr(thing := find(name), "__qualname__")
    }


def find(name: str) -> Any:
    """Return the object of a dotted name."""
    module, _, last = name.rpartition(".")
    return getattr(import_module(module), last)


def pages() -> dict[str, str]:
    """Return the text of each page of the Python interface, by file name without suffix."""
    texts = {stem: _page(page) for stem, page in PAGES.items()}
    if find_spec("desim.testing") is not None:
        texts["testing"] = _testing(import_module("desim.testing"))
    rows = [f"| [{_title(text)}]({stem}.md) | {_sentence(text)} |" for stem, text in texts.items()]
    listed = "\n".join(texts)
    texts["index"] = (
        "# Python interface\n\nWhat a script imports. Other modules are internal, and may change without notice.\n\n"
        "| page | what is on it |\n|---|---|\n" + "\n".join(rows) + "\n\n"
        "The [metrics](../metrics.md) and the [events of a trace](../events.md) have pages of their own.\n\n"
        f"```{{toctree}}\n:hidden:\n:maxdepth: 1\n\n{listed}\n```\n"
    )
    return texts


def _title(text: str) -> str:
    return text.partition("\n")[0].removeprefix("# ")


def _sentence(text: str) -> str:
    """Return the sentence under the title of a page, without links."""
    return text.split("\n\n")[1].partition("; ")[0].rstrip(".") + "."


def _page(page: Page) -> str:
    parts = [f"# {page.title}", page.text]
    for section in page.sections:
        parts += [f"## {section.title}", section.text, *(_directive(name) for name in names_in(section))]
    return "\n\n".join(parts) + "\n"


def _testing(package: ModuleType) -> str:
    """Return the page of the invariants and contracts with which users test models of their own."""
    modules = [f"{package.__name__}.{module.name}" for module in pkgutil.iter_modules(package.__path__)]
    sections = [f"## {name}\n\n```{{eval-rst}}\n.. automodule:: {name}\n    :members:\n```" for name in modules]
    return "\n\n".join(["# Tests of your own models", _first_paragraph(package), *sections]) + "\n"


def _first_paragraph(module: ModuleType) -> str:
    return " ".join((module.__doc__ or "").partition("\n\n")[0].split())


def _directive(name: str) -> str:
    """Return the directive that documents an object."""
    thing = find(name)
    kind = "class" if isclass(thing) else "function" if isfunction(thing) else "data"
    options = "\n    :members:" if kind == "class" else ""
    if kind == "class" and len(thing.__mro__) > 2 and all(_is_ours(base) for base in thing.__mro__[:-1]):
        options += "\n    :inherited-members:"
    return f"```{{eval-rst}}\n.. auto{kind}:: {name}{options}\n```"


def _is_ours(base: type) -> bool:
    """Return whether a class is of this project, and no model, whose base has many methods of pydantic."""
    return base.__module__.startswith(("desim.", "protocols.")) and not issubclass(base, BaseModel)
