"""Whole runs among walls: nothing is received or seen through an opaque one, and watchers notice if it is."""

from itertools import product
from math import inf

import numpy as np
import pytest

from desim import Scenario, run
from desim.kernel.core.events import Broadcast, Lost, Sent
from desim.kernel.walls.wall import Wall
from desim.pursuit.core.events import Sampled
from desim.pursuit.sensing.sensing import Sighting
from desim.pursuit.team.announcements import Assignment
from desim.testing.opacity import OpacityWatcher
from desim.testing.pursuits import watched

CROSS = [Wall(line=[[10.0, 2.0], [10.0, 18.0]]), Wall(line=[[4.0, 10.0], [8.5, 10.0]])]


def among(walls=CROSS, **changes):
    """Return a scenario of six pursuers and an evader in a square among walls."""
    keys = {
        "team.count": 6,
        "team.speeds": 1.5,
        "horizon": 3.0,
        "network.latency": 0.05,
        "record.messages": True,
        "wall": walls,
        "evader.box": [2.0, 18.0],
        "protocol": "local_min",
    }
    return Scenario().with_(keys | {key.replace("__", "."): value for key, value in changes.items()})


def only(walls, *blocks):
    return [wall.model_copy(update={"blocks": blocks}) for wall in walls]


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    "changes",
    [
        {"horizon": 0.6},
        {"network__range": 9.0, "network__range_check": "delivery"},
        {"network__range_check": "both", "network__latency": {"kind": "uniform", "low": 0.0, "high": 0.2}},
        {"network__medium": {"kind": "bitrate", "bitrate": 1e5, "access": {"kind": "csma"}}, "network__range": 30.0},
        {"network__reception": "log_distance", "network__range": 15.0, "network__fading": "message"},
        {"sensing__radius": 6.0},
        {"wall": only(CROSS, "radio", "sight")},
    ],
)
def test_nothing_is_received_or_seen_through_an_opaque_wall(changes):
    scenario, judged = among(**changes), 0
    for seed in (1,):
        watcher = OpacityWatcher(scenario)
        watched(scenario, seed, watcher)
        judged += watcher.judged
    assert judged > 50


@pytest.mark.slow
def test_the_watcher_notices_what_passes_through_a_wall():
    """The control: the events of runs without walls, judged as if there were some."""
    for blocks, why in ((("radio",), "nothing is received through"), (("sight",), "nothing is seen through")):
        scenario = among()
        free = scenario.with_({"wall": only(CROSS, "motion"), "sensing.radius": 15.0})
        result = run(free, 1)
        watcher = OpacityWatcher(scenario.with_({"wall": only(CROSS, *blocks)}))
        with pytest.raises(AssertionError, match=why):
            list(map(watcher, result.trace))


@pytest.mark.parametrize(("x", "is_behind"), [(6.0, True), (2.0, False)])
def test_a_sighting_through_a_wall_is_noticed(x, is_behind):
    """The control: an evader before the wall."""
    scenario = among([Wall(line=[[3.0, -9.0], [3.0, 9.0]], blocks=("sight",))], team__count=1, motion__static=True)
    watcher = OpacityWatcher(scenario)
    watcher(Sampled(0, [[x, 0.0]], [[0.0, 0.0]]))
    body = (Sighting(1, 0.05, x, 0.0, 0.0, 0.0),)
    report = Sent(100_000_000, 0, 0, 0, 200_000_000, 100_000_000, 10, body)
    if is_behind:
        with pytest.raises(AssertionError, match="nothing is seen through a wall: pursuer 0 reports evader 1, seen"):
            watcher(report)
    else:
        watcher(report)
    assert watcher.judged == 1


@pytest.mark.parametrize(
    ("check", "x", "is_lost"),
    [*product(["send", "delivery", "both"], [(6.0, 2.0), (2.0, 6.0), (2.0, 2.0), (6.0, 6.0)], [False, True])],
)
def test_a_reception_through_a_wall_is_noticed_when_the_range_is_checked(check, x, is_lost):
    """A receiver is before the wall or behind it when a message is sent, and when it arrives."""
    wall = Wall(line=[[3.0, -9.0], [3.0, 9.0]], blocks=("radio",))
    scenario = among([wall], team__count=2, motion__static=True, network__range_check=check, network__range=9.0)
    watcher = OpacityWatcher(scenario)
    events = [
        Sampled(0, [[0.0, 5.0]], [[0.0, 0.0], [x[0], 0.0]]),
        Broadcast(10, 0, 0, 0, (1,), (20,), 10, 10, Assignment(0)),
        Sampled(15, [[0.0, 5.0]], [[0.0, 0.0], [x[1], 0.0]]),
        Lost(20, 0, 0, 1, "loss") if is_lost else Sampled(20, [[0.0, 5.0]], [[0.0, 0.0], [x[1], 0.0]]),
        Sampled(21, [[0.0, 5.0]], [[0.0, 0.0], [x[1], 0.0]]),
    ]
    judged = [x[0]] * (check != "delivery") + [x[1]] * (check != "send" and not is_lost)
    if 6.0 in judged:
        with pytest.raises(AssertionError, match="nothing is received through an opaque wall"):
            list(map(watcher, events))
    else:
        list(map(watcher, events))
        assert watcher.judged == len(judged)


@pytest.mark.slow
def test_a_wall_that_only_weakens_radio_may_be_heard_through():
    glass = [wall.model_copy(update={"blocks": ("radio",), "loss": 4.0}) for wall in CROSS]
    scenario = among(glass, network__range=9.0, team__count=16)
    messages = {}
    for name, walls in (("none", []), ("glass", glass), ("opaque", only(CROSS, "radio"))):
        result = run(scenario.with_({"wall": walls, "protocol": "local_min"}), 3)
        messages[name] = sum(len(list(event.fates())) for event in result.trace.of(Broadcast))
    assert messages["none"] > messages["glass"] > messages["opaque"]
    watched(scenario, 3)


# Who sees whom.


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("wall", "seeing"),
    [
        ([], set()),  # sight is perfect, and nothing is reported
        ([[3.0, -1.0], [3.0, 1.0]], {1, 2}),
        ([[3.0, -9.0], [3.0, 9.0]], set()),
        ([[7.0, -9.0], [7.0, 9.0]], {0, 1, 2}),
    ],
)
def test_an_evader_behind_a_wall_is_not_seen(wall, seeing):
    places = [[0.0, 0.0], [0.0, 5.0], [0.0, -6.0]]
    walls = [Wall(line=wall, blocks=("sight",))] if wall else []
    scenario = among(walls, team__count=3, team__positions=places, evader__position=[6.0, 0.0], evader__speed=0.1)
    result = run(scenario.with_({"horizon": 0.15}), 0)
    reports = [event for event in result.trace.of(Sent) + result.trace.of(Broadcast) if isinstance(event.body, tuple)]
    seen = {event.src for event in reports if event.body and all(isinstance(part, Sighting) for part in event.body)}
    assert seen == seeing


@pytest.mark.slow
def test_a_pursuer_that_sees_nothing_does_not_chase_until_it_is_told():
    """Pursuer 0 is behind a wall, and pursuer 1 sees the evader; without its reports, pursuer 0 knows of none."""
    barrier = Wall(line=[[3.0, -20.0], [3.0, 20.0]], blocks=("sight",))
    for reach, chases in ((inf, True), (10.0, False)):
        scenario = among(
            [barrier],
            team__count=2,
            team__positions=[[0.0, 0.0], [0.0, 50.0]],
            team__speeds=5.0,
            evader__position=[6.0, 0.0],
            network__range=reach,
        )
        last = run(scenario, 0).trace.of(Sampled)[-1]
        assert (last.pursuers[0] != (0.0, 0.0)) is chases


@pytest.mark.slow
def test_an_evader_does_not_flee_from_pursuers_that_it_does_not_see():
    """The nearest pursuer is hidden: the evader flees from the other one, towards the wall; without it, away."""
    places, position = [[3.0, 0.0], [-20.0, 0.0]], [0.0, 0.0]
    for walls, towards in (([], -1.0), ([Wall(line=[[2.0, -9.0], [2.0, 9.0]], blocks=("sight",))], 1.0)):
        scenario = among(
            walls, team__count=2, team__positions=places, evader__position=position, horizon=0.5, protocol="local_min"
        )
        last = run(scenario, 0).trace.of(Sampled)[-1]
        assert np.sign(last.evaders[0][0]) == towards


@pytest.mark.slow
def test_noisy_sensors_do_not_measure_through_walls():
    noise = {"kind": "position", "deviation": 0.2}
    walls = [Wall(line=[[3.0, -90.0], [3.0, 90.0]], blocks=("sight",))]
    for chosen, moves in (([], True), (walls, False)):
        scenario = among(
            chosen,
            team__count=2,
            team__positions=[[0.0, 0.0], [0.0, 5.0]],
            team__speeds=5.0,
            evader__position=[6.0, 0.0],
            sensing__noise=noise,
            sensing__estimate="hold",
            protocol="local_min",
        )
        last = run(scenario, 0).trace.of(Sampled)[-1]
        assert (last.pursuers[0] != (0.0, 0.0)) is moves


@pytest.mark.slow
def test_an_omniscient_protocol_sees_through_walls():
    walls = only(CROSS, "sight")
    with_walls, without = (
        run(among(chosen, protocol="centralised"), 1).trace.of(Sampled)[-1] for chosen in (walls, [])
    )

    assert with_walls.pursuers == without.pursuers
