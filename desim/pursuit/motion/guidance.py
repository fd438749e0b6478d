"""Guidance laws: the heading of a pursuer that chases an evader.

A law maps the observed motion of the evaders to the velocities of the pursuers that chase them. It is called for
several pursuers at once or for one alone, so the velocity of a pursuer must not depend on the other pursuers. Points
and velocities are complex numbers, as in `desim.pursuit.core.state`.
"""

from collections.abc import Mapping
from math import sqrt
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arrays import Floats, Points, array_of
from desim.config.model import Value
from desim.config.traits import Traits, is_ours
from desim.pursuit.core.geometry import SMALLEST, toward
from desim.pursuit.core.state import lengths
from desim.pursuit.motion.capture import NO_SPEED

EvaderVelocity = complex | Points
"""One velocity, m/s, if all pursuers chase the same evader; else (N,) velocities, of the evader of each pursuer."""


class Guidance(Protocol):
    """A guidance law: `guidance(gaps, aims, evader_velocity, speeds)` returns the (N,) velocities, m/s.

    N is the number of pursuers in the call, which may be 1. If an evader is out of sensing range, its estimated
    position and velocity take the place of the observed ones.

    Args:
        gaps: (N,) vectors from each pursuer to the observed position of its evader, m.
        aims: (N,) vectors from each pursuer to the point that it aims at, m: the position of its evader at the end of
            the motion step if the evader moves first (`motion.order`), else at the start of the step.
        evader_velocity: observed velocity of the evader, m/s: its velocity during the present step if the evader moves
            first, else during the step before; (N,) if pursuers may chase different evaders.
        speeds: (N,) speeds, m/s, 0 for inactive pursuers; no velocity exceeds them.
    """

    def __call__(  # noqa: D102
        self, gaps: Points, aims: Points, evader_velocity: EvaderVelocity, speeds: Floats
    ) -> Points: ...


class GuidanceTraits(Traits):
    """The method of a guidance law that must agree with its `__call__`."""

    twins: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({"one": ("__call__",)})


class PurePursuit(Value):
    """Head straight for the evader (Lee & Bakolas): u_i = (x_e - x_i) / |x_e - x_i|."""

    kind: Literal["pure_pursuit"] = "pure_pursuit"

    def __call__(self, gaps: Points, aims: Points, evader_velocity: EvaderVelocity, speeds: Floats) -> Points:
        """Return the (N,) velocities, m/s."""
        return toward(aims, speeds)

    def one(self, gap: complex, aim: complex, evader_velocity: complex, speed: float) -> complex:
        """Return the velocity of one pursuer, m/s."""
        return aim * (speed / max(abs(aim), SMALLEST))


class ConstantBearing(Value):
    """Head for the intercept point of an evader of constant velocity; without such a point, straight for the evader.

    With w the velocity of the evader, the point is x_e + w t for the least t > 0 with |x_e + w t - x_i| = v_i t. The
    line of sight keeps its direction b (parallel navigation). Along and across this line, w has the components w_along
    and w_across. The pursuer matches w_across and uses the rest of its speed along the line, so that its velocity is
    b (sqrt(v_i^2 - w_across^2) + 1j w_across). The closing speed is sqrt(v_i^2 - w_across^2) - w_along. There is no
    intercept point if the closing speed is not positive, or if |w_across| > v_i.

    Against an evader of full speed v_e < v_i this point is on the Apollonius circle of the two players, in the
    direction in which the evader moves (Isaacs 1965). The pursuer captures the evader inside the circle, whatever the
    evader does: see `apollonius_disc` and `desim.testing.pursuits.ApolloniusWatcher`.
    """

    kind: Literal["constant_bearing"] = "constant_bearing"

    def __call__(self, gaps: Points, aims: Points, evader_velocity: EvaderVelocity, speeds: Floats) -> Points:
        """Return the (N,) velocities, m/s."""
        distances = lengths(gaps)
        bearings = gaps / np.maximum(distances, SMALLEST)
        x, y = bearings.real, bearings.imag
        w = evader_velocity
        w_along, w_across = w.real * x + w.imag * y, w.imag * x - w.real * y  # along and across the line of sight
        along_squared = speeds**2 - w_across**2
        along = np.sqrt(np.maximum(along_squared, 0.0))
        meets = (along_squared >= 0.0) & (along - w_along > NO_SPEED) & (distances > 0.0)
        return np.where(meets, bearings * along + bearings * (1j * w_across), toward(aims, speeds))

    def one(self, gap: complex, aim: complex, evader_velocity: complex, speed: float) -> complex:
        """Return the velocity of one pursuer, m/s.

        Kept equal to the velocities of all by
        `tests/pursuit/test_guidance.py::test_the_course_of_one_is_exactly_that_of_the_team`.
        """
        distance = abs(gap)
        inverse = 1.0 / max(distance, SMALLEST)  # numpy divides by multiplying with it, so the last bit is the same
        x, y, w = gap.real * inverse, gap.imag * inverse, evader_velocity
        w_along, w_across = w.real * x + w.imag * y, w.imag * x - w.real * y
        along_squared = speed * speed - w_across * w_across
        along = sqrt(max(along_squared, 0.0))
        if along_squared >= 0.0 and along - w_along > NO_SPEED and distance > 0.0:
            return complex(x * along - y * w_across, y * along + x * w_across)
        return aim * (speed / max(abs(aim), SMALLEST))


def apollonius_disc(evader: complex, pursuer: complex, evader_speed: float, speed: float) -> tuple[complex, float]:
    """Return the centre and the radius, m, of the disc of points that an evader reaches before a faster pursuer.

    With m = v_e / v, the centre is x_e + m^2 / (1 - m^2) (x_e - x_i) and the radius m |x_e - x_i| / (1 - m^2).

    Args:
        evader: position x_e, m.
        pursuer: position x_i, m.
        evader_speed: v_e, m/s.
        speed: v, m/s.

    Raises:
        ValueError: if the pursuer is not faster than the evader.
    """
    if not speed > evader_speed:
        raise ValueError(f"the pursuer should be faster than the evader, got {speed:g} and {evader_speed:g} m/s")
    ratio = evader_speed / speed
    offset, complement = evader - pursuer, 1.0 - ratio * ratio
    return evader + ratio * ratio / complement * offset, ratio * abs(offset) / complement


def guided_velocities(
    law: Guidance, gaps: Points, aims: Points, evader_velocity: EvaderVelocity, speeds: Floats
) -> Points:
    """Return the (N,) velocities, m/s, that a law gives; for the other arguments see `Guidance`.

    Raises:
        ValueError: if a user's law returns anything else than N velocities, or exceeds the speed of a pursuer.
    """
    if is_ours(type(law)):
        return law(gaps, aims, evader_velocity, speeds)
    velocities = law(_read_only(gaps), _read_only(aims), evader_velocity, _read_only(speeds))
    checked = array_of(velocities)
    if checked.dtype.kind not in "iufc" or checked.shape != speeds.shape:
        expected = f"an array of {len(speeds)} velocities, complex numbers in m/s, one for each pursuer in the call"
        raise wrong_answer(f"a guidance law should return {expected}", velocities, law)
    checked = checked.astype(complex)
    if not (lengths(checked) <= speeds * (1.0 + 1e-9)).all():
        raise wrong_answer(f"velocities should be within the speeds {speeds} m/s", velocities, law)
    return checked


def _read_only(array: Any) -> Any:
    """Return a view of an array that a user's law cannot change: a change would last beyond the call."""
    view = array.view()
    view.setflags(write=False)
    return view


def guided_velocity(law: Guidance, gap: complex, aim: complex, evader_velocity: complex, speed: float) -> complex:
    """Return the velocity, m/s, that a law gives for one pursuer; see `guided_velocities`.

    Kept equal to the velocities of all by
    `tests/pursuit/test_kinematics.py::test_pursuers_led_one_by_one_run_as_a_team_led_at_once`.
    """
    if type(law) is PurePursuit or type(law) is ConstantBearing:  # the same result, several times faster
        return law.one(gap, aim, evader_velocity, speed)
    return complex(guided_velocities(law, np.array([gap]), np.array([aim]), evader_velocity, np.array([speed]))[0])
