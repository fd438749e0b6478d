"""The medium in which players move: how a flow carries them, and how it moves them relative to each other."""

from typing import Annotated, Literal

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arrays import Points, array_of
from desim.config.model import Value
from desim.config.traits import inherits, is_ours
from desim.kernel.core.units import SECOND, seconds
from desim.pursuit.motion.flow import FLOWS, Flow, FlowTraits, NoFlow, displacement, is_uniform

CARRIED_STEP = 50_000_000
"""Longest step, ns, of the integration of the path of a player that the flow carries."""


class Environment(Value):
    """The medium in which the players move."""

    flow: Annotated[Flow, FLOWS] = NoFlow()
    """Flow of the medium. All pursuers know it."""
    on: Literal["all", "pursuers"] = "all"
    """Which players the flow carries: all, or the pursuers alone, as wind that carries drones but no robot on the
    ground. Recorded motion is motion over ground, which no flow changes."""

    @property
    def is_still(self) -> bool:
        """Whether there is no flow."""
        flow = self.flow
        return type(flow) is NoFlow or (is_uniform(flow) and inherits(flow, NoFlow, "velocity_at"))

    @property
    def keeps_distances(self) -> bool:
        """Whether the flow carries all players alike, so that it changes no distance."""
        return self.is_still or (is_uniform(self.flow) and self.on == "all")

    @property
    def top_speed(self) -> float:
        """Upper bound of the speed of the flow, m/s."""
        return float(FlowTraits.of(self.flow).top_speed)

    @property
    def relative_speed(self) -> float:
        """Upper bound of the speed at which the flow moves a pursuer relative to an evader, m/s."""
        if self.keeps_distances:
            return 0.0
        return self.top_speed * (1.0 if self.on == "pursuers" else 2.0)

    def velocities(self, places: Points, t: float) -> Points:
        """Return the (k,) velocities of the flow, m/s, at (k,) places, m, at a time, s.

        Raises:
            ValueError: if a user's flow returns anything else than k finite velocities.
        """
        velocities = self.flow(places, t)
        if is_ours(type(self.flow)):
            return velocities
        checked = array_of(velocities)
        if checked.dtype.kind not in "iufc" or checked.shape != places.shape or not np.isfinite(checked).all():
            expected = f"an array of {len(places)} finite velocities, complex numbers in m/s, one for each place"
            raise wrong_answer(f"a flow should return {expected}", velocities, self.flow)
        return checked.astype(complex)

    def relative(self, target: complex, places: Points, t: float) -> Points:
        """Return the (k,) velocities, m/s, at which the flow moves an evader at `target` relative to pursuers.

        Args:
            target: the position of the evader, m.
            places: (k,) positions of the pursuers, m.
            t: the time, s.
        """
        relative = -self.velocities(places, t)
        return relative + self.velocities(np.array([target]), t) if self.on == "all" else relative

    def drifts(self, places: Points, commands: Points, begin: int, duration: float) -> Points:
        """Return the (k,) mean velocities of the flow, m/s, along the paths of players within a motion step.

        A player that moves straight at its command plus this mean ends the step where its true path ends: exactly in a
        uniform flow, else with the error of one step of the Runge-Kutta method of order 4.

        Args:
            places: (k,) positions at the start, m.
            commands: (k,) own velocities, m/s.
            begin: the start, ns.
            duration: the length of the step, s.
        """
        t, flow = begin / SECOND, self.flow
        if is_uniform(flow):
            return np.full(len(places), displacement(flow, t, t + duration) / duration)
        first = self.velocities(places, t)
        second = self.velocities(places + (commands + first) * (duration / 2.0), t + duration / 2.0)
        third = self.velocities(places + (commands + second) * (duration / 2.0), t + duration / 2.0)
        fourth = self.velocities(places + (commands + third) * duration, t + duration)
        return (first + 2.0 * second + 2.0 * third + fourth) / 6.0

    def drift(self, place: complex, command: complex, begin: int, duration: float) -> complex:
        """Return the mean velocity of the flow, m/s, along the path of one player; see `drifts`."""
        if self.is_still:
            return 0j
        return complex(self.drifts(np.array([place]), np.array([command]), begin, duration)[0])

    def drift_within(self, place: complex, command: complex, begun: int, now: int, until: int) -> complex:
        """Return the mean velocity of the flow, m/s, along the path of one player in the rest of a motion step.

        In a uniform flow that varies in time, a player drifts at the mean of the whole step from its start on. The rest
        of the step uses the same mean, so that the position at its end is exact, and a flow that carries all players
        changes no distance, whenever a player turns.

        Args:
            place: its position now, m.
            command: its own velocity, m/s.
            begun: the start of the step, ns.
            now: the present, ns.
            until: the end of the step, ns.
        """
        varies_in_time = is_uniform(self.flow) and self.flow.top_acceleration > 0.0
        begin = begun if varies_in_time else now
        return self.drift(place, command, begin, seconds(until - begin))

    def carried(self, place: complex, begin: int, end: int) -> complex:
        """Return where a player that does not move by itself is carried between two times (ns), m."""
        if is_uniform(self.flow):
            return place + displacement(self.flow, begin / SECOND, end / SECOND)
        steps = max(-(-(end - begin) // CARRIED_STEP), 1)
        for k in range(steps):
            step_begin, step_end = begin + (end - begin) * k // steps, begin + (end - begin) * (k + 1) // steps
            duration = (step_end - step_begin) / SECOND
            if duration:
                place += self.drift(place, 0j, step_begin, duration) * duration
        return place
