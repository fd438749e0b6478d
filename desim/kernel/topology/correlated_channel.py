"""The states of the channels between nodes, as functions of their positions and of time: sums of plane waves.

A process is the sum of n cosines of the positions of both nodes and of the time, whose phases are random (Clarke 1968;
Zheng & Xiao 2003, "Simulation Models With Correct Statistical Properties for Rayleigh Fading Channels"; for shadowing,
Cai & Giannakis 2003, "A Two-Dimensional Channel Simulation Model for Shadowing Processes"). The directions at the two
nodes, and the Doppler shifts, are those of a lattice with n points, turned by random angles for each pair. The
autocorrelation of fading is almost exact for each pair up to n / 2 pi wavelengths or cycles of the Doppler frequency.

The autocorrelation of shadowing is exact in the mean over all seeds while one node of a link moves; for one seed it is
off by 0.4 / n (standard deviation). If both nodes move, the mean is biased, because the lattice pairs the lengths of
the waves at the two nodes in the same way for all seeds: with n = 64 by +0.010, +0.018 and +0.003 if each moves by
0.1 d, 0.3 d and d; with n = 256 by +0.011, +0.012 and +0.009; with n = 8 by +0.04, +0.09 and -0.14.

Nothing but random numbers is kept, so the states do not depend on the order in which they are asked for.
"""

import math
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from desim.config.arrays import Floats, Integers
from desim.config.errors import KeyedError, Problem
from desim.kernel.core.portable_math import cos_of_turns
from desim.kernel.core.positions import Nodes
from desim.kernel.core.seeds import ROOM, pair_draw, pair_uniform
from desim.kernel.models.coherence import LIGHT, ChannelState, Coherence

STEPS = (0.0, 0.6180339887498949, 0.7548776662466927, 0.5698402909980532)
"""Steps of the lattice per point, by axis (Roberts 2018).

The step is 0.618 for 2 axes, the reciprocal golden ratio; for 3 axes, 0.755, the reciprocal plastic number, and its
square, 0.570. Axes 0, 1 and 2 are the directions at both ends and the Doppler shifts of fading. For shadowing, axes 0
and 1 are the lengths and the directions of the waves at the first end, and axes 2 and 3 those at the other end.
"""

OF_NODE = "shadowing of a node"
"""The name of the process of the surroundings of one node."""


class Ends(NamedTuple):
    """The ends of k links at one instant, or each at its own time."""

    src: int | Integers
    """The sender, one for all or (k,)."""
    dst: Nodes
    """(k,) the receivers."""
    src_at: Floats
    """Positions of the senders, one (2,) for all or (k, 2), m."""
    dst_at: Floats
    """(k, 2) positions of the receivers, m."""
    time: float | Floats
    """One for all or (k,), s."""


class _Phases(NamedTuple):
    """The random numbers of p processes of each of k pairs."""

    waves: Floats
    """(n, p, k) the phases of the waves, in turns."""
    rotations: Floats
    """(2, 3, p, k) cosines and sines of the random angles of the directions at both ends, and of the Doppler shifts."""

    def of(self, columns: Nodes) -> "_Phases":
        return _Phases(self.waves[..., columns], self.rotations[..., columns])


class CorrelatedChannel:
    """The channels of all pairs of nodes of a run.

    Args:
        coherence: how they change with time and place.
        seed: the seed of the run.
        size: the number of nodes.
    """

    def __init__(self, coherence: Coherence, seed: int, size: int):
        self._coherence, self._seed, self._size = coherence, seed, size
        self._kept: dict[tuple[str, int, int], _Phases] = {}
        """By name, number of processes and sender: the random numbers of its pairs with all nodes."""

    def between(self, ends: Ends) -> ChannelState:
        """Return the states of the channels of k links."""
        return ChannelState(partial(self._normals, ends), partial(self._shadowing, ends))

    # Fading.

    def _normals(self, ends: Ends, count: int) -> Floats:
        """Return (count, k) Gaussian numbers of k links: the cosine and the sine parts of sums of waves."""
        coherence, processes = self._coherence, (count + 1) // 2  # each gives two numbers
        phases = self._phases("fading", processes, ends)
        per_metre = (coherence.frequency or 0.0) / LIGHT
        rows = _turned(ends, phases.rotations, per_metre) if per_metre else []
        directions = self._directions[: len(rows)]
        if coherence.doppler is not None:
            cosines, sines = phases.rotations[:, 2] * (coherence.doppler * np.asarray(ends.time))
            rows, directions = [*rows, cosines, -sines], np.concatenate((directions, self._directions[4:]))
        if not rows:
            raise _missing(coherence.lacks("fading"))
        phase = _phase(directions, rows, phases.waves)
        parts = _sum(np.stack([phase, phase - 0.25], axis=2))  # sin(2 pi x) = cos(2 pi (x - 1/4))
        return parts.reshape(2 * processes, -1)[:count]

    @cached_property
    def _directions(self) -> Floats:
        """(6, n) cosines and sines of the directions at both ends, and of those of the Doppler shifts."""
        angles = [2.0 * math.pi * index / self._coherence.waves for index in range(self._coherence.waves)]
        circle = np.array([[math.cos(angle) for angle in angles], [math.sin(angle) for angle in angles]])
        return np.concatenate([circle[:, self._point(axis)] for axis in range(3)])

    # Shadowing.

    def _shadowing(self, ends: Ends) -> Floats:
        """Return (k,) numbers of k links, with variance 1."""
        if lack := self._coherence.lacks("shadowing"):
            raise _missing(lack)
        phases, shared = self._phases("shadowing", 1, ends), self._coherence.shared
        by_pair: Floats = _sum(_phase(self._spectrum, _turned(ends, phases.rotations, 1.0), phases.waves))[0]
        if not shared:
            return by_pair
        nodes, at = np.append(ends.dst, ends.src), np.concatenate((ends.dst_at, np.atleast_2d(ends.src_at)))
        by_node = self._shadowing_by_nodes(nodes, at)
        by_both_ends = by_node[: len(ends.dst)] + by_node[len(ends.dst) :]
        return math.sqrt(1.0 - shared) * by_pair + math.sqrt(shared / 2.0) * by_both_ends

    def _shadowing_by_nodes(self, nodes: Nodes, at: Floats) -> Floats:
        """Return (k,) the shadowing by what surrounds nodes at their positions, with variance 1."""
        ends = Ends(nodes, nodes, at, at, 0.0)
        phases = self._draw(OF_NODE, 1, nodes, nodes) if self._kept_of_nodes is None else self._kept_of_nodes.of(nodes)
        rows = _turned(ends, phases.rotations, 1.0)[:2]
        return np.asarray(_sum(_phase(self._spectrum[:2], rows, phases.waves))[0])

    @cached_property
    def _spectrum(self) -> Floats:
        """(4, n) wave vectors at both ends, in turns per metre."""
        count, rows = self._coherence.waves, []
        for end in (0, 1):
            offset = pair_draw(self._seed, "shadowing spectrum", end, end)
            lengths = [self._wave_number((index + offset) / count) for index in self._point(2 * end).tolist()]
            angles = [2.0 * math.pi * index / count for index in self._point(2 * end + 1).tolist()]
            rows += [
                [length * function(angle) for length, angle in zip(lengths, angles, strict=True)]
                for function in (math.cos, math.sin)
            ]
        return np.array(rows)

    def _wave_number(self, share: float) -> float:
        """Return the wave number, turns per metre, that a share of the spectrum exceeds.

        Of the spectrum of exp(-r / d) in the plane, the share 1 / sqrt(1 + (k d)^2) has wave numbers above k, rad/m.
        """
        assert self._coherence.decorrelation is not None
        return math.sqrt(1.0 / share**2 - 1.0) / (2.0 * math.pi * self._coherence.decorrelation)

    # Random numbers.

    def _point(self, axis: int) -> Nodes:
        """Return (n,) the indices along an axis of the points of the lattice."""
        count = self._coherence.waves
        # The step nearest to the ideal one with which the indices are all different.
        nearest = sorted(range(1, count), key=lambda step: abs(step - STEPS[axis] * count))
        step = next(step for step in nearest if math.gcd(step, count) == 1) if axis else 1
        return np.arange(count) * step % count

    def _phases(self, name: str, processes: int, ends: Ends) -> _Phases:
        """Return the random numbers of processes of k pairs; keep those of a sender if there is room for all."""
        src = ends.src
        if not isinstance(src, int) or self._size**2 * processes * self._coherence.waves > ROOM:
            return self._draw(name, processes, src, ends.dst)
        key = name, processes, src
        phases = self._kept.get(key)
        if phases is None:
            phases = self._kept[key] = self._draw(name, processes, src, np.arange(self._size))
        return phases.of(ends.dst)

    @cached_property
    def _kept_of_nodes(self) -> _Phases | None:
        """The random numbers of what surrounds each node; None: there are too many to keep them."""
        nodes = np.arange(self._size)
        return self._draw(OF_NODE, 1, nodes, nodes) if self._size * self._coherence.waves <= ROOM else None

    def _draw(self, name: str, processes: int, src: int | Integers, dst: Nodes) -> _Phases:
        """Return the random numbers of processes of k pairs: for each process three angles, then the waves."""
        rows = self._coherence.waves + 3
        count, links = rows * processes, len(dst)
        senders = np.tile(np.broadcast_to(src, links), count)
        draws = pair_uniform(self._seed, name, senders, np.tile(dst, count), np.repeat(np.arange(count), links))
        by_process = draws.reshape(processes, rows, links).transpose(1, 0, 2)
        angles, waves = by_process[:3], np.ascontiguousarray(by_process[3:])
        return _Phases(waves, np.stack([cos_of_turns(angles), cos_of_turns(angles - 0.25)]))


def _turned(ends: Ends, rotations: Floats, per_metre: float) -> list[Floats]:
    """Return the coordinates of both ends of k links, turned by the random angles of p processes; (p, k) each.

    The first end is the node with the smaller number, so both directions have the same state.
    """
    is_first = np.asarray(ends.src) <= ends.dst
    (u, v), (x, y) = np.broadcast_to(ends.src_at, ends.dst_at.shape).T * per_metre, ends.dst_at.T * per_metre
    places = [
        (np.where(is_first, u, x), np.where(is_first, v, y)),
        (np.where(is_first, x, u), np.where(is_first, y, v)),
    ]
    rows: list[Floats] = []
    for (across, along), cosines, sines in zip(places, *rotations[:, :2], strict=True):
        rows += [cosines * across + sines * along, cosines * along - sines * across]
    return rows


def _phase(directions: Floats, rows: list[Floats], waves: Floats) -> Floats:
    """Return (n, p, k) the phases of n waves of p processes on k links, in turns.

    A loop and not `@`, because BLAS rounds differently on different processors.
    """
    phases = waves.copy()
    for direction, row in zip(directions, rows, strict=True):
        phases += direction[:, np.newaxis, np.newaxis] * row
    return phases


def _sum(phases: Floats) -> Floats:
    """Return the sums of the cosines of phases, in turns, over their first axis, with variance 1.

    Halves are added to each other, because `np.add.reduce` rounds differently for one link than for two.
    """
    parts = cos_of_turns(phases)
    while (count := len(parts)) > 1:
        half = (count + 1) // 2
        parts[: count - half] += parts[half:]
        parts = parts[:half]
    return np.asarray(parts[0] * math.sqrt(2.0 / len(phases)))


def _missing(lack: str) -> KeyedError:
    return KeyedError(Problem(lack, "coherence"))


def uncorrelated(seed: int, src: int, dst: Nodes, number: int, *, per_link: bool) -> ChannelState:
    """Return states of channels with a shadowing of their own for each pair, or for each number of a message."""

    def shadowing() -> Floats:
        from scipy.special import ndtri

        return np.asarray(ndtri(pair_uniform(seed, "shadowing", src, dst, 0 if per_link else number + 1)))

    return ChannelState(unknown_fading, shadowing)


def unknown_fading(_: int) -> Floats:
    """Raise ValueError: only correlated fading has Gaussian processes."""
    raise ValueError('the fading has no processes unless network.fading = "correlated"')
