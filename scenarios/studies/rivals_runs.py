"""The scenarios and measurements of `python -m scenarios.rivals`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from desim import Announcements, Constant, Links, Result, Scenario, Team, summary
from desim.analysis.metrics import Summary, time_to_relay
from desim.analysis.statistics import Estimate, estimate, paired
from desim.kernel.core.portable_math import portable_sum
from desim.scenario.scenario import PROTOCOLS, Motion, Recording
from protocols.schedules.periodic import Poisson
from scenarios.studies.study import Options

LATENCIES = (0.0, 0.05, 0.2, 0.5, 1.0)
"""One-way latencies L, s."""
SHOWN = 0.2
"""Latency, s, for which a table shows all metrics."""
PERIOD = 0.1
"""Time between two announcements of a pursuer, and mean time between two of its decisions, s."""
STEP = 0.01
"""Motion step, and time between two samples of positions, s."""
N = 20
WORLDS: Mapping[str, Scenario] = MappingProxyType(
    {
        "paper": Scenario(name="paper", team=Team(count=N)),
        "relay stress": Scenario(name="relay stress", horizon=60.0, team=Team(count=N, speeds=1.0)),
        "paper, unseen": Scenario(name="paper, unseen", team=Team(count=N), announce=Announcements(payload="state")),
    }
)
"""The scenarios of the study (worlds) by name, before `scenario` sets the protocol, the latency and the times.

In "relay stress" all pursuers are equally fast, so the relay pursuer, which has the least capture time, may change
often. In "paper, unseen" the positions of teammates are not sensed but announced.
"""
SILENT = "nobody talks"
"""Name of the team without announcements, in tables and figures."""
REFERENCE = "sap"
LEARNED = "policy"
"""The protocol that is left out: its actions depend on its weights, and the default weights make it `local_min`."""


@dataclass(frozen=True)
class Cell:
    """The results of one protocol in one scenario at one latency.

    They are means over the runs, except rates, which are quotients of totals over the runs. Times are in s.
    """

    world: str
    protocol: str
    latency: float
    active_time: Estimate
    difference: Estimate
    """Paired difference of the active time from that of Spatial Adaptive Play, s."""
    captured: float
    """Share of the runs with capture."""
    relayed: float
    """Share of the runs in which the relay pursuer chased alone for at least 2 (L + `PERIOD`) or until the end."""
    time_to_relay: float | None
    """Mean time, s, at which the relay pursuer began this chase, over the runs that `relayed` counts; None if none."""
    misassigned_time: float
    network_regret: float
    """Mean increase of the potential gap compared with the same protocol at zero latency, s^2."""
    handovers: float
    transmissions: float
    """Transmissions per second."""
    kilobytes: float
    """Kilobytes sent per second."""


def contender(kind: str) -> object:
    """Return a protocol of a kind with `PERIOD` as its slot or period, or as the mean wait of its Poisson schedule."""
    fields = PROTOCOLS.choices()[kind].model_fields
    settings = {key: PERIOD for key in ("slot", "period") if key in fields}
    schedule = {"schedule": Poisson(rate=1.0 / PERIOD)} if "schedule" in fields else {}
    return PROTOCOLS.choices()[kind](**settings, **schedule)


def scenario(world: str, protocol: str, latency: float) -> Scenario:
    """Return a scenario of `WORLDS` with a protocol and a latency, s.

    `SILENT` stands for Spatial Adaptive Play without announcements, in which the initial actions are unknown, too.
    """
    sending = {"trigger": "never", "start": "silent"} if protocol == SILENT else {"trigger": "heartbeat"}
    announce = WORLDS[world].announce.model_copy(update={"heartbeat": PERIOD} | sending)
    return WORLDS[world].model_copy(
        update={
            "protocol": contender(REFERENCE if protocol == SILENT else protocol),
            "announce": announce,
            "network": Links(latency=Constant(value=latency)),
            "motion": Motion(step=STEP),
            "record": Recording(trajectory=STEP),
        }
    )


def measure(options: Options) -> list[Cell]:
    """Run each protocol in each scenario of `WORLDS` at each latency, and return the results."""
    protocols = [kind for kind in PROTOCOLS.choices() if kind != LEARNED] + [SILENT]
    keys = [(world, protocol, latency) for world in WORLDS for latency in LATENCIES for protocol in protocols]
    runs = options.measure_each(keys, scenario, "rivals", measured)
    return [
        cell(
            (world, protocol, latency),
            runs[world, protocol, latency],
            reference=runs[world, REFERENCE, latency],
            prompt=runs[world, protocol, 0.0],
        )
        for world, protocol, latency in keys
    ]


def measured(result: Result) -> tuple[Summary, float | None]:
    """Return the summary of a run and its time to relay, s.

    The time to relay is the first time from which the relay pursuer chases alone for a window of 2 (L + `PERIOD`), or
    until the end of the run; None if there is no such time. The window is the same for every protocol.
    """
    latency = result.scenario.network.latency
    assert isinstance(latency, Constant)
    return summary(result), time_to_relay(result, 2.0 * (latency.value + PERIOD))


def cell(
    key: tuple[str, str, float],
    outcomes: Sequence[tuple[Summary, float | None]],
    *,
    reference: Sequence[tuple[Summary, float | None]],
    prompt: Sequence[tuple[Summary, float | None]],
) -> Cell:
    """Return the results of one protocol, and their differences from other runs with the same seeds.

    An outcome is the summary and the time to relay of a run; `reference` holds those of Spatial Adaptive Play, and
    `prompt` those of this protocol at latency 0.
    """
    runs = [run for run, _ in outcomes]
    relays = [time for _, time in outcomes if time is not None]
    times = [run.active_time for run in runs]
    regrets = [_gap(run) - _gap(other) for run, (other, _) in zip(runs, prompt, strict=True)]
    sent = portable_sum(run.transmissions for run in runs)
    kilobytes = portable_sum(run.bytes_sent for run in runs) / 1000.0
    duration = portable_sum(run.end_time for run in runs)
    return Cell(
        *key,
        estimate(times),
        paired(times, [run.active_time for run, _ in reference]),
        _mean([float(run.captured) for run in runs]),
        len(relays) / len(runs),
        _mean(relays) if relays else None,
        _mean([run.misassigned_time for run in runs if run.misassigned_time is not None]),
        _mean(regrets),
        _mean([float(run.handovers) for run in runs]),
        sent / duration,
        kilobytes / duration,
    )


def _gap(run: Summary) -> float:
    assert run.potential_gap is not None
    return run.potential_gap


def _mean(values: Sequence[float]) -> float:
    return estimate(values).mean
