"""The header of a replay as text: players, protocol and outcome of a run, and the conditions of its communication."""

from math import isfinite
from typing import Any

from desim.analysis.trace_index import captures, ended, started
from desim.config.model import Value
from desim.config.number_texts import counted
from desim.config.traits import kind_of, name_of
from desim.kernel.models.graphs import Complete
from desim.kernel.models.latency import Constant
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.medium import Unlimited, contends
from desim.kernel.models.reception import Disk
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, outcome_of

TRIGGERS = {"change": "announced on change", "revision": "announced at every revision", "never": "nothing announced"}
"""By trigger, the description of the announcements of a run without heartbeats."""


def run_name(result: Result) -> str:
    """Return the name of a run: the name of its scenario, and its seed."""
    return f"{result.scenario.name}, seed {result.seed}"


def about(result: Result) -> str:
    """Return a one-line description of a run: players, protocol, seed and outcome."""
    players = counted(len(started(result).active), "pursuer")
    if (count := len(started(result).evaders)) > 1:
        players = f"{players}, {count} evaders"
    return f"{players}, {result.scenario.protocol_name}, seed {result.seed}: {outcome(result)}"


def outcome(result: Result) -> str:
    """Return the outcome of a run as text: the captures and the time of its end."""
    return outcome_of(ended(result), len(captures(result)), len(started(result).evaders))


def conditions(scenario: Scenario) -> str:
    """Return a one-line description of the communication: latency, loss, range, announcements, other models."""
    links, announce = scenario.network, scenario.announce
    latency, loss = links.latency, links.loss
    parts = [
        f"latency {_number(latency.value)} s" if type(latency) is Constant else f"latency {_model(latency)}",
        f"loss {_number(100.0 * loss.p)} %" if type(loss) is Bernoulli else f"loss {_model(loss)}",
        f"range {_number(links.range)} m" if isfinite(links.range) else "unlimited range",
        f"heartbeat {_number(announce.heartbeat)} s" if announce.has_heartbeats else TRIGGERS[announce.trigger],
    ]
    if isfinite(links.range) and type(links.reception) is not Disk:
        parts.append(f"reception {_model(links.reception)}")
    if type(links.graph) is not Complete:
        parts.append(f"graph {_model(links.graph)}")
    if type(links.medium) is not Unlimited:
        parts.append(f"medium {_model(links.medium)}")
    if contends(links.medium):
        parts.append(f"access {_model(links.medium.access)}, interference {_model(links.medium.reception)}")
    if links.link:
        parts.append(f"{len(links.link)} link{'s' if len(links.link) > 1 else ''} with other models")
    return ", ".join(parts)


def _model(model: Any) -> str:
    """Return a model as text: its kind and its numbers except 0 and inf, or the name of a model that is no `Value`."""
    if not isinstance(model, Value):
        return name_of(model)
    parameters = {name: value for name, value in model if name not in model.unused_fields}
    shown = [
        f"{name.replace('_', ' ')} {_number(number)}"
        for name, number in parameters.items()
        if type(number) in {int, float} and isfinite(number) and number
    ]
    name = kind_of(model).replace("_", " ")
    return f"{name} ({', '.join(shown)})" if shown else name


def _number(number: float) -> str:
    return f"{number:,.0f}" if number == round(number) else f"{number:.4g}"
