"""What do boids need their radio for? A flock in a loop of its own, whose headings travel over a network of desim.

Each boid tells its heading twenty times a second, and turns towards the mean heading of those that it has heard lately.
The order of the flock is the length of its mean heading, 1 if all fly alike. The flock is moved here, by ten lines of
numpy, and desim simulates its messages only (`desim.SteppedNetwork`). Two networks are the bounds: on one everything
arrives at once, on the other nothing ever arrives. Between them, latency and loss delay the order.
"""

from typing import TYPE_CHECKING

import numpy as np

from desim import Links, SteppedNetwork
from desim.analysis.statistics import mean
from desim.analysis.tables import aligned
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.seeds import stream
from desim.study.workers.batch import seeds_from
from scenarios.studies.study import Options, study

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

COUNT, BOX, RANGE = 20, 8.0, 4.0
"""Number of boids; side of the square in which they start, m; range of their radios, m."""
SPEED, TURN, NOISE = 1.0, 2.0, 0.3
"""Speed, m/s; rate at which a boid turns towards the others, 1/s; noise of its heading, per sqrt(s)."""
DT, DURATION, MEMORY = 0.05, 10.0, 2.0
"""Step of the loop, duration of a flight, and time after which a heading is forgotten, s."""
NETWORKS = {
    "everything at once": Links(range=RANGE),
    "latency 0.5 s": Links(range=RANGE, latency=0.5),
    "latency 1 s": Links(range=RANGE, latency=1.0),
    "loss 90 %": Links(range=RANGE, loss=0.9),
    "nothing ever": Links(loss=1.0),
}
"""The networks by name, the two bounds included."""


def flight(links: Links, seed: int) -> "Iterator[tuple[NDArray[np.float64], NDArray[np.complex128]]]":
    """Yield the positions (n, 2), m, and the headings (n,), complex numbers of length 1, of a flock at each step."""
    rng = stream(seed, "boids")
    x = rng.uniform(0.0, BOX, (COUNT, 2))
    headings = _normalised(rng.standard_normal(COUNT) + 1j * rng.standard_normal(COUNT))
    with SteppedNetwork(COUNT, links, seed=seed, positions=x) as network:
        for _ in range(round(DURATION / DT)):
            for boid in range(COUNT):
                network.publish(boid, complex(headings[boid]))
            x += DT * SPEED * np.column_stack([headings.real, headings.imag])
            network.step(DT)  # reads the new positions from `x`
            mean_headings = np.array([_mean_heard(network, boid, headings[boid]) for boid in range(COUNT)])
            noise = rng.standard_normal(COUNT) + 1j * rng.standard_normal(COUNT)
            headings = _normalised(headings + DT * TURN * (mean_headings - headings) + NOISE * DT**0.5 * noise)
            yield x.copy(), headings


def _mean_heard(network: SteppedNetwork, boid: int, heading: complex) -> complex:
    """Return the mean of the headings that a boid has heard within `MEMORY`; its own heading if there are none."""
    recent = [message.body for message in network.latest(boid).values() if network.now - message.sent <= MEMORY]
    return portable_sum(recent) / len(recent) if recent else heading


def _normalised(headings: "NDArray[np.complex128]") -> "NDArray[np.complex128]":
    """Return complex numbers scaled to the length 1."""
    scaled: NDArray[np.complex128] = headings / np.abs(headings)
    return scaled


def order(links: Links, seed: int) -> "NDArray[np.float64]":
    """Return the order of a flock at each step, in [0, 1]."""
    return np.array([abs(headings.mean()) for _, headings in flight(links, seed)])


def picture(curves: "dict[str, NDArray[np.float64]]", seed: int) -> "Figure":
    """Draw the paths of one flock under both bounds, and the mean order over time."""
    from desim.analysis.drawing import palette, plots

    with plots.styled(figsize=(9.0, 3.4)) as figure:
        *maps, right = figure.subplots(1, 3, width_ratios=(1, 1, 1.4))
        names = list(NETWORKS)
        for axes, name in zip(maps, (names[0], names[-1]), strict=True):
            paths = np.array([x for x, _ in flight(NETWORKS[name], seed)])
            for boid in range(COUNT):
                axes.plot(*paths[:, boid].T, color=palette.SERIES[names.index(name)], lw=0.8)
                axes.plot(*paths[-1, boid], "o", color="black", ms=2.0)
            axes.set(title=name, xlabel="x (m)", ylabel="y (m)", aspect="equal")
        times = DT * np.arange(1, len(curves[names[0]]) + 1)
        for colour, (name, curve) in zip(palette.SERIES, curves.items(), strict=False):
            right.plot(times, curve, color=colour, label=name)
        right.set(xlabel="time (s)", ylabel="order of the flock (mean)", ylim=(0.0, 1.0), xlim=(0.0, DURATION))
        right.legend(fontsize=7, loc="center right", bbox_to_anchor=(1.0, 0.42))
    return figure


@study("boids", __doc__, seconds=0.6, runs=20)
def main(options: Options) -> None:
    """Fly, average and draw."""
    seeds = seeds_from(options.seed, options.runs)
    orders = {name: np.array([order(links, seed) for seed in seeds]) for name, links in NETWORKS.items()}
    rows: list[Sequence[str]] = [("network", "order after 2 s", "5 s", f"{DURATION:g} s")]
    for name, flights in orders.items():
        means_at = [mean(flights[:, round(t / DT) - 1]) for t in (2.0, 5.0, DURATION)]
        rows.append((name, *(f"{value:.2f}" for value in means_at)))
    means = {name: flights.mean(axis=0) for name, flights in orders.items()}
    document = {"step": DT, "order": {name: mean.tolist() for name, mean in means.items()}}
    options.show(document, aligned(rows), lambda: picture(means, seeds[0]))


if __name__ == "__main__":
    main()
