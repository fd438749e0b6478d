"""Faults: what they do to a network, the order in which they open and close, and what random plans draw."""

from collections import Counter
from functools import partial
from itertools import pairwise
from math import exp, inf

import networkx as nx
import numpy as np
import pytest

from desim import Scenario, run
from desim.config.errors import KeyedError
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Trace
from desim.kernel.core.seeds import stream
from desim.kernel.core.units import SECOND
from desim.kernel.fault_injection import inject
from desim.kernel.models.access import Aloha, Csma, CsmaCa
from desim.kernel.models.clock_skew import MIN_DRIFT, ClockSkew, clock_errors
from desim.kernel.models.fault_plans import RandomCrashes, RandomFaults, draw_faults
from desim.kernel.models.faults import Crash, Jamming, MessageFault, Partition
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.network import Network
from desim.kernel.state.fault_state import FaultState
from desim.scenario.players import Team

PERIOD = SECOND // 10


def receptions(size, *faults, positions=None, until=1.0):
    """Return the tenths of a second at which a message of src reaches dst, by (src, dst); every node sends at each
    tenth.
    """
    clock, trace = Clock(), Trace()
    at = None if positions is None else lambda: positions(clock.now / SECOND)
    network = Network(clock, nx.complete_graph(size), trace=trace, positions=at, fault_state=FaultState(at))
    inject(faults, clock, network, trace)
    heard = {(src, dst): set() for src in range(size) for dst in range(size) if src != dst}

    def transmit(tenth):
        for node in range(size):
            network.send(node, None, tenth)

    def receive(tenth):
        for node in range(size):
            for message in network.inbox(node).drain():
                heard[message.src, node].add(message.body)

    for tenth in range(round(10 * until)):
        Instant(clock, tenth * PERIOD, Phase.DECISION).callbacks.append(lambda _, k=tenth: transmit(k))
        Instant(clock, tenth * PERIOD, Phase.SAMPLE).callbacks.append(lambda _, k=tenth: receive(k))
    clock.run()
    trace.append(network.message_counts())
    return heard


def tenths(start, stop):
    return set(range(start, stop))


ALWAYS = tenths(0, 10)


def test_a_node_whose_radio_is_down_neither_sends_nor_receives():
    """Node 1 of three is down from 0.3 s until 0.6 s, at which it is up."""
    up = ALWAYS - tenths(3, 6)
    assert receptions(3, Crash(node=1, start=0.3, end=0.6)) == {
        (0, 1): up,
        (1, 0): up,
        (1, 2): up,
        (2, 1): up,
        (0, 2): ALWAYS,
        (2, 0): ALWAYS,
    }


@pytest.mark.parametrize(
    ("second", "down"),
    [((0.4, 0.8), (2, 8)), ((0.3, 0.5), (2, 6)), ((0.6, 0.8), (2, 8)), ((0.2, 0.6), (2, 6)), ((0.1, 0.9), (1, 9))],
)
def test_a_node_is_up_when_all_its_crashes_are_over(second, down):
    """One from 0.2 s until 0.6 s, and one that overlaps, lies within, follows, is the same, or contains it."""
    crashes = [Crash(node=0, start=at, end=until) for at, until in ((0.2, 0.6), second)]
    for order in (crashes, crashes[::-1]):
        assert receptions(2, *order)[0, 1] == ALWAYS - tenths(*down)


@pytest.mark.parametrize("scope", ["radio", "robot"])
def test_to_the_network_every_crash_is_one_of_the_radio(scope):
    assert receptions(2, Crash(node=0, start=0.5, scope=scope))[0, 1] == tenths(0, 5)


@pytest.mark.parametrize("memory", [True, False])
def test_a_node_recovers_with_or_without_its_memory(memory):
    """Node 1 knew of 0 and 2 and had mail on two ports; node 2 forgets nothing; what comes later is kept."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), fault_state=FaultState())
    network.set_initial_belief(2, "presumed")
    network.publish(0, "told")
    for port in ("", "other"):
        network.send(0, None, "mail", port=port)
    inject([Crash(node=1, start=1.0, end=2.0, memory=memory)], clock, network)
    Instant(clock, 3 * SECOND, Phase.DECISION).callbacks.append(lambda _: network.publish(2, "later"))
    for until, known in ((2 * SECOND, True), (2 * SECOND + 1, memory)):
        clock.run(until=until)
        assert sorted(network.latest_records(1)) == ([0, 2] if known else [])
    assert [len(network.inbox(1, port).drain()) for port in ("", "other")] == ([1, 1] if memory else [0, 0])
    assert sorted(network.latest_records(2)) == [0]
    assert len(network.inbox(2).drain()) == 1
    clock.run()
    assert network.latest_records(1)[2][1].body == "later"


def test_a_node_that_lost_its_memory_accepts_known_records_again():
    """A record that is older than what was forgotten is news: it is the newest that is known."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(2), fault_state=FaultState())
    old, new = network.next_record(0, "old"), network.next_record(0, "new")
    network.insert(1, new)
    network.crash(1)
    network.recover(1, memory=False)
    network.insert(1, old)
    assert network.latest_records(1)[0][1] == old


@pytest.mark.parametrize(
    ("groups", "together"),
    [
        ([(0, 1), (2, 3, 4)], [(0, 1), (2, 3, 4)]),
        ([(0, 1)], [(0, 1), (2, 3, 4)]),
        ([(0,), (1,)], [(2, 3, 4)]),
        ([(), (0, 1, 2)], [(0, 1, 2), (3, 4)]),
        ([(0, 1, 2, 3, 4)], [(0, 1, 2, 3, 4)]),
    ],
)
def test_a_partition_separates_its_groups_and_all_others_form_one_more(groups, together):
    found = receptions(5, Partition(groups=groups, start=0.0))
    pairs = {(src, dst) for group in together for src in group for dst in group if src != dst}
    assert {pair for pair, when in found.items() if when} == pairs


def test_overlapping_partitions_separate_the_nodes_that_either_separates():
    """{0 1 | 2 3} from 0.2 s until 0.6 s, {0 2 | 1 3} from 0.4 s until 0.8 s; 0 and 3 are separated by both."""
    heard = receptions(
        4, Partition(groups=[(0, 1)], start=0.2, end=0.6), Partition(groups=[(0, 2)], start=0.4, end=0.8)
    )
    assert heard[0, 1] == heard[3, 2] == ALWAYS - tenths(4, 8)
    assert heard[0, 2] == heard[3, 1] == ALWAYS - tenths(2, 6)
    assert heard[0, 3] == heard[2, 1] == ALWAYS - tenths(2, 8)


@pytest.mark.parametrize("inner", [(0.4, 0.6), (0.4, 0.8), (0.2, 0.6)])
def test_a_partition_within_an_equal_one_heals_only_itself(inner):
    outer = Partition(groups=[(0,)], start=0.2, end=0.8)
    heard = receptions(2, outer, Partition(groups=[(0,)], start=inner[0], end=inner[1]))
    assert heard[0, 1] == ALWAYS - tenths(2, 8)


def in_a_row(*xs):
    return lambda time: np.array([[x, 0.0] for x in xs])


def test_a_node_inside_a_jamming_disc_can_send_but_not_receive():
    """Nodes at x = 0, 1, 5 m; a disc of 1 m around the first from 0.3 s until 0.6 s, and its rim belongs to it."""
    jam = Jamming(centre=(0.0, 0.0), radius=1.0, start=0.3, end=0.6)
    heard = receptions(3, jam, positions=in_a_row(0.0, 1.0, 5.0))
    jammed = ALWAYS - tenths(3, 6)
    assert heard == {(0, 1): jammed, (1, 0): jammed, (2, 0): jammed, (2, 1): jammed, (0, 2): ALWAYS, (1, 2): ALWAYS}


def test_jamming_discs_end_one_by_one_and_each_affects_only_the_nodes_inside():
    """Nodes at x = 0, 5, 9 m; two discs around the first that overlap in time, and one around the last."""
    discs = [(0.0, 0.1, 0.7), (0.0, 0.3, 0.5), (9.0, 0.3, inf)]
    jams = [Jamming(centre=(x, 0.0), radius=1.0, start=at, end=until) for x, at, until in discs]
    heard = receptions(3, *jams, positions=in_a_row(0.0, 5.0, 9.0))
    assert heard[0, 1] == heard[2, 1] == ALWAYS
    assert heard[1, 0] == heard[2, 0] == ALWAYS - tenths(1, 7)
    assert heard[0, 2] == heard[1, 2] == tenths(0, 3)


def test_a_moving_node_receives_nothing_while_inside_a_jamming_disc():
    """Node 0 moves along x at 10 m/s: after k tenths of a second it is at k m; the disc covers 3 m to 5 m."""
    heard = receptions(
        2,
        Jamming(centre=(4.0, 0.0), radius=1.0 + 1e-9, start=0.0),
        positions=lambda time: np.array([[10.0 * time, 0.0], [99.0, 0.0]]),
    )
    assert heard == {(1, 0): ALWAYS - {3, 4, 5}, (0, 1): ALWAYS}


def test_faults_are_recorded_at_start_and_end_and_hooks_are_called_on_crashes():
    clock, trace, calls = Clock(), Trace(), []
    network = Network(clock, nx.complete_graph(3), fault_state=FaultState())
    crash = Crash(node=1, start=0.2, end=0.5)
    cut = Partition(groups=[(0,)], start=0.1, end=0.2)
    inject(
        [crash, cut, Crash(node=2, start=0.3)],
        clock,
        network,
        trace,
        crashed=lambda fault: calls.append((clock.now, "crashed", fault.node, network.fault_state.down(fault.node))),
        recovered=lambda fault: calls.append(
            (clock.now, "recovered", fault.node, network.fault_state.down(fault.node))
        ),
    )
    clock.run()
    tenth = SECOND // 10
    assert [(type(event), event.t // tenth, type(event.fault)) for event in trace] == [
        (FaultStarted, 1, Partition),
        (FaultStarted, 2, Crash),
        (FaultEnded, 2, Partition),
        (FaultStarted, 3, Crash),
        (FaultEnded, 5, Crash),
    ]
    assert calls == [
        (2 * tenth, "crashed", 1, True),
        (3 * tenth, "crashed", 2, True),
        (5 * tenth, "recovered", 1, False),
    ]


def test_a_fault_too_short_for_the_clock_begins_and_is_over_at_one_instant():
    clock, trace = Clock(), Trace()
    network = Network(clock, nx.complete_graph(2), fault_state=FaultState())
    inject([Crash(node=0, start=0.1, end=0.1 + 1e-12)], clock, network, trace)
    clock.run()
    assert [type(event) for event in trace] == [FaultStarted, FaultEnded]
    assert not network.fault_state.down(0)


def downtimes(crashes, horizon):
    """Return the number of crashes and the time down before the horizon of each node, as arrays."""
    number, down = Counter(), Counter()
    for crash in crashes:
        number[crash.node] += 1
        down[crash.node] += min(crash.end, horizon) - crash.start
    nodes = range(max(number) + 1)
    return np.array([number[node] for node in nodes]), np.array([down[node] for node in nodes])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_random_crashes_follow_the_alternating_renewal_process(seed):
    """The chance to be down at t is p(t) = q (1 - exp(-k t)), q = a m / (1 + a m), k = a + 1 / m, and crashes come at
    the rate a (1 - p(t)); both integrated over [0, T], with a = 0.3 1/s, m = 2 s, T = 40 s and 1000 nodes.
    Within 5 standard errors; without regard to downtime (a T crashes, a m T down) it would be far off."""
    rate, mean, horizon, nodes = 0.3, 2.0, 40.0, 1000
    plan = RandomCrashes(rate=rate, mean_downtime=mean)
    number, down = downtimes(draw_faults([plan], nodes, horizon, seed), horizon)
    share, speed = rate * mean / (1 + rate * mean), rate + 1 / mean
    time_down = share * (horizon - (1 - exp(-speed * horizon)) / speed)

    def error(sample, expected):
        return abs(sample.mean() - expected) / (sample.std(ddof=1) / np.sqrt(len(sample)))

    assert error(down, time_down) < 5
    assert error(number, rate * (horizon - time_down)) < 5
    assert error(down, rate * mean * horizon) > 25
    assert error(number, rate * horizon) > 25


@pytest.mark.whole
def test_the_share_of_downtime_in_the_long_run_is_rate_times_downtime_over_one_plus_it():
    """0.5 1/s and 1 s make 1/3; 50 nodes over 1000 s, within 5 standard errors and far from 1/2."""
    horizon = 1000.0
    _, down = downtimes(draw_faults([RandomCrashes(rate=0.5, mean_downtime=1.0)], 50, horizon, 0), horizon)
    share, error = down.mean() / horizon, down.std(ddof=1) / horizon / np.sqrt(50)
    assert abs(share - 1 / 3) < 5 * error < 0.03


@pytest.mark.slow
def test_random_crashes_of_a_node_do_not_overlap_and_begin_before_the_horizon():
    plan = RandomCrashes(rate=5.0, mean_downtime=0.1, scope="radio", memory=False)
    for crashes in [[c for c in draw_faults([plan], 4, 20.0, 7) if c.node == node] for node in range(4)]:
        assert len(crashes) > 20
        assert all(before.end < after.start for before, after in pairwise(crashes))
        assert all(crash.start < 20.0 and crash.scope == "radio" and not crash.memory for crash in crashes)


def test_the_crashes_of_a_node_depend_neither_on_how_many_there_are_nor_on_the_horizon():
    plan = RandomCrashes(rate=1.0)
    many = draw_faults([plan], 5, 50.0, 3)
    assert draw_faults([plan], 2, 50.0, 3) == [crash for crash in many if crash.node < 2]
    assert draw_faults([plan], 5, 10.0, 3) == [crash for crash in many if crash.start < 10.0]


KINDS = ("crash", "partition", "jamming")


@pytest.mark.parametrize("until", [inf, 8.0])
@pytest.mark.parametrize("kinds", [KINDS, ("crash",), ("partition", "jamming")])
def test_a_random_plan_keeps_to_its_kinds_its_box_and_its_end(kinds, until):
    plan = RandomFaults(rate=20.0, mean_duration=2.0, end=until, kinds=kinds, box=(-3.0, 7.0))
    faults = draw_faults([plan], 5, 10.0, 11)
    assert {fault.kind for fault in faults} == set(kinds)
    assert [fault.start for fault in faults] == sorted(fault.start for fault in faults)
    assert all(fault.start < fault.end <= until and fault.start < 10.0 for fault in faults)
    assert max(fault.start for fault in faults) > min(until, 10.0) - 1.0
    for fault in faults:
        if fault.kind == "crash":
            assert 0 <= fault.node < 5
        elif fault.kind == "partition":
            assert 1 <= len(fault.groups[0]) < 5
        else:
            assert all(-3.0 <= x <= 7.0 for x in fault.centre)
            assert 1.0 <= fault.radius <= 5.0


@pytest.mark.parametrize(("box", "width"), [((0.0, 0.02), 0.02), ((-3.0, 7.0), 10.0), ((4.0, 4.0), 1.0)])
def test_discs_of_a_random_plan_are_in_proportion_to_its_box(box, width):
    """Also on a table: only where the box is a point, a disc has a size of its own."""
    discs = draw_faults([RandomFaults(rate=20.0, kinds=("jamming",), box=box)], 5, 10.0, 11)
    assert 0.1 * width <= min(disc.radius for disc in discs) < 0.15 * width
    assert 0.45 * width < max(disc.radius for disc in discs) <= 0.5 * width


@pytest.mark.slow
def test_a_random_plan_has_faults_at_its_rate():
    """20 1/s over 100 s are 2000 faults with a standard deviation of 45; and a mean duration of 0.5 s.

    The controls are a rate and a duration that are a fifth greater.
    """
    faults = draw_faults([RandomFaults(rate=20.0, mean_duration=0.5)], 5, 100.0, 2)
    durations = np.array([fault.end - fault.start for fault in faults])
    assert abs(len(faults) - 2000) < 5 * 45 < abs(len(faults) - 2400)
    error = 0.5 / np.sqrt(len(faults))
    assert abs(durations.mean() - 0.5) < 5 * error < abs(durations.mean() - 0.6)


@pytest.mark.parametrize("plan", [RandomFaults(rate=5.0), RandomCrashes(rate=1.0)])
def test_equal_seeds_draw_equal_plans_and_others_do_not(plan):
    assert draw_faults([plan], 4, 10.0, 5) == draw_faults([plan], 4, 10.0, 5)
    assert draw_faults([plan], 4, 10.0, 5) != draw_faults([plan], 4, 10.0, 6)


def test_random_faults_do_not_depend_on_other_plans_or_given_faults():
    first, second, given = RandomFaults(rate=5.0), RandomCrashes(rate=1.0), Crash(node=0, start=1.0)
    alone = draw_faults([first], 4, 10.0, 5)
    assert draw_faults([given, first], 4, 10.0, 5) == [given, *alone]
    assert draw_faults([first, second], 4, 10.0, 5)[: len(alone)] == alone
    assert draw_faults([first, first], 4, 10.0, 5)[len(alone) :] != alone
    assert draw_faults([first], 4, 10.0, 5) == list(first(4, 10.0, stream(5, "faults", 0)))


@pytest.mark.parametrize("size", [1, 2])
def test_a_random_plan_is_possible_among_few(size):
    clock = Clock()
    network = Network(clock, nx.complete_graph(size), fault_state=FaultState(lambda: np.zeros((size, 2))))
    inject(draw_faults([RandomFaults(rate=20.0)], size, 5.0, 0), clock, network)
    clock.run()
    nodes = np.arange(size)
    assert not any(network.fault_state.down(node) for node in range(size))
    assert network.fault_state.jammed(nodes, clock.now) is None
    assert network.fault_state.separated(0, nodes) is None


@pytest.mark.parametrize(
    ("model", "fields", "about"),
    [
        (Crash, {"node": 0, "start": 1.0, "end": 1.0}, "end"),
        (Crash, {"node": 0, "start": 1.0, "end": 0.5}, "end"),
        (Partition, {"groups": [(0, 1), (1, 2)], "start": 0.0}, "disjoint"),
        (Partition, {"groups": [(0, 0)], "start": 0.0}, "disjoint"),
        (Partition, {"groups": [], "start": 0.0}, "groups"),
        (RandomFaults, {"kinds": ()}, "kinds"),
        (RandomFaults, {"box": (1.0, 0.0)}, "box"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(model, fields, about):
    with pytest.raises(KeyedError, match=about):
        model(**fields)


@pytest.mark.parametrize(
    ("fault", "fault_state", "why"),
    [
        (Crash(node=3, start=0.0), FaultState(), r"there is no node 3: the nodes are 0 \.\. 2"),
        (Partition(groups=[(0,), (1, 3)], start=0.0), FaultState(), r"there is no node 3: the nodes are 0 \.\. 2"),
        (Jamming(centre=(0.0, 0.0), radius=1.0, start=1.0), FaultState(), "positions"),
        (Crash(node=0, start=1.0), None, "fault_state"),
    ],
)
def test_a_fault_that_does_not_fit_the_network_is_refused(fault, fault_state, why):
    clock = Clock()

    def go():
        inject([fault], clock, Network(clock, nx.complete_graph(3), fault_state=fault_state))
        clock.run()

    with pytest.raises(ValueError, match=why):
        go()


def test_a_node_that_is_not_down_cannot_be_repaired():
    fault_state = FaultState()
    fault_state.crash(0)
    fault_state.recover(0)
    with pytest.raises(ValueError, match="node 0 is not down"):
        fault_state.recover(0)


def test_the_last_crash_that_has_not_ended_is_the_cause_of_losses():
    state = FaultState()
    battery, _, last = (state.crash(0, cause) for cause in ("battery", "emp", "battery"))
    state.recover(0, last)
    assert state.down_cause(0) == "emp"
    state.recover(0)
    assert state.down_cause(0) == "battery"
    state.recover(0, battery)
    assert state.down_cause(0) is None
    assert not state.down(0)


def test_the_first_jam_that_has_not_ended_is_the_cause_of_losses():
    state, disc = FaultState(lambda: np.zeros((1, 2))), ((0.0, 0.0), 1.0)
    ends = [state.jam(disc, cause) for cause in ("storm", "sparks", "storm")]
    ends[2]()
    assert state.jammed([0], 0) == ["storm"]
    ends[0]()
    assert state.jammed([0], 0) == ["sparks"]


def test_the_first_cut_that_has_not_ended_is_the_cause_of_losses():
    state = FaultState()
    ends = [state.partition([[0]], "flood"), state.block(lambda src, dst: dst > 0, "fog"), state.partition([[0]])]
    assert state.separated(0, [1, 2]) == ["flood", "flood"]
    ends[0]()
    assert state.separated(np.array([1, 1]), [0, 2]) == ["partition", "fog"]
    ends[1]()
    assert state.separated(1, [0, 2]) == ["partition", None]
    ends[2]()
    assert state.separated(1, [0]) is None


def test_the_delays_of_several_interceptions_add_up_and_one_may_end_itself():
    state = FaultState()
    ends = [state.intercept(lambda *_: ends[0]() or {1: 0.5}, "crowd")]
    ends += [state.intercept(lambda *_: {1: 0.25, 2: inf}, "thief"), state.intercept(lambda *_: {2: 0.5}, "slow")]
    for number, late in ((1, 750_000_000), (2, 250_000_000)):
        state.note_sent(number, 0, [1, 2, 3], "x")
        assert state.delayed(number, [1, 2, 3], 100) == [100 + late, 100, 100]
        assert state.intercepted(number) == {2: "thief"}


def test_a_change_that_is_due_at_the_time_of_an_arrival_comes_before_it():
    state = FaultState()
    state.plan(5)
    assert [state.changes_by(time) for time in (4, 5, 6)] == [False, True, True]


def test_a_function_is_a_plan():
    """It is called once with the team's size, the horizon and a stream of its own, and what it answers happens."""
    asked = []

    def plan(size, horizon, rng):
        asked.append((size, horizon, rng.random()))
        return [Crash(node=2, start=1.0, end=1.5), Partition(start=0.5, groups=((0,),))]

    scenario = Scenario(horizon=2.0, team=Team(count=4), fault=(Crash(node=0, start=0.2), plan, RandomCrashes(), plan))
    result = run(scenario, 6)
    assert asked == [(4, 2.0, stream(6, "faults", k).random()) for k in (0, 2)]
    began = Counter((began.t / SECOND, began.fault.kind) for began in result.trace.of(FaultStarted))
    assert [began[each] for each in ((0.2, "crash"), (1.0, "crash"), (0.5, "partition"))] == [1, 2, 2]


def test_a_plan_that_cannot_be_called_is_refused():
    class Old:
        def faults(self, size, horizon, rng):
            return []

    with pytest.raises(KeyedError, match="fault"):
        Scenario(fault=(Old(),))


def test_no_clock_is_slower_than_the_bound_of_a_drift():
    with pytest.raises(KeyedError, match=r"drift: should be greater than or equal to -0\.99"):
        ClockSkew(node=0, drift=-0.995)
    skew = ClockSkew(node=0, drift=MIN_DRIFT)
    assert clock_errors([skew, skew], 2, 0) == [(0.0, MIN_DRIFT), (0.0, 0.0)]
    assert min(drift for _, drift in clock_errors([ClockSkew(drift=2.0)], 50, 0)) == MIN_DRIFT


def test_a_clock_of_no_node_is_refused():
    with pytest.raises(ValueError, match=r"clock_skew\.node: there is no node 2: the nodes are 0 \.\. 1"):
        clock_errors([ClockSkew(node=2)], 2, 0)


def test_a_change_that_is_not_planned_is_refused_among_planned_ones():
    """Messages that arrive before the next planned fault have been delivered already."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(2), fault_state=FaultState(lambda: np.zeros((2, 2))))
    network.crash(0)
    network.recover(0)
    state = network.fault_state
    unblock = state.block(lambda src, dst: False, "fog")
    inject([Crash(node=1, start=1.0)], clock, network)
    changes = [partial(network.crash, 0), partial(network.recover, 1, memory=False), partial(state.partition, [[0]])]
    changes += [partial(state.jam, ((0.0, 0.0), 1.0)), unblock]
    for end in (0.0, 2.0):  # before and after a planned change
        clock.run(until=Instant(clock, round(end * SECOND), Phase.DECISION))
        for change in changes:
            with pytest.raises(ValueError, match="faults were injected"):
                change()
    network.publish(0, "x")
    with pytest.raises(ValueError, match="before the first message"):
        inject([Crash(node=0, start=0.5)], clock, network)
    clock.run()
    assert state.down(1)


@pytest.mark.parametrize("traced", [False, True])
@pytest.mark.parametrize(
    "others", [[], [Crash(node=2, start=0.0, end=9.0)], [MessageFault(messages=(1,), delay=0.1, duplicate=True)]]
)
def test_a_crash_on_the_air_is_the_same_with_a_trace_and_if_another_node_is_down(others, traced):
    """A message of 1 s leaves at 1 s, and its sender crashes at 1.5 s; a copy of the message is lost, too."""
    clock, trace = Clock(), Trace(messages=traced)
    links = Links(medium=Bitrate(bitrate=160.0))
    network = Network(clock, nx.complete_graph(3), links, fault_state=FaultState(), trace=trace)
    inject([*others, Crash(node=0, start=1.5, end=8.0)], clock, network, trace)
    Instant(clock, SECOND, Phase.DECISION).callbacks.append(lambda _: network.publish(0, "x", size=20))
    clock.run(until=5 * SECOND)
    assert network.latest_records(1) == network.latest_records(2) == {}
    counts = network.message_counts()
    assert counts.lost_by == {"crash": counts.sent}


@pytest.mark.parametrize("access", [None, Aloha()])
def test_what_a_fault_does_to_a_message_is_forgotten_when_its_arrival_is_known(access):
    clock = Clock()
    medium = Bitrate(bitrate=1e6) if access is None else Bitrate(bitrate=1e6, access=access)
    network = Network(clock, nx.complete_graph(3), Links(medium=medium, latency=1.0), fault_state=FaultState())
    faults = [MessageFault(messages=(1, 2, 6), delay=delay, duplicate=delay < inf) for delay in (0.5, inf)]
    inject(faults, clock, network)
    clock.run(until=Instant(clock, 0, Phase.DECISION))
    for node in range(3):
        network.publish(node, "x", size=1)
        network.send(node, (node + 1) % 3, "x", size=1)
    clock.run(until=SECOND // 2)
    assert network.message_counts().lost_by["message_fault"] > 0
    assert network.fault_state._intercepted == network.fault_state._copies == {}


@pytest.mark.parametrize(
    ("medium", "cause"),
    [
        (Bitrate(bitrate=1e3, queue_limit=0), "queue"),
        (Bitrate(bitrate=1e3, queue_limit=0, access=Aloha()), "queue"),
        (Bitrate(bitrate=1e3, access=Csma(attempts=1)), "access"),
        (Bitrate(bitrate=1e3, access=CsmaCa(window=1, doublings=0, retries=1)), "collision"),
        (Bitrate(bitrate=1e3), "crash"),
        (Bitrate(bitrate=1e3, access=Aloha()), "crash"),
    ],
)
def test_what_a_fault_does_to_a_message_that_never_starts_is_forgotten(medium, cause):
    """Four messages leave at once and one soon after; some are dropped, given up, or lost in a crash as they wait."""
    clock = Clock()
    network = Network(clock, nx.complete_graph(3), Links(medium=medium), fault_state=FaultState())
    faults = [MessageFault(messages=tuple(range(1, 10)), delay=0.5, duplicate=True)]
    inject([*faults, *[Crash(node=0, start=0.001, end=9.0)] * (cause == "crash")], clock, network)
    clock.run(until=Instant(clock, 0, Phase.DECISION))
    for node in (0, 1, 0, 1):
        network.send(node, 2, "x", size=20)
    clock.run(until=Instant(clock, SECOND // 100, Phase.DECISION))
    network.send(2, 1, "x", size=20)
    clock.run(until=5 * SECOND)
    assert network.message_counts().lost_by[cause] > 0
    assert network.message_counts().in_flight == 0
    assert network.fault_state._intercepted == network.fault_state._copies == {}


@pytest.mark.parametrize("start", [{"start": -1.0}, {"start": "x"}, {}])
def test_the_end_of_a_fault_is_not_compared_with_a_start_that_is_wrong(start):
    with pytest.raises(KeyedError, match=r"^Crash: start: [^\n]*$"):
        Crash(node=1, end=0.5, **start)
    with pytest.raises(KeyedError, match=r"^Crash: end: should be later than start .got 0\.5 and 0\.5.[^\n]*$"):
        Crash(node=1, start=0.5, end=0.5)
