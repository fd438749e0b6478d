"""A number that a refusal names as a bound is allowed, and the next one beyond it is refused."""

from math import inf, nextafter

import pytest

from desim.config.field_types import MIN_PERIOD, RESOLUTION
from desim.kernel.core.message_size import MAX_SIZE, checked_size
from desim.kernel.models.access import CsmaCa, Tdma
from desim.kernel.models.common_losses import max_common
from desim.kernel.models.latency import Uniform
from desim.kernel.models.latency_by_link import LatencyMatrix
from desim.kernel.models.loss import FourState, GilbertElliott
from desim.kernel.models.transport import Coded
from desim.pursuit.byzantine.falsehoods import RandomTime
from desim.pursuit.evaders.recorded import RecordedMotion
from desim.scenario.scenario import Motion, Recording, Scenario

WAYPOINTS = [[0.0, 1.0, 1.0], [2.0, 2.0, 2.0]]
LEAST, MOST = -inf, inf
"""In which direction lies what is refused."""
BOUNDS = {
    "horizon": (lambda x: Scenario(horizon=x), RESOLUTION, LEAST, "should be at least 1e-09 s"),
    "recorded positions": (lambda x: Recording(trajectory=x), MIN_PERIOD, LEAST, "should be 0 or at least 1e-06 s"),
    "motion step": (lambda x: Motion(step=x), MIN_PERIOD, LEAST, "greater than or equal to 0.000001"),
    "ack_timeout": (lambda x: CsmaCa(sifs=0.5, ack=0.25, difs=1.0, ack_timeout=x), 0.75, LEAST, "at least sifs . ack"),
    "eifs": (lambda x: CsmaCa(difs=0.5, eifs=x), 0.5, LEAST, "eifs should be at least difs"),
    "low latency": (lambda x: Uniform(low=x, high=0.5), 0.5, MOST, "low should be at most high"),
    "high latency": (lambda x: Uniform(low=0.5, high=x), 0.5, LEAST, "low should be at most high"),
    "low time": (lambda x: RandomTime(low=x, high=0.5), 0.5, MOST, "low should be at most high"),
    "latency of a matrix": (lambda x: LatencyMatrix(values=[[0.0, x], [x, 0.0]]), 1e9, MOST, "at most 1e.09 s"),
    "share in a burst": (lambda x: GilbertElliott(share=0.75, burst=x), 3.0, LEAST, "burst should be at least 3"),
    "burst": (lambda x: GilbertElliott(share=0.25, burst=x), 1.0, LEAST, "burst should be at least 1"),
    "common": (
        lambda x: GilbertElliott(share=0.25, advance="time", common=x),
        max_common(0.25),
        MOST,
        "common should be at most",
    ),
    "p13": (lambda x: FourState(p13=x, p14=0.5), 0.5, MOST, "p13 . p14 should be at most 1"),
    "p31": (lambda x: FourState(p31=x, p32=0.5), 0.5, MOST, "p31 . p32 should be at most 1"),
    "start of a record": (lambda x: RecordedMotion(waypoints=WAYPOINTS, start_time=x), 2.0, MOST, "at most the time"),
    "pieces": (lambda x: Coded(pieces=3, needed=x), 3, MOST, "needed should be at most"),
    "least size": (checked_size, 0, LEAST, "should be at least 0 bytes"),
    "greatest size": (checked_size, MAX_SIZE, MOST, f"should be at most {MAX_SIZE} bytes"),
}
"""How it is made of a number, the bound, the side on which numbers are refused, and what is said."""
EXCLUDED = {
    "guard": (lambda x: Tdma(slot=0.5, guard=x), 0.5, MOST, "guard should be less than slot"),
    "sifs": (lambda x: CsmaCa(difs=0.5, sifs=x), 0.5, MOST, "sifs should be less than difs"),
    "sensing_delay": (
        lambda x: CsmaCa(slot=0.5, difs=0.25, sifs=0.1, sensing_delay=x),
        0.25,
        MOST,
        "less than slot and difs",
    ),
}
"""The same, of bounds that are themselves refused."""


def beyond(bound, side):
    """Return the next number on a side; times differ if they do in ns."""
    if isinstance(bound, int):
        return bound + (1 if side > 0 else -1)
    return (
        min(bound * 1.001, nextafter(bound, side) + 2e-9) if side > 0 else nextafter(bound, side) - min(bound, 4e-9) / 2
    )


@pytest.mark.parametrize("name", BOUNDS)
def test_a_bound_is_allowed_and_what_is_beyond_it_refused(name):
    make, bound, side, told = BOUNDS[name]
    make(bound)
    with pytest.raises(ValueError, match=told):
        make(beyond(bound, side))


@pytest.mark.parametrize("name", EXCLUDED)
def test_a_bound_that_is_excluded_is_refused_and_what_is_within_allowed(name):
    make, bound, side, told = EXCLUDED[name]
    make(beyond(bound, -side))
    with pytest.raises(ValueError, match=told):
        make(bound)
