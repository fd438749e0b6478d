"""A mirror of the world shows what the frames of the referee say, and keeps the action of its own pursuer."""

import json

import pytest

from desim.kernel.core.clock import Clock
from desim.live.frames import Mirror, WorldFrame, frame_of
from desim.live.node import _ToldPositions
from desim.simulation.world import initial_state
from tests.live.test_referee import MS, judge, pass_time

WORLDS = {
    "points": {},
    "inertia": {"team": {"count": 2, "speeds": 1.0, "dynamics": {"kind": "turn_rate", "limit": 1.0}}},
    "inertia of the evader": {"evader": {"dynamics": {"kind": "acceleration", "limit": 1.0}}},
    "a flow": {"environment": {"flow": {"kind": "affine", "rotation": 0.1}}},
    "two evaders": {"evader": [{"position": (0.0, 0.0)}, {"position": (5.0, 5.0), "speed": 0.3}]},
    "captured": {
        "team": {"positions": [(0.0, 0.0), (9.0, 9.0)], "count": 2},
        "evader": [{"position": (0.1, 0.0)}, {"position": (5.0, 5.0)}],
    },
    "broken": {"fault": [{"kind": "crash", "start": 0.1, "node": 1}]},
}


def mirror_at(referee, time, pursuer=0):
    """Return a mirror of a world that has only begun, whose clock shows a time, ns."""
    env = Clock()
    state = initial_state(env, referee._scenario, 4)
    env.advance(time, env.event())
    return Mirror(state, pursuer)


def sent(referee):
    """Return the present frame of a referee as it arrives."""
    return WorldFrame(*json.loads(json.dumps(frame_of(referee._state, referee._obeyed))))


@pytest.mark.parametrize("name", WORLDS)
def test_a_mirror_shows_a_frame(name):
    referee, _ = judge(**WORLDS[name])
    pass_time(referee, 300 * MS)
    frame = sent(referee)
    assert (frame.captured != {}) == (name == "captured")
    assert (frame.drifts is not None) == (name == "a flow")
    assert (frame.courses is not None) == name.startswith("inertia")
    mirror = mirror_at(referee, 300 * MS, pursuer=1)
    mirror.follow(frame)
    assert frame_of(mirror.state, frame.obeyed) == frame
    assert mirror.state.at_large == referee._state.at_large


def test_an_older_frame_changes_nothing_and_one_of_the_same_time_does():
    referee, _ = judge()
    pass_time(referee, 300 * MS)
    frame = sent(referee)
    mirror = mirror_at(referee, 300 * MS)
    mirror.follow(frame._replace(profile=[0, 0]))
    mirror.follow(frame._replace(t=frame.t - 1, broken=[1], profile=[1, 1]))
    assert (mirror.state.broken.tolist(), mirror.state.profile) == ([False, False], [0, 0])
    mirror.follow(frame._replace(broken=[1], profile=[0, 1]))
    assert (mirror.state.broken.tolist(), mirror.state.profile) == ([False, True], [0, 1])
    mirror.follow(frame._replace(profile=[0, 1]))
    assert mirror.state.broken.tolist() == [False, False]


@pytest.mark.parametrize(("obeyed", "broken", "acts"), [(1, [], 1), (0, [], 0), (0, [0], 1)])
def test_a_pursuer_keeps_its_action_while_its_order_is_under_way_and_it_is_not_down(obeyed, broken, acts):
    referee, _ = judge()
    pass_time(referee, 300 * MS)
    mirror = mirror_at(referee, 300 * MS)
    mirror.state.set_actions(mirror.state.actions * 0)
    mirror.orders = 1
    mirror.follow(sent(referee)._replace(obeyed=[obeyed, 0], broken=broken, profile=[1, 1]))
    assert mirror.state.profile == [acts, 1]


def test_the_time_of_an_action_is_that_of_its_change():
    referee, _ = judge()
    pass_time(referee, 300 * MS)
    mirror = mirror_at(referee, 300 * MS)
    mirror.state.set_actions(mirror.state.actions * 0)
    mirror.state.acting_since[:] = [7, 8]
    mirror.set_action(1)
    mirror.set_action(1)
    assert list(mirror.state.acting_since) == [300 * MS, 8]


ASKED = {
    "all": lambda positions: positions(),
    "of": lambda positions: positions.of([0, 1]),
    "distance": lambda positions: positions.distance(0, 1),
    "at": lambda positions: positions.at([1], 0),
}


@pytest.mark.parametrize("name", ASKED)
def test_positions_that_are_not_told_are_refused(name):
    referee, _ = judge()
    positions = _ToldPositions(referee._state, 0)
    ASKED[name](positions)
    positions.are_told = False
    with pytest.raises(ValueError, match=r"^pursuer 0: sense was given no teammates, and the network depends on "):
        ASKED[name](positions)
    assert positions.of([0]).tolist() == positions.at([0], 0).tolist()
    assert positions.distance(0, 0) == 0.0
