"""Capture times in a flow, for an evader that flees straight from each pursuer at its full speed.

A flow that carries all players alike changes no capture time. Otherwise the pursuers know the flow, and allow for it:

- a flow on the pursuers alone, the same everywhere: the pursuer meets the evader as if the evader moved with its own
  velocity less that of the flow (a closed form or, if the flow changes in time, a root by iteration);
- an affine flow on all: the distance d grows at the rate a d + v_e - v;
- any other flow: the present difference of the flow at the two players is assumed to stay. This is an approximation.
"""

from math import inf

import numpy as np

from desim.config.arrays import Floats, Points
from desim.config.python_numbers import as_complex
from desim.config.traits import inherits
from desim.kernel.core import portable_math
from desim.kernel.core.units import SECOND
from desim.pursuit.core.geometry import SMALLEST
from desim.pursuit.core.state import lengths
from desim.pursuit.motion.capture import NO_SPEED, intercept_times
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import AffineFlow, UniformFlow, displacement, is_uniform

MAX_STEPS = 1_000
"""Maximum number of steps towards a root; most roots take 5. Without a root by then, the capture time is inf."""
ROUNDING = 1e-13
"""Relative error at which a root counts as found."""


def capture_times_in_flow(
    environment: Environment,
    target: complex,
    places: Points,
    distances: Floats,
    speeds: Floats,
    evader_speed: float,
    radius: float,
    now: int,
) -> Floats:
    """Return the (k,) capture times, s, of pursuers with simple motion in a flow.

    Args:
        environment: the flow, and the players that it carries.
        target: position of the evader, m.
        places: (k,) positions of the pursuers, m; nan if unknown, and the time is then inf.
        distances: (k,) distances to the evader, m; greater than those to `target` if its position is uncertain.
        speeds: (k,) speeds of the pursuers, m/s.
        evader_speed: speed of the evader, m/s.
        radius: capture radius, m.
        now: the present, ns.
    """
    flow = environment.flow
    if inherits(flow, AffineFlow) and environment.on == "all":
        return expanding_capture_times(distances, speeds - evader_speed, radius, flow.expansion)
    offsets = target - places
    with np.errstate(invalid="ignore"):
        bearings = offsets / np.maximum(lengths(offsets), SMALLEST)
    offsets, evader_velocities = bearings * distances, bearings * evader_speed
    if is_uniform(flow) and flow.top_acceleration > 0.0 and environment.on == "pursuers":
        return _drifting_capture_times(offsets, evader_velocities, speeds, radius, flow, now / SECOND)
    relative = environment.relative(target, places, now / SECOND)
    return intercept_times(offsets, evader_velocities + relative, speeds, radius)


def expanding_capture_times(distances: Floats, closing: Floats, radius: float, expansion: float) -> Floats:
    """Return the (k,) times, s, after which distances that change at the rate a d - c have fallen to a radius.

    They are (1/a) ln((c - a eps) / (c - a d)); inf if the distance does not fall to the radius.

    Args:
        distances: (k,) distances d, m.
        closing: (k,) closing speeds c in a medium at rest, m/s.
        radius: the radius eps, m.
        expansion: the rate a, 1/s.
    """
    a = expansion
    times = np.where(distances <= radius, 0.0, inf)
    falls = (times > 0.0) & (closing - a * distances > NO_SPEED) & (closing - a * radius > NO_SPEED)
    d, c = distances[falls], closing[falls]
    if abs(a) < 1e-200:  # the relative change of the closing speed has too few digits
        times[falls] = (d - radius) / (c - a * d)
    else:
        times[falls] = portable_math.log1p(a * (d - radius) / (c - a * d)) / a
    return times


def _drifting_capture_times(
    offsets: Points, evader_velocities: Points, speeds: Floats, radius: float, flow: UniformFlow, begin: float
) -> Floats:
    """Return the (k,) least times t, s, with |offset + w t - D(t)| <= v t + eps in a flow on the pursuers alone.

    w is the velocity of the evader, and D(t) the displacement by the flow from `begin` (s) on. D(t) stays within a
    distance B of the displacement at a mean velocity, so no root is earlier than that for this velocity and the radius
    eps + B. Let f be the difference of both sides at some time, and A the greatest acceleration of the flow. A time s
    later, the difference is at least f + f' s - A s^2 / 2. Steps from root to root of this bound approach the least
    root from before.
    """
    mean, distance = flow.trend(begin)
    times = intercept_times(offsets, evader_velocities - as_complex(mean), speeds, radius + distance)
    unsolved = np.flatnonzero(times < inf)
    for _ in range(MAX_STEPS):
        t, speed, w = times[unsolved], speeds[unsolved], evader_velocities[unsolved]
        ends = (begin + t).tolist()
        gaps = offsets[unsolved] + w * t - np.array([displacement(flow, begin, end) for end in ends])
        distances = lengths(gaps)
        missing = distances - speed * t - radius
        is_unsolved = missing > ROUNDING * (radius + distances)
        if not is_unsolved.any():
            break
        rates = w - np.array([as_complex(flow.velocity_at(end)) for end in ends])
        slopes = (gaps.real * rates.real + gaps.imag * rates.imag) / np.maximum(distances, SMALLEST) - speed
        divisor = np.sqrt(slopes**2 + 2.0 * flow.top_acceleration * np.maximum(missing, 0.0)) - slopes
        times[unsolved] += np.where(is_unsolved, 2.0 * missing / np.maximum(divisor, SMALLEST), 0.0)
        unsolved = unsolved[is_unsolved]
    else:
        times[unsolved] = inf
    return times
