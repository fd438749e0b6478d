"""Metrics with one evader and with several: by hand, and against brute force on real runs."""

from functools import cache
from itertools import product
from math import inf

import numpy as np
import pytest

from desim.analysis.activity import Released, action, changes, relays
from desim.analysis.hindsight import hindsight, network_regret, settling_window, time_to_relay
from desim.analysis.measuring import summary
from desim.analysis.metrics import active_time, activity, energy, handovers, ping_pongs, plain, potential_gap
from desim.analysis.timeline import timeline
from desim.analysis.trace_index import trace_index
from desim.kernel.core.events import MessageCounts, Trace
from desim.kernel.core.units import SECOND, nanoseconds
from desim.kernel.models.fault_plans import RandomCrashes
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Ended, Sampled, Started
from desim.pursuit.game.game import welfare
from desim.pursuit.motion.capture import capture_time
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Capture, Motion, Scenario
from desim.simulation.run import Result, run
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson

pytestmark = pytest.mark.own_trace


def by_hand(start, *events, end=6.0, captured=False, far=(1.0, 2.0, 4.0)):
    """Return a frozen game of pursuers at (far, 0) with two evaders at the origin and at (0, 3); times in s.

    Capture is at 0.5 m, speeds are 2 m/s and 1 m/s, so that phi is the distance less 0.5.
    """
    trace = Trace()
    places = tuple((each + 0.5, 0.0) for each in far)
    trace.events = [Started(0, ((0.0, 0.0), (0.0, 3.0)), places, (2.0,) * len(far), start)]
    trace.events += [each._replace(t=nanoseconds(each.t)) for each in events]
    trace.events.append(MessageCounts(nanoseconds(end), 0, 0, 0, 0, {}, 0, 0, 0.0))
    trace.events.append(Ended(nanoseconds(end), "captured" if captured else "stopped", 1 if captured else None))
    scenario = Scenario(
        horizon=8.0,
        team=Team(count=len(far)),
        evader=Evader(speed=1.0, count=2),
        capture=Capture(radius=0.5),
        motion=Motion(static=True),
    )
    return Result(scenario, 0, trace)


STORY = by_hand(
    (1, 1, 0),
    Decided(1.0, 1, 2),
    Decided(1.5, 1, 2),
    Captured(2.0, 1, 0),
    Decided(3.0, 0, 2),
    BrokeDown(3.5, 1),
    Decided(4.0, 2, 2),
    Decided(5.0, 0, 0),
    Captured(6.0, 2, 2),
    captured=True,
)
"""Evader 1: 0 and 1 to 1 s, 0 to 2 s. Evader 2: 1 from 1 s on, 0 and 1 from 3 s, 0 from 3.5 s, 0 and 2 from 4 s, 2."""


def test_a_capture_releases_only_the_pursuers_that_chased_the_evader():
    found = changes(STORY)
    assert [(each.t / SECOND, each.pursuer, action(each)) for each in found] == [
        *((1.0, 1, 2), (2.0, 0, 0), (3.0, 0, 2), (3.5, 1, 0), (4.0, 2, 2), (5.0, 0, 0)),
    ]
    assert [type(each) for each in found if action(each) == 0] == [Released, BrokeDown, Decided]


def test_times_per_evader_are_summed_over_the_uncaptured_evaders():
    numbers = summary(STORY)
    assert numbers.active_time == 2.0 + 2.0 + 1.0 + 2 * 0.5 + 0.5 + 2.0 + 1.0
    assert activity(STORY)[1].tolist() == [2, 2, 1, 2, 1, 2, 1]
    assert numbers.idle_time == 1.0  # evader 2 in the first second; evader 1 needs no pursuer after 2 s
    assert numbers.crowded_time == numbers.excess_time == 1.0 + 0.5 + 1.0
    assert numbers.active_time - numbers.excess_time + numbers.idle_time == 2.0 + 6.0
    assert numbers.switches == 4
    assert energy(STORY) == 4.0 * numbers.active_time


def test_the_summary_lists_capturer_and_time_per_evader_if_there_are_several():
    numbers = summary(STORY)
    assert (numbers.captured, numbers.capture_time, numbers.capturer) == (True, 6.0, 1)
    assert (numbers.captures, numbers.mean_capture_time) == (2, 4.0)
    assert (numbers.capture_times, numbers.capturers) == ({"1": 2.0, "2": 6.0}, {"1": 0, "2": 2})
    nobody = summary(by_hand((0, 0, 0)))
    assert (nobody.captured, nobody.captures, nobody.mean_capture_time, nobody.capturers) == (False, 0, None, {})
    assert plain(nobody)["mean_capture_time"] is None


def test_a_handover_is_between_two_pursuers_on_the_same_evader():
    """On evader 1 only 0 is ever alone, 1 leaves it for evader 2; there 1, 0 and 2 are, one after the other."""
    assert relays(STORY) == [(SECOND, 0)]
    assert relays(STORY, 2) == [(SECOND, 1), (7 * SECOND // 2, 0), (5 * SECOND, 2)]
    assert handovers(STORY) == 2
    swap = [Decided(1.0, 0, 2), Decided(1.0, 1, 1), Decided(1.5, 0, 1), Decided(1.5, 1, 2)]
    assert (handovers(by_hand((1, 2, 0), *swap)), ping_pongs(by_hand((1, 2, 0), *swap), within=1.0)) == (4, 2)


def test_two_evaders_that_want_the_same_pursuer_are_judged_by_the_best_assignment():
    """phi = (1, 2, 4) on evader 1 and sqrt(9 + (phi_1 + 0.5)^2) - 0.5 on evader 2; both are nearest to pursuer 0.

    1 + 3.40 > 2 + 2.85: the best profile sends 0 to evader 1 and 1 to evader 2.
    """
    other = [np.hypot(3.0, far + 0.5) - 0.5 for far in (1.0, 2.0, 4.0)]
    most = 16.0 - (1.0 + other[1])
    assert most > 16.0 - (2.0 + other[0])
    for start, worth in (
        ((1, 2, 0), most),
        ((2, 1, 0), 16.0 - (2.0 + other[0])),
        ((1, 0, 0), 7.0),
        ((1, 2, 2), 15.0 - (other[1] + other[2]) / 2),
        ((0, 0, 0), 0.0),
    ):
        found = hindsight(by_hand(start))
        assert found.gap == pytest.approx([most - worth], abs=1e-12)
        assert found.relayed.tolist() == [start == (1, 2, 0)]


def test_an_evader_captured_without_a_chaser_no_longer_counts_as_unchased():
    """Pursuer 0 would be best on evader 1 to 2 s, 1 on evader 2; from then on 0 is, on evader 2."""
    other = [np.hypot(3.0, far + 0.5) - 0.5 for far in (1.0, 2.0)]
    found = hindsight(by_hand((0, 0, 0), Captured(2.0, 1, 1)))
    assert (found.times / SECOND).tolist() == [0.0, 2.0, 6.0]
    assert found.gap == pytest.approx([16.0 - (1.0 + other[1]), 8.0 - other[0]], abs=1e-12)


def test_regret_is_against_the_best_of_all_evaders():
    """Alone on evader 2, 1 gets 8 - phi_2; on evader 1 it would get 6. 0, which stays, would get 7 on evader 1."""
    other = [np.hypot(3.0, far + 0.5) - 0.5 for far in (1.0, 2.0, 4.0)]
    found = hindsight(by_hand((0, 2, 0), end=2.0)).regret
    assert found == pytest.approx([2 * 7.0, 2 * (6.0 - (8.0 - other[1])), 2 * 4.0], abs=1e-12)


# Against brute force.

BASE = {
    "team": Team(count=4, box=(6.0, 14.0), speeds=(1.0, 2.2, 3.0, 0.6), active_at_start=0.6),
    "protocol": SpatialAdaptivePlay(schedule=Poisson(rate=3.0)),
    "network": Links(latency=Constant(value=0.1), loss=Bernoulli(p=0.3)),
    "record": {"trajectory": 0.1},
}
EVADERS = (Evader(speed=0.9), Evader(speed=0.5, box=(5.0, 15.0)), Evader(speed=1.1, box=(5.0, 15.0)))
CASES = {
    "pursuit": {"horizon": 3.0},
    "crashes": {"horizon": 3.0, "fault": (RandomCrashes(rate=0.5, mean_downtime=0.5),)},
    "frozen": {"motion": Motion(static=True), "horizon": 2.0},
    "short": {"motion": Motion(static=True), "horizon": 1.0},
    "late": {"horizon": 1.5},
    "equals": {"horizon": 3.0, "team": Team(count=4, box=(6.0, 14.0), speeds=1.5, active_at_start=0.5)},
}
ALL = [(case, evaders) for case in CASES for evaders in (1, 2, 3)]


@cache
def negotiated(case, evaders, seed):
    """Return a run of four pursuers, one of which is too slow for two of the evaders, and which often clash."""
    return run(Scenario(**BASE | CASES[case] | {"evader": EVADERS[:evaders]}), seed)


def replayed(result):
    """Return (begin, until (ns), actions, evaders at large, (N, M) times of capture, time left) piece by piece.

    A piece ends where something changes, or positions are sampled; phi is that of its middle.
    """
    (start,), (end,), scenario = result.trace.of(Started), result.trace.of(Ended), result.scenario
    known = [start] if scenario.motion.static else [start, *result.trace.of(Sampled)]
    when = [each.t for each in known]
    actions, large, broken = list(start.active), set(range(1, len(start.evaders) + 1)), [0] * len(start.active)
    pieces, since = [], 0

    def where(of, middle):
        return [np.interp(middle, when, [of(each)[axis] for each in known]) for axis in (0, 1)]

    def close(until):
        """End a piece; positions stay after the last sample."""
        middle = (since + until) / 2
        places = [where(lambda each, i=i: each.pursuers[i], middle) for i in range(len(actions))]
        phi = np.full((len(actions), len(start.evaders)), inf)
        for j in large:
            evader, speed = where(lambda each, j=j: each.evaders[j - 1], middle), EVADERS[j - 1].speed
            phi[:, j - 1] = capture_time(evader, places, start.speeds, speed, scenario.capture.radius)
        phi[np.array(broken) > 0] = inf
        left = scenario.horizon - (0.0 if scenario.motion.static else middle / SECOND)
        pieces.append((since, until, tuple(map(int, actions)), set(large), phi, left))

    for event in result.trace:
        crash = isinstance(event, FaultStarted | FaultEnded) and isinstance(event.fault, Crash)
        act = isinstance(event, Decided) and event.active  # 0 for all else
        moved = isinstance(event, Decided | BrokeDown) and act != actions[event.pursuer]
        if event.t > since and (crash or moved or isinstance(event, Captured | Sampled | Ended)):
            close(event.t)
            since = event.t
        if moved:
            actions[event.pursuer] = act
        elif isinstance(event, Captured):
            large.remove(event.evader)
            actions[:] = [0 if each == event.evader else each for each in actions]
        elif crash:
            broken[event.fault.node] += 1 if isinstance(event, FaultStarted) else -1
    assert since == end.t
    return pieces


def best(phi, left):
    """Return the greatest worth of all ways to send different pursuers, or none, to the evaders."""
    size, evaders = phi.shape
    worths = [[0.0, *(max(left - t, 0.0) for t in phi[:, j])] for j in range(evaders)]
    return max(
        sum(worths[j][i] for j, i in enumerate(chosen))
        for chosen in product(range(size + 1), repeat=evaders)
        if all(not i or chosen.count(i) == 1 for i in chosen)
    )


def is_best(actions, phi, left):
    """Return whether at most one pursuer chases each evader, none in vain, and no other profile is worth more."""
    chased = [(i, j) for i, j in enumerate(actions) if j]
    matched = len({j for _, j in chased}) == len(chased)
    in_time = all(phi[i, j - 1] < left for i, j in chased)
    return matched and in_time and sum(left - phi[i, j - 1] for i, j in chased) > best(phi, left) - 1e-9


def judged(result, window):
    """Return the numbers of a run from its pieces."""
    pieces, (start,) = replayed(result), result.trace.of(Started)
    size, evaders = len(start.active), len(start.evaders)
    found = dict.fromkeys(("active", "idle", "crowded", "excess", "energy", "misassigned", "gap"), 0.0)
    worth, got, right = np.zeros((size, evaders + 1)), np.zeros(size), []
    chains = {j: [] for j in range(1, evaders + 1)}
    for begin, until, actions, large, phi, left in pieces:
        d = (until - begin) / SECOND
        numbers = [actions.count(j) for j in large]
        found["active"] += d * sum(each > 0 for each in actions)
        found["idle"] += d * sum(n == 0 for n in numbers)
        found["crowded"] += d * sum(n > 1 for n in numbers)
        found["excess"] += d * sum(n - 1 for n in numbers if n > 1)
        found["energy"] += d * sum(v * v for v, each in zip(start.speeds, actions, strict=True) if each)
        reached = welfare(phi, actions, left)
        found["gap"] += d * (best(phi, left) - reached)
        right.append(is_best(actions, phi, left))
        found["misassigned"] += d * (not right[-1])
        for i in range(size):
            alone = welfare(phi, [*actions[:i], 0, *actions[i + 1 :]], left)
            got[i] += d * (reached - alone)
            for j in range(1, evaders + 1):
                worth[i, j] += d * (welfare(phi, [*actions[:i], j, *actions[i + 1 :]], left) - alone)
        for j, chain in chains.items():
            if actions.count(j) == 1 and actions.index(j) not in [each[1] for each in chain[-1:]]:
                chain.append((begin, actions.index(j)))
    end, settled = pieces[-1][1], None
    for (begin, *_), k in zip(pieces, range(len(pieces)), strict=True):
        until = next((piece[0] for piece, fine in zip(pieces[k:], right[k:], strict=True) if not fine), end)
        if settled is None and right[k] and (until == end or until - begin >= window * SECOND):
            settled = begin / SECOND
    found["regret"] = float((worth.max(axis=1) - got).mean()) / (end / SECOND)
    found["handovers"] = sum(max(len(chain) - 1, 0) for chain in chains.values())
    return found | {"settled": settled, "chains": list(chains.values())}


def decided_switches(result):
    actions, count = list(result.trace.of(Started)[0].active), 0
    for event in result.trace:
        if isinstance(event, Captured):
            actions = [0 if each == event.evader else each for each in actions]
        elif isinstance(event, Decided | BrokeDown):
            new = event.active if isinstance(event, Decided) else 0
            count += isinstance(event, Decided) and new != actions[event.pursuer]
            actions[event.pursuer] = new
    return count


@pytest.mark.whole_but_one
@pytest.mark.slow_but_one
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("case", "evaders"), ALL)
def test_all_numbers_are_what_brute_force_finds(case, evaders, seed):
    result = trace_index(negotiated(case, evaders, seed))
    numbers = summary(result)
    expected = judged(result, settling_window(result))
    found = {
        "active": numbers.active_time,
        "idle": numbers.idle_time,
        "crowded": numbers.crowded_time,
        "excess": numbers.excess_time,
        "energy": numbers.energy,
        "misassigned": numbers.misassigned_time,
        "gap": numbers.potential_gap,
        "regret": numbers.regret,
        "handovers": numbers.handovers,
    }
    assert found == pytest.approx({name: expected[name] for name in found}, abs=1e-9)
    assert [relays(result, j + 1) for j in range(evaders)] == expected["chains"]
    assert numbers.switches == decided_switches(result)
    for window in (None, 0.1, 1.0):
        until = settling_window(result) if window is None else window
        assert time_to_relay(result, window) == pytest.approx(judged(result, until)["settled"], abs=1e-12)


@pytest.mark.slow
def test_brute_force_has_something_to_find():
    """With several evaders there are captures, releases, clashes, crowds, idle evaders, and changes of evader."""
    runs = [negotiated(case, evaders, seed) for case, evaders in ALL if evaders > 1 for seed in (0, 1)]
    assert sum(len(result.trace.of(Captured)) for result in runs) > 4
    every = [each for result in runs for each in changes(result)]
    assert {type(each) for each in every} == {Decided, BrokeDown, Released}
    settled = [time_to_relay(negotiated(case, 1, seed)) for case in CASES for seed in (0, 1)]
    assert None in settled
    assert sum(each is not None and each > 0.0 for each in settled) > 2
    pieces = [piece for result in runs for piece in replayed(result)]
    nearest = [set(phi[:, [j - 1 for j in large]].argmin(axis=0)) for *_, large, phi, _ in pieces]
    clashes = sum(len(who) < len(large) for who, (_, _, _, large, _, _) in zip(nearest, pieces, strict=True))
    assert 0.2 < clashes / len(pieces) < 0.8
    numbers = [summary(result) for result in runs]
    for name in ("idle_time", "crowded_time", "excess_time", "misassigned_time", "potential_gap", "handovers"):
        assert sum(getattr(each, name) > 0 for each in numbers) > 4


def test_the_timeline_of_each_evader_has_the_same_pieces_and_its_own_chasers():
    result = negotiated("pursuit", 3, 0)
    parts = [part for evader in (1, 2, 3) for part in timeline(result, evader)]
    assert all(part.times.tolist() == parts[0].times.tolist() for part in parts)
    assert (sum(part.active.astype(int) for part in parts) <= 1).all()
    assert sum(part.durations @ part.active.sum(axis=1) for part in parts) == pytest.approx(active_time(result))
    for capture in result.trace.of(Captured):
        mine = parts[capture.evader - 1]
        assert (np.isinf(mine.phi).all(axis=1) == (mine.times[:-1] >= capture.t)).all()


@pytest.mark.slow
def test_the_regret_of_a_network_can_be_had_with_several_evaders():
    ideal = run(Scenario(**BASE | CASES["crashes"] | {"evader": EVADERS, "network": Links(), "fault": ()}), 1)
    result = negotiated("crashes", 3, 1)
    assert network_regret(result) == potential_gap(result) - potential_gap(ideal) != 0.0
