"""Metrics: functions from the result of a run to a number, computed from its trace alone; and their summary.

A metric is a function in one of the modules imported here and an entry in `Summary`: its name, the function, its unit
and its note in the table of a run. Tables, JSON and batches follow from the entry. Only `network_regret` has no entry,
because it executes another run for comparison.
"""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from math import isnan, nan
from types import MappingProxyType
from typing import Any

from desim.analysis.activity import (
    active_time,
    activity,
    changes,
    crowded_time,
    decisions,
    energy,
    excess_time,
    handovers,
    idle_time,
    ping_pongs,
    switches,
)
from desim.analysis.age import age_at_decision, age_mean, age_peak, belief_error, believed_leaders
from desim.analysis.hindsight import misassigned_time, network_regret, potential_gap, regret, time_to_relay
from desim.analysis.trace_index import (
    captures,
    ended,
    messages,
    messages_recorded,
    positions_known,
    started,
    trace_index,
)
from desim.kernel.clock import seconds
from desim.kernel.events import Cause
from desim.simulation.run import Result

__all__ = [
    "COMMON",
    "METRICS",
    "Metric",
    "Summary",
    "active_time",
    "activity",
    "age_at_decision",
    "age_mean",
    "age_peak",
    "belief_error",
    "believed_leaders",
    "capture_time",
    "captured",
    "changes",
    "crowded_time",
    "energy",
    "excess_time",
    "handovers",
    "idle_time",
    "mean_capture_time",
    "messages",
    "misassigned_time",
    "network_regret",
    "ping_pongs",
    "plain",
    "potential_gap",
    "regret",
    "summary",
    "switches",
    "time_to_relay",
]


def captured(result: Result) -> bool:
    """Return whether the evader was captured; with several, whether all or `capture.captures_to_end` of them were."""
    return ended(result).reason == "captured"


def capture_time(result: Result) -> float | None:
    """Return the time at which the evader, or the last of several, was captured, s; None if it was not."""
    return end_time(result) if captured(result) else None


def end_time(result: Result) -> float:
    """Return the time at which the run ended, s: the (last) capture, the horizon, or the request of a watcher."""
    return seconds(ended(result).t)


def mean_capture_time(result: Result) -> float:
    """Return the time of capture averaged over the captured evaders, s; nan if none was captured."""
    times = [seconds(each.t) for each in captures(result)]
    return sum(times) / len(times) if times else nan


def capture_times(result: Result) -> dict[str, float]:
    """Return the time of capture of each captured evader, s, in order of time."""
    return {str(each.evader): seconds(each.t) for each in captures(result)}


def capturers(result: Result) -> dict[str, int]:
    """Return the pursuer that captured each captured evader, in order of time."""
    return {str(each.evader): each.capturer for each in captures(result)}


@dataclass(frozen=True)
class Metric:
    """An entry of a summary: the function that computes it, and its form in tables."""

    of: Callable[[Result], Any]
    unit: str = ""
    note: "str | Callable[[Summary], str] | None" = None
    """The note beside it in the table of one run; None if it has no row there."""
    note_of_several: str | None = None
    """The note for runs with several evaders, if different."""
    given: Callable[[Result], bool] | None = None
    """Returns whether the recordings that the metric needs exist; without them its value is None. None for a
    metric of actions only."""
    label: str | None = None
    """The label of its row in the table of one run, if different from its name."""
    in_tables: bool = True
    """Whether it has a row in the table of several runs."""
    silent_at_0: bool = False
    """Whether tables leave it out if it is 0."""
    of_several: bool = False
    """Whether it exists only for runs with several evaders."""
    is_number: bool = True
    """Whether its mean over several runs is meaningful; the mean of truth values is a share."""

    def __call__(self, result: Result) -> Any:
        """Return the value for a run; None if it was not recorded or is not defined."""
        there = (self.given is None or self.given(result)) and (not self.of_several or len(started(result).evaders) > 1)
        value = self.of(result) if there else None
        return None if isinstance(value, float) and isnan(value) else value


def entry(of: Callable[[Result], Any], unit: str = "", note: Any = None, **shown: Any) -> Any:
    """Return a field of a summary; see `Metric`."""
    metric = Metric(of, unit, note, **shown)
    absent: Any = None if metric.of_several else MISSING
    return field(default=absent, metadata={"metric": metric})


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """The metrics of one run, in the order of tables; None for an event that did not happen or a missing recording.

    `str` returns a line with the unit for each metric that is not None.
    """

    seed: int = entry(lambda result: result.seed, in_tables=False, is_number=False)
    captured: bool = entry(captured, in_tables=False)
    capture_time: float | None = entry(capture_time, "s")
    capturer: int | None = entry(lambda result: ended(result).capturer, in_tables=False, is_number=False)
    """The pursuer that captured the evader, or the last of several."""
    captures: int | None = entry(lambda result: len(captures(result)), of_several=True)
    """Number of captured evaders; None if and only if the run had one evader."""
    mean_capture_time: float | None = entry(mean_capture_time, "s", of_several=True)
    capture_times: Mapping[str, float] | None = entry(capture_times, in_tables=False, is_number=False, of_several=True)
    """By the number of the evader, s."""
    capturers: Mapping[str, int] | None = entry(capturers, in_tables=False, is_number=False, of_several=True)
    """By the number of the evader."""
    end_time: float = entry(end_time, "s")
    active_time: float = entry(active_time, "s", "summed over the pursuers")
    idle_time: float = entry(
        idle_time, "s", "no pursuer active", note_of_several="no pursuer on an evader, summed over those at large"
    )
    crowded_time: float = entry(
        crowded_time, "s", "more than one active", note_of_several="more than one on an evader, summed over evaders"
    )
    excess_time: float = entry(excess_time, "s")
    misassigned_time: float | None = entry(
        misassigned_time,
        "s",
        "active set is not the relay pursuer alone",
        note_of_several="not the optimal pursuer alone on each evader",
        given=positions_known,
    )
    time_to_relay: float | None = entry(
        time_to_relay,
        "s",
        "start of a window with the relay pursuer alone active",
        note_of_several="start of a window with the optimal pursuer alone on each",
        given=positions_known,
    )
    potential_gap: float | None = entry(
        potential_gap, "s^2", "below the largest potential, integrated over time", given=positions_known
    )
    regret: float | None = entry(
        regret,
        "s",
        "against the better fixed action, averaged over pursuers",
        note_of_several="against the best fixed action, averaged over pursuers",
        given=positions_known,
    )
    energy: float = entry(energy, "m^2/s", "v^2 summed over active pursuers, integrated over time")
    decisions: int = entry(
        lambda result: len(decisions(result)), note=lambda run: f"{run.switches:,} of them changed an action"
    )
    switches: int = entry(switches)
    handovers: int = entry(handovers, note=lambda run: f"{run.ping_pongs:,} of them ping-pong", label="hand-overs")
    ping_pongs: int = entry(ping_pongs)
    messages_sent: int = entry(lambda result: messages(result).sent, note="each receiver of a broadcast counts as one")
    messages_delivered: int = entry(lambda result: messages(result).delivered, note="", label="  delivered")
    messages_lost: int = entry(
        lambda result: messages(result).lost,
        note=lambda run: ", ".join(f"{n:,} by {words(cause)}" for cause, n in sorted(run.messages_lost_by.items())),
        label="  lost",
    )
    messages_lost_by: Mapping[Cause, int] = entry(lambda result: messages(result).lost_by, is_number=False)
    messages_in_flight: int = entry(
        lambda result: messages(result).in_flight, note="at the end of the run", label="  in flight"
    )
    transmissions: int = entry(lambda result: messages(result).transmissions)
    """Number of transmissions, whatever the number of receivers."""
    bytes_sent: int = entry(
        lambda result: messages(result).bytes_sent, note=lambda run: f"in {run.transmissions:,} transmissions"
    )
    utilisation: float = entry(
        lambda result: messages(result).utilisation,
        note="share of the time in which the channels were busy",
        silent_at_0=True,
    )
    age_mean: float | None = entry(age_mean, "s", "averaged over time and pairs", given=messages_recorded)
    age_peak: float | None = entry(age_peak, "s", "just before a newer record arrived", given=messages_recorded)
    age_at_decision: float | None = entry(
        age_at_decision, "s", "at the decisions of the reader", given=messages_recorded
    )
    belief_error: float | None = entry(
        belief_error, note="share of pairs with a wrong record of the action", given=messages_recorded
    )
    believed_leaders: float | None = entry(
        believed_leaders,
        note="active pursuers that know of no other active one",
        note_of_several="active pursuers that know of no other on the same evader",
        given=messages_recorded,
    )

    def __str__(self) -> str:
        there = {name: getattr(self, name) for name in METRICS if getattr(self, name) is not None}
        return "\n".join(
            f"{words(name)}: {_formatted(value)} {METRICS[name].unit}".rstrip() for name, value in there.items()
        )


def _formatted(value: Any) -> str:
    """Return a value of a summary as text, fractions with six significant digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


METRICS: Mapping[str, Metric] = MappingProxyType({each.name: each.metadata["metric"] for each in fields(Summary)})
"""The entries of a summary."""
COMMON = tuple(name for name, metric in METRICS.items() if not metric.of_several)
"""The names of the metrics that every run has."""


def summary(result: Result) -> Summary:
    """Return all metrics of one run. Use the single functions of this module if you need only one or two."""
    index = trace_index(result)
    return Summary(**{name: metric(index) for name, metric in METRICS.items()})


def plain(numbers: Summary) -> dict[str, Any]:
    """Return the metrics of a run by name, as JSON values; those of several evaders only if the run had several."""
    names = METRICS if numbers.captures is not None else COMMON
    return {name: each for name, each in asdict(numbers).items() if name in names}


def words(name: str) -> str:
    """Return the name of a metric in words."""
    return name.replace("_", " ")
