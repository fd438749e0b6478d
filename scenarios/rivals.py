"""Compare all protocols: the same starts, the same luck, as many announcements a second, over a range of latencies.

In the scenario of the paper, where one pursuer is twice as fast as the others; in one that stresses the relay, where
all are equally fast; and in that of the paper again when nobody sees the others, so that where they are has to be told,
too. Who talks says something ten times a second and no more: the same number of messages, not of bytes. The centralised
benchmark and, where positions are sensed, the geometric rules do not talk. Everybody decides ten times a second on the
average. What talking is worth is judged against a silent team, in which everyone decides alone; what delay costs,
against the same protocol in the same runs without delay.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from desim import Result, Scenario, summary
from desim.analysis.metrics import Summary, time_to_relay
from desim.analysis.statistics import estimate
from desim.analysis.tables import aligned
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.announcements import Announcements
from desim.scenario.scenario import PROTOCOLS, Motion, Recording, Team
from protocols.schedules import Poisson
from scenarios.study import Options, study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LATENCIES = (0.0, 0.05, 0.2, 0.5, 1.0)
"""One-way latency L, s."""
SHOWN = 0.2
"""The latency at which everything is shown, s."""
PERIOD = 0.1
"""Between two announcements, and on the average two decisions, of a pursuer, s."""
STEP = 0.01
"""Of motion, and between two samples of positions, s."""
N = 20
WORLDS: Mapping[str, Scenario] = MappingProxyType(
    {
        "paper": Scenario(name="paper", team=Team(count=N)),
        "relay stress": Scenario(name="relay stress", horizon=60.0, team=Team(count=N, speeds=1.0)),
        "paper, unseen": Scenario(name="paper, unseen", team=Team(count=N), announce=Announcements(payload="state")),
    }
)
SILENT = "nobody talks"
REFERENCE = "sap"


@dataclass(frozen=True)
class Cell:
    """What one protocol came to in one world at one latency, means over the runs."""

    world: str
    protocol: str
    latency: float
    active_time: float
    half_width: float
    """Of the 95 % interval of the active time, s."""
    difference: float
    """Active time less that of Spatial Adaptive Play in the same runs, s."""
    difference_half_width: float
    captured: float
    """Share of the runs."""
    relayed: float
    """Share of the runs in which the relay pursuer came to chase alone, for two latencies and periods."""
    time_to_relay: float | None
    """s, over those runs."""
    misassigned_time: float
    network_regret: float
    """Potential gap less that without delay, s^2."""
    handovers: float
    transmissions: float
    """Per second."""
    kilobytes: float
    """Per second."""
    saved_per_transmission: float | None
    """Active time saved against a silent team, s per transmission; None without any."""
    saved_per_kilobyte: float | None


def contender(kind: str) -> object:
    """Return a protocol that decides as often as the others."""
    fields = PROTOCOLS.choices()[kind].model_fields
    settings = {key: PERIOD for key in ("slot", "period") if key in fields}
    schedule = {"schedule": Poisson(rate=1.0 / PERIOD)} if "schedule" in fields else {}
    return PROTOCOLS.choices()[kind](**settings, **schedule)


def scenario(world: str, protocol: str, latency: float) -> Scenario:
    """Return one scenario of the study."""
    said = {"trigger": "never", "warm_start": False} if protocol == SILENT else {"trigger": "heartbeat"}
    announce = WORLDS[world].announce.model_copy(update={"heartbeat": PERIOD} | said)
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
    """Run every protocol in every world at every latency."""
    protocols = [*PROTOCOLS.choices(), SILENT]
    keys = [(world, protocol, latency) for world in WORLDS for latency in LATENCIES for protocol in protocols]
    runs = dict(zip(keys, options.measure([scenario(*key) for key in keys], "rivals", measured), strict=True))
    return [
        cell(
            (world, protocol, latency),
            runs[world, protocol, latency],
            reference=runs[world, REFERENCE, latency],
            silent=runs[world, SILENT, latency],
            prompt=runs[world, protocol, 0.0],
        )
        for world, protocol, latency in keys
    ]


def measured(result: Result) -> tuple[Summary, float | None]:
    """Return the numbers of a run, and its time to relay by a window that is the same for all protocols, s."""
    latency = result.scenario.network.latency
    assert isinstance(latency, Constant)
    return summary(result), time_to_relay(result, 2.0 * (latency.value + PERIOD))


def cell(
    key: tuple[str, str, float],
    found: Sequence[tuple[Summary, float | None]],
    *,
    reference: Sequence[tuple[Summary, float | None]],
    silent: Sequence[tuple[Summary, float | None]],
    prompt: Sequence[tuple[Summary, float | None]],
) -> Cell:
    """Return what the runs of one protocol came to, beside others with the same seeds.

    Args:
        key: world, protocol and latency.
        found: of each run, its numbers and its time to relay.
        reference: those of Spatial Adaptive Play.
        silent: those of a team in which nobody talks.
        prompt: those of the same protocol without delay.
    """
    runs = [run for run, _ in found]
    relays = [time for _, time in found if time is not None]
    active = estimate([run.active_time for run in runs])
    paired = estimate([run.active_time - other.active_time for run, (other, _) in zip(runs, reference, strict=True)])
    saved = sum(other.active_time - run.active_time for run, (other, _) in zip(runs, silent, strict=True))
    regrets = [_gap(run) - _gap(other) for run, (other, _) in zip(runs, prompt, strict=True)]
    sent, kilobytes = sum(run.transmissions for run in runs), sum(run.bytes_sent for run in runs) / 1000.0
    duration = sum(run.end_time for run in runs)
    return Cell(
        *key,
        active.mean,
        active.half_width,
        paired.mean,
        paired.half_width,
        _mean([float(run.captured) for run in runs]),
        len(relays) / len(runs),
        _mean(relays) if relays else None,
        _mean([run.misassigned_time for run in runs if run.misassigned_time is not None]),
        _mean(regrets),
        _mean([float(run.handovers) for run in runs]),
        sent / duration,
        kilobytes / duration,
        saved / sent if sent else None,
        saved / kilobytes if kilobytes else None,
    )


def _gap(run: Summary) -> float:
    assert run.potential_gap is not None
    return run.potential_gap


def _mean(values: Sequence[float]) -> float:
    return estimate(values).mean


def table(cells: Sequence[Cell], runs: int) -> str:
    """Return three tables for each world."""
    return "\n\n".join(part for world in WORLDS for part in _tables(world, cells, runs))


def _tables(world: str, cells: Sequence[Cell], runs: int) -> list[str]:
    here = {(each.protocol, each.latency): each for each in cells if each.world == world}
    names = list(dict.fromkeys(each.protocol for each in cells))
    heads = [f"L = {latency:g} s" for latency in LATENCIES]
    active, paired = [("", *heads)], [("", *heads)]
    for name in names:
        line = [here[name, latency] for latency in LATENCIES]
        active.append((name, *(f"{each.active_time:.1f} +- {each.half_width:.1f}" for each in line)))
        if name != REFERENCE:
            paired.append((name, *(f"{each.difference:+.1f} +- {each.difference_half_width:.1f}" for each in line)))
    heads = ["captured", "relayed", "after", "misassigned", "regret", "hand-overs", "sent/s", "kB/s"]
    rest = [("", *heads, "saved/sent", "saved/kB")]
    for name in names:
        at = here[name, SHOWN]
        rest.append(
            (
                name,
                f"{at.captured:.0%}",
                f"{at.relayed:.0%}",
                _number(at.time_to_relay, "s"),
                f"{at.misassigned_time:.2f} s",
                f"{at.network_regret:.1f} s^2",
                f"{at.handovers:.1f}",
                f"{at.transmissions:.0f}",
                f"{at.kilobytes:.2f}",
                _number(at.saved_per_transmission, "s", digits=3),
                _number(at.saved_per_kilobyte, "s"),
            )
        )
    what = f"{world}, {N} pursuers, {runs} runs, 95 % intervals"
    meaning = "regret: potential gap beyond that without delay; saved: active time less than that of a silent team"
    return [
        f"Sum of active times, s: {what}\n{aligned(active)}",
        f"The same less that of {REFERENCE} in the same runs, s: {what}\n{aligned(paired)}",
        f"At L = {SHOWN:g} s: {what}\n{meaning}\n{aligned(rest)}",
    ]


def _number(value: float | None, unit: str, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"


def picture(cells: Sequence[Cell]) -> "Figure":
    """Draw the active time of every protocol at every latency, those first that take least on the whole."""
    from desim.analysis import plots

    total: dict[str, float] = defaultdict(float)
    for each in cells:
        total[each.protocol] += each.active_time
    names = sorted(total, key=total.__getitem__)
    with plots.styled(figsize=(9.5, 4.6)) as figure:
        for axes, world in zip(figure.subplots(1, len(WORLDS), sharey=True, squeeze=False)[0], WORLDS, strict=True):
            draw(axes, world, names, [each for each in cells if each.world == world])
        figure.supxlabel("one-way latency L (s)", fontsize=9)
    return figure


def draw(axes: "Axes", world: str, names: Sequence[str], cells: Sequence[Cell]) -> None:
    """Draw one world: a row per protocol, a column per latency, colour and number the active time."""
    import numpy as np
    from matplotlib.colors import LogNorm

    times = np.zeros((len(names), len(LATENCIES)))
    for each in cells:
        times[names.index(each.protocol), LATENCIES.index(each.latency)] = each.active_time
    axes.imshow(times, norm=LogNorm(), cmap="viridis_r", aspect="auto")
    middle = np.sqrt(times.min() * times.max())
    for (row, column), time in np.ndenumerate(times):
        colour = "black" if time < middle else "white"
        axes.text(column, row, f"{time:.0f}", ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(len(LATENCIES)), [f"{latency:g}" for latency in LATENCIES])
    axes.set_yticks(range(len(names)), names)
    axes.set_title(f"{world}: sum of active times (s)", fontsize=9)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


@study("rivals", __doc__, runs=20)
def main(options: Options) -> None:
    """Measure, compare, show."""
    cells = measure(options)
    document = {"cells": [asdict(each) for each in cells]}
    options.show(document, table(cells, options.runs), lambda: picture(cells))


if __name__ == "__main__":
    main()
