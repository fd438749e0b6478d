"""Metrics: functions that compute a value, usually a number, from the trace of a run.

`Summary` holds the metrics of one run. A built-in metric is an entry in `Summary`: its name, its function, its unit and
its note in the table of a run. Tables, JSON, the stores of sweeps and the option --until use these entries. Only
`network_regret` has no entry, because it executes another run for comparison.

A user's metric is a function of a result that returns a number, True, False or None, or a `Metric` of such a function.
It is given to `summary` or `sweep`, or named by a scenario (`record.metrics`). `desim.analysis.measuring` computes all
metrics of a run.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import isnan
from operator import itemgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

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
from desim.analysis.captures import capture_time, capture_times, captured, capturers, end_time, mean_capture_time
from desim.analysis.deception import checks_announcements, false_accusations, time_to_detect
from desim.analysis.hindsight import misassigned_time, network_regret, potential_gap, regret, time_to_relay
from desim.analysis.trace_index import captures, ended, messages, messages_recorded, positions_known
from desim.analysis.transport_metrics import (
    acknowledgements,
    deadlines_missed,
    delivery_delay,
    given_up,
    has_transport,
    liveliness_lost,
    mean_attempts,
    retransmissions,
    share_delivered,
)
from desim.config.html import html_properties
from desim.config.json_numbers import to_json
from desim.config.suggestion import did_you_mean
from desim.kernel.core.events import Cause
from desim.simulation.run import Result

__all__ = [
    "METRICS",
    "Metric",
    "Summary",
    "acknowledgements",
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
    "deadlines_missed",
    "delivery_delay",
    "end_time",
    "energy",
    "excess_time",
    "false_accusations",
    "given_up",
    "handovers",
    "idle_time",
    "liveliness_lost",
    "mean_attempts",
    "mean_capture_time",
    "messages",
    "misassigned_time",
    "network_regret",
    "ping_pongs",
    "plain",
    "potential_gap",
    "regret",
    "retransmissions",
    "share_delivered",
    "switches",
    "time_to_detect",
    "time_to_relay",
    "title",
]


class Metric(NamedTuple):
    """A metric: the function that computes it, and its form in tables.

    A user's module can define one: `gap = Metric(closest, "m", "closest approach")` for a function `closest`.
    """

    of: Callable[[Result], Any]
    unit: str = ""
    note: str | Callable[[Mapping[str, Any]], str] | None = None
    """The note in its row of the table of one run: a text, or a function of the summary. A built-in metric without a
    note (None) has a row there only if --metric names it."""
    given: Callable[[Result], bool] | None = None
    """A function that returns whether a run has the recordings that the metric needs; without them the value of the
    metric is None. If the metric needs no recordings, `given` is None."""
    label: str | None = None
    """The label of its row in the table of one run; None: its name in words."""
    in_tables: bool = True
    """Whether it has a row in the table of several runs."""
    silent_at_0: bool = False
    """Whether tables leave it out if it is 0."""
    is_number: bool = True
    """Whether its mean over several runs is meaningful; the mean of truth values is a share."""
    more_is: Literal["better", "worse"] | None = None
    """Whether a greater value is better or worse for the pursuers; None: neither, or not known."""

    def __call__(self, result: Result) -> Any:
        """Return the value for a run; None if it is undefined or if a recording that the metric needs is missing."""
        value = self.of(result) if self.given is None or self.given(result) else None
        return None if isinstance(value, float) and isnan(value) else value


def entry(of: Callable[[Result], Any], unit: str = "", note: Any = None, **fields: Any) -> Any:
    """Create a metric as an entry of `Summary`; the arguments are the fields of `Metric`.

    The type of the result is Any, because the annotation of an entry is the type of the value (`summary.seed`).
    """
    return Metric(of, unit, note, **fields)


worse = partial(entry, more_is="worse")
"""Creates a metric of which more is worse; the next four do so, too, for metrics that need recordings (`given`)."""
of_positions = partial(worse, given=positions_known)
of_messages = partial(worse, given=messages_recorded)
of_transport = partial(worse, given=has_transport)
of_trust = partial(worse, given=checks_announcements)
IN_REPR = ("seed", "captured", "capture_time", "active_time", "messages_sent")
"""The metrics in the `repr` of a summary."""


class Summary(Mapping[str, Any]):
    """The metrics of one run by name, in the order of tables; for example, `summary["active_time"]`.

    A metric is None if it is undefined, as a capture time without a capture, or if a recording that it needs is
    missing. The metrics are attributes, too: `summary.active_time`. A run that was stored before a metric existed lacks
    it: `summary.get(name)` is None, and there is no such attribute.

    `str` returns a line for each metric that is not None: its name, value and unit.

    Args:
        values: the value of each metric by name.
        units: the unit of each metric that is not built in, by name.
    """

    __slots__ = ("_values", "units")

    def __init__(self, values: Mapping[str, Any], units: Mapping[str, str] = MappingProxyType({})):
        self._values = dict(values)
        self.units = dict(units)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    if not TYPE_CHECKING:  # a type checker reports missing attributes itself

        def __getattr__(self, name: str) -> Any:
            """Return the value of a user's metric; raise AttributeError with the name that may be meant."""
            if name.startswith("_") or hasattr(type(self), name):  # the attribute itself says why it has no value
                return object.__getattribute__(self, name)
            if name in self._values:
                return self._values[name]
            raise AttributeError(
                f"there is no metric {name!r}{did_you_mean(name, self)}; the others are in print(summary)"
            )

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} = {_formatted(self[name])}" for name in IN_REPR if self.get(name) is not None)
        return f"<{type(self).__name__} of {len(self)} metrics: {shown}>"

    def __str__(self) -> str:
        return "\n".join(f"{name}: {text}" for name, text in self._texts.items())

    def _repr_html_(self) -> str:
        """Return a table for notebooks, with a row for each metric that is not None."""
        return html_properties(self._texts)

    @property
    def _texts(self) -> dict[str, str]:
        """The text of each metric, with its unit, by its name in words; without metrics that are None or empty."""
        values = {name: value for name, value in self.items() if value is not None and value != {}}
        return {
            words(name): f"{_formatted(value)} {unit_of(name, self.units)}".rstrip() for name, value in values.items()
        }

    seed: int = entry(lambda result: result.seed, in_tables=False, is_number=False)
    """Seed of the run."""
    captured: bool = entry(captured, in_tables=False, more_is="better")
    capture_time: float | None = worse(capture_time, "s")
    capturer: int | None = entry(lambda result: ended(result).capturer, in_tables=False, is_number=False)
    """The pursuer that captured the evader, or the last of several."""
    captures: int = entry(lambda result: len(captures(result)), more_is="better")
    """Number of captured evaders."""
    mean_capture_time: float | None = worse(mean_capture_time, "s")
    capture_times: Mapping[str, float] = entry(capture_times, in_tables=False, is_number=False)
    """Time of each capture, s, by the number of the evader."""
    capturers: Mapping[str, int] = entry(capturers, in_tables=False, is_number=False)
    """Pursuer that made each capture, by the number of the evader."""
    end_time: float = worse(end_time, "s")
    active_time: float = worse(active_time, "s", "summed over the pursuers")
    idle_time: float = worse(idle_time, "s", "no pursuer on an evader at large")
    crowded_time: float = worse(crowded_time, "s", "more than one pursuer on an evader")
    excess_time: float = worse(excess_time, "s")
    misassigned_time: float | None = of_positions(misassigned_time, "s", "not the relay pursuer alone on each evader")
    time_to_relay: float | None = of_positions(
        time_to_relay, "s", "start of a window with the relay pursuer alone on each evader"
    )
    potential_gap: float | None = of_positions(
        potential_gap, "s^2", "below the largest potential, integrated over time"
    )
    regret: float | None = of_positions(regret, "s", "against the best fixed action, averaged over pursuers")
    energy: float = worse(energy, "(m/s)^p s", "v^p of active pursuers, p = 2 or `team.power_exponent`")
    decisions: int = entry(
        lambda result: len(decisions(result)), note=lambda run: f"{run['switches']:,} of them changed an action"
    )
    """Number of decisions."""
    switches: int = entry(switches)
    handovers: int = entry(handovers, note=lambda run: f"{run['ping_pongs']:,} of them ping-pong", label="handovers")
    ping_pongs: int = worse(ping_pongs)
    messages_sent: int = worse(lambda result: messages(result).sent, note="each receiver of a broadcast counts as one")
    """Number of messages; each receiver of a broadcast counts as one."""
    messages_delivered: int = entry(lambda result: messages(result).delivered, note="", label="  delivered")
    """Number of messages that arrived."""
    messages_lost: int = worse(
        lambda result: messages(result).lost,
        note=lambda run: ", ".join(f"{n:,} by {words(cause)}" for cause, n in sorted(run["messages_lost_by"].items())),
        label="  lost",
    )
    """Number of messages that were lost."""
    messages_lost_by: Mapping[Cause, int] = entry(lambda result: messages(result).lost_by, is_number=False)
    """Number of lost messages by cause."""
    messages_in_flight: int = entry(
        lambda result: messages(result).in_flight, note="at the end of the run", label="  in flight"
    )
    """Number of messages that were under way at the end of the run."""
    transmissions: int = worse(lambda result: messages(result).transmissions)
    """Number of transmissions, with any number of receivers or none; each attempt on a channel counts."""
    bytes_sent: int = worse(
        lambda result: messages(result).bytes_sent, note=lambda run: f"in {run['transmissions']:,} transmissions"
    )
    """Number of bytes in all transmissions."""
    utilisation: float = entry(
        lambda result: messages(result).utilisation,
        note="share of the time in which the channels were busy",
        silent_at_0=True,
    )
    """Share of the time in which the channels were busy."""
    share_delivered: float | None = of_transport(
        share_delivered, note="of the messages under a transport, by the end of the run", more_is="better"
    )
    mean_attempts: float | None = of_transport(mean_attempts, note="transmissions of a message to each receiver")
    delivery_delay: float | None = of_transport(delivery_delay, "s", "from sending to delivery")
    retransmissions: int | None = of_transport(
        retransmissions, note=lambda run: f"{run['acknowledgements']:,} acknowledgements"
    )
    acknowledgements: int | None = of_transport(acknowledgements)
    given_up: int | None = of_transport(
        given_up, note="messages that some receiver had not acknowledged", silent_at_0=True
    )
    deadlines_missed: int | None = of_transport(deadlines_missed, note="", silent_at_0=True)
    liveliness_lost: int | None = of_transport(liveliness_lost, note="", silent_at_0=True, more_is=None)
    false_accusations: int | None = of_trust(false_accusations, note="of honest pursuers by honest ones")
    time_to_detect: float | None = of_trust(time_to_detect, "s", "from a Byzantine fault to distrust")
    age_mean: float | None = of_messages(age_mean, "s", "averaged over time and pairs")
    age_peak: float | None = of_messages(age_peak, "s", "just before a newer record arrived")
    age_at_decision: float | None = of_messages(age_at_decision, "s", "at the decisions of the reader")
    belief_error: float | None = of_messages(belief_error, note="share of pairs with a wrong record of the action")
    believed_leaders: float | None = of_messages(
        believed_leaders, note="active pursuers that know of no other on the same evader", more_is=None
    )


def columns_of(runs: Sequence[Mapping[str, Any]], missing: object = None) -> dict[str, Sequence[Any]]:
    """Return the values of each metric, one for each run, by name.

    Args:
        runs: the summary of each run, or a dict of its metrics.
        missing: the value for a run that lacks the metric.
    """
    dicts = [run._values if isinstance(run, Summary) else run for run in runs]
    if not dicts:
        return {}
    names = tuple(dicts[0])
    if len(names) > 1 and set(map(len, dicts)) == {len(names)}:
        # Usually all runs have the same metrics. Then this takes a fifth of the time of the general case.
        with suppress(KeyError):
            return dict(zip(names, zip(*map(itemgetter(*names), dicts), strict=True), strict=True))
    names = tuple(dict.fromkeys(name for metrics in dicts for name in metrics))
    return {name: [metrics.get(name, missing) for metrics in dicts] for name in names}


METRICS: Mapping[str, Metric] = MappingProxyType(
    {name: metric for name, metric in vars(Summary).items() if isinstance(metric, Metric)}
)
"""The built-in metrics by name."""


def _attribute(name: str) -> property:
    """Return the attribute of summaries for a built-in metric; the summary of an older run may lack the metric."""

    def value(summary: Summary) -> Any:
        try:
            return summary[name]
        except KeyError:
            raise AttributeError(f"the run has no {name!r}: it was stored before this metric existed") from None

    return property(value)


for _name in METRICS:  # in place of the entry, which `METRICS` keeps
    setattr(Summary, _name, _attribute(_name))


def plain(summary: Summary) -> dict[str, Any]:
    """Return the metrics of a run by name, as JSON values."""
    return {name: to_json(value) for name, value in summary.items()}


def _formatted(value: Any) -> str:
    """Return a value of a summary as text, floats with six significant digits."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_formatted(member)}" for key, member in value.items())
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def more_is(name: str, added: Mapping[str, Metric]) -> Literal["better", "worse"] | None:
    """Return whether a greater value of a metric is better or worse; `added` are the metrics that are not built in."""
    return (METRICS[name] if name in METRICS else added[name]).more_is


def unit_of(name: str, units: Mapping[str, str]) -> str:
    """Return the unit of a metric, "" if it has none; `units` holds the units of the metrics that are not built in."""
    return METRICS[name].unit if name in METRICS else units.get(name, "")


def title(name: str, units: Mapping[str, str]) -> str:
    """Return the name of a metric in words with its unit, as the title of a column; see `unit_of`."""
    return with_unit(words(name), unit_of(name, units))


def with_unit(label: str, unit: str) -> str:
    """Return a label with a unit: "label, unit", or only the label if there is no unit."""
    return f"{label}, {unit}" if unit else label


def words(name: str) -> str:
    """Return the name of a metric in words."""
    return name.replace("_", " ")
