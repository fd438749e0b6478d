"""The scenarios and measurements of `python -m scenarios.transport`."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from desim import Bernoulli, Constant, Evader, GilbertElliott, Links, Motion, Recording, Result, Scenario, Team
from desim.analysis.age import age_mean
from desim.analysis.metrics import active_time, captured, end_time, messages, switches
from desim.analysis.statistics import Estimate, estimate
from desim.kernel.core.message_size import HEADER
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.transport.frames import piece_size
from desim.pursuit.team.announcements import Announcements, Start
from protocols.dissemination import CodedOneHop, ReliableOneHop
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson
from scenarios.studies.study import Options

N = 10
SIZE = HEADER + 8
"""Bytes of an announcement of an action."""
COPY = piece_size(SIZE, 1)
"""Bytes of one of the copies of an announcement that is coded by repetition."""
JITTER = 0.5
"""Jitter of the heartbeats."""
PERIOD = 0.5
"""Time between two announcements in a game at rest, s; the time between two heartbeats follows from equal bytes."""
REST, N_REST = 10.0, 5
"""Duration, s, and number of pursuers of a game at rest."""
ONCE, RELIABLE, BACKOFF, HEARTBEATS, CODED = "once", "reliable", "reliable, back-off", "heartbeats", "coded"
WAYS = (ONCE, RELIABLE, BACKOFF, HEARTBEATS, CODED)
"""How a change of action is announced: once; retransmitted every 5/4 of a round trip, or with a back-off of 2; repeated
by heartbeats; or sent as several copies, `SPACING` apart. The last two ways take as many bytes as `RELIABLE`."""
SPACING = 0.05
"""Time between two copies of a change of action, s."""
WITH_EQUAL_BYTES = (HEARTBEATS, CODED)
"""The ways whose parameters follow from the bytes of `RELIABLE`."""
REFERENCE = HEARTBEATS
"""The way with which the others are compared."""


class Setting(NamedTuple):
    """The imperfections of all links, and the length of a pursuit."""

    loss: float = 0.3
    """Share of the messages that are lost."""
    burst: float = 0.0
    """Mean duration of a bad period, s, in which all messages are lost; 0: losses are independent."""
    latency: float = 0.05
    """s"""
    distance: float = 0.0
    """Distance of the evader from the middle of the team at the start, m, so that a pursuit takes longer and actions
    change less often; 0: it starts in the middle, as in the paper."""

    start: Start = "announced"
    """How the initial actions become known; if they are announced, these announcements count as changes of action."""

    @property
    def timeout(self) -> float:
        """5/4 of a round trip, s."""
        return 2.5 * self.latency

    def links(self) -> Links:
        """Return the links of the network."""
        loss: GilbertElliott | Bernoulli = Bernoulli(p=self.loss)
        if self.burst and self.loss:
            loss = GilbertElliott(share=self.loss, burst=self.burst, advance="time")
        return Links(latency=Constant(value=self.latency), loss=loss)


SWEEPS: Mapping[str, Sequence[Any]] = MappingProxyType(
    {
        "loss": (0.0, 0.1, 0.3, 0.5, 0.7),
        "burst": (0.0, 0.1, 0.3, 1.0, 3.0),
        "latency": (0.01, 0.05, 0.2, 0.5),
        "distance": (0.0, 10.0, 20.0, 40.0),
    }
)
"""The values of each property of a setting; the others have their defaults."""
WITH_AGES = ("loss", "burst", "latency")
"""The properties over which the age of information is measured."""


class Budget(NamedTuple):
    """The bytes and announcements of `RELIABLE` in a setting."""

    bytes: float
    """Bytes per second of all pursuers together."""
    announcements: float
    """Announcements of an action per second: those of changes, and of first actions if they are announced."""


class Run(NamedTuple):
    """The measurements of one run."""

    value: float
    """The sum of active times, or the mean age of information, s."""
    duration: float
    """s"""
    captured: bool
    announcements: int
    """Number of announcements of an action: those of changes, and of first actions if they are announced."""
    bytes: int


@dataclass(frozen=True)
class Cell:
    """The results of one way to announce in one setting; times are in s."""

    swept: str
    """The property that varies."""
    value: float
    way: str
    active_time: Estimate
    difference: Estimate
    """Paired difference of the active time from that of `REFERENCE`, s."""
    captured: float
    """Share of the pursuits that end with a capture."""
    rate: float
    """Bytes per second of a pursuit."""
    age: Estimate | None
    """Mean age of information in a game at rest, s; None: not measured."""
    age_rate: float | None
    """Bytes per second of a game at rest."""


def pursuit(setting: Setting, way: str, budget: Budget | None = None) -> Scenario:
    """Return the scenario of Lee & Bakolas in a setting; a way of `WITH_EQUAL_BYTES` needs the budget of `RELIABLE`."""
    if way == HEARTBEATS:
        assert budget is not None
        # The N heartbeats of a period take the bytes of the budget that the announcements of changes do not use.
        period = N * SIZE / (budget.bytes - SIZE * budget.announcements)
        return _scenario(setting, Announcements(start=setting.start, heartbeat=period, jitter=JITTER))
    copies = round(budget.bytes / (budget.announcements * COPY)) if budget is not None else 1
    spreading = dissemination(setting, way, copies, SPACING)
    return _scenario(setting, Announcements(trigger="change", start=setting.start, dissemination=spreading))


def at_rest(setting: Setting, way: str, budget: Budget | None = None) -> Scenario:
    """Return a game at rest, in which each pursuer announces its action periodically; see `pursuit`."""
    period, spreading = PERIOD, "one_hop"
    if way == HEARTBEATS:
        assert budget is not None
        period = N_REST * SIZE / (budget.bytes - SIZE * budget.announcements)
    else:
        copies = round(budget.bytes / ((budget.announcements + N_REST / PERIOD) * COPY)) if budget is not None else 1
        spreading = dissemination(setting, way, copies, PERIOD / max(copies, 1))
    announce = Announcements(
        trigger="heartbeat", start=setting.start, heartbeat=period, jitter=JITTER, dissemination=spreading
    )
    record = Recording(trajectory=0.0, messages=True)
    return _scenario(setting, announce, N_REST, motion=Motion(static=True), horizon=REST, record=record)


def dissemination(setting: Setting, way: str, copies: int, spacing: float) -> Any:
    """Return the dissemination of a way to announce; `CODED` sends `copies`, `spacing` s apart."""
    if way == CODED:
        return CodedOneHop(pieces=min(max(copies, 1), 255), spacing=spacing)
    backoff = 2.0 if way == BACKOFF else 1.0
    return ReliableOneHop(timeout=setting.timeout, backoff=backoff) if way in {RELIABLE, BACKOFF} else "one_hop"


def _scenario(setting: Setting, announce: Announcements, size: int = N, **more: Any) -> Scenario:
    return Scenario(
        name="transport",
        team=Team(count=size),
        protocol=SpatialAdaptivePlay(schedule=Poisson(rate=5.0)),
        announce=announce,
        network=setting.links(),
        evader=Evader(position=(10.0 + setting.distance, 10.0) if setting.distance else None),
        **({"record": Recording(trajectory=0.0), "horizon": 60.0} | more),
    )


def measure(options: Options) -> list[Cell]:
    """Run each way to announce in each setting."""
    settings = {(name, value): Setting(**{name: value}) for name, values in SWEEPS.items() for value in values}
    pursuits = with_equal_bytes(options, settings.values(), WAYS, pursuit, "pursuits", run_of_pursuit)
    with_ages = [setting for (name, _), setting in settings.items() if name in WITH_AGES]
    rests = with_equal_bytes(options, with_ages, WAYS, at_rest, "ages", run_at_rest)
    cells = []
    for (name, value), setting in settings.items():
        for way in WAYS:
            ages = rests[setting, way] if name in WITH_AGES else None
            cells.append(_cell(name, value, way, pursuits[setting, way], pursuits[setting, REFERENCE], ages))
    return cells


def _cell(
    name: str, value: float, way: str, runs: Sequence[Run], reference: Sequence[Run], ages: Sequence[Run] | None
) -> Cell:
    """Return the results of one way in one setting, given its runs, those of `REFERENCE` and those at rest."""
    times, reference_times = (np.array([run.value for run in run_list]) for run_list in (runs, reference))
    caught = portable_sum(run.captured for run in runs) / len(runs)
    age, rate = (estimate([run.value for run in ages]), budget_of(ages).bytes) if ages else (None, None)
    return Cell(
        name, value, way, estimate(times), estimate(times - reference_times), caught, budget_of(runs).bytes, age, rate
    )


def with_equal_bytes(
    options: Options,
    conditions: Iterable[Any],
    ways: Sequence[str],
    make: Callable[..., Scenario],
    label: str,
    metric: Callable[[Result], Run],
) -> dict[tuple[Any, str], list[Run]]:
    """Run each way under each condition, such as a setting; ways of `WITH_EQUAL_BYTES` get the bytes of `RELIABLE`."""
    conditions = dict.fromkeys(conditions)
    own_bytes = [(condition, way) for condition in conditions for way in ways if way not in WITH_EQUAL_BYTES]
    runs = options.measure_each(own_bytes, make, label, metric)
    equal_bytes = [
        (condition, way, budget_of(runs[condition, RELIABLE])) for condition in conditions for way in WITH_EQUAL_BYTES
    ]
    measured = options.measure_each(equal_bytes, make, f"{label}, equal bytes", metric)
    return runs | {(condition, way): runs_of_key for (condition, way, _), runs_of_key in measured.items()}


def budget_of(runs: Sequence[Run]) -> Budget:
    """Return the bytes and announcements per second of some runs."""
    duration = portable_sum(run.duration for run in runs)
    sent = portable_sum(run.bytes for run in runs)
    announcements = portable_sum(run.announcements for run in runs)
    return Budget(sent / duration, announcements / duration)


def run_of_pursuit(result: Result) -> Run:
    """Return the measurements of a pursuit."""
    announcements = first_announcements(result) + switches(result)
    return Run(active_time(result), end_time(result), captured(result), announcements, messages(result).bytes_sent)


def run_at_rest(result: Result) -> Run:
    """Return the measurements of a game at rest."""
    return Run(age_mean(result), end_time(result), False, first_announcements(result), messages(result).bytes_sent)


def first_announcements(result: Result) -> int:
    """Return how many pursuers announce their first action at time 0."""
    return result.scenario.team.count if result.scenario.announce.start == "announced" else 0
