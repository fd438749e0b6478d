"""Faults that look at the run concern whoever chases when they begin."""

from math import inf, nan
from typing import Any

import pytest

from desim import Announcements, Fault, Liar, Links, MessageFault, Scenario, Team, judge, load, run
from desim.analysis.metrics import active_time
from desim.kernel.core.events import LOST, Broadcast, Lost, Sent
from desim.kernel.models.faults import Crash, Partition
from desim.kernel.models.traced_faults import CustomFault, FaultEnded, FaultStarted
from desim.kernel.transport.frames import carried
from desim.pursuit.byzantine.lies import ReplayAttack
from desim.pursuit.core.events import Decided
from desim.pursuit.team.announcements import relayed_records
from desim.pursuit.team.targeted_faults import ChaserCrash, ChaserCut, NewsFault
from desim.scenario.scenario import Recording
from scenarios.studies.study import SCENARIOS

GAME = Scenario(
    team=Team(count=5),
    announce=Announcements(heartbeat=0.34),
    network=Links(latency=0.1),
    record=Recording(messages=True),
)
"""One pursuer chases after a second; with seed 3 it is the last one, which is the fastest."""
FIXED = {
    ChaserCrash: lambda nodes: [Crash(start=2.0, end=4.0, node=node) for node in nodes],
    ChaserCut: lambda nodes: [Partition(start=2.0, end=4.0, groups=tuple((node,) for node in nodes))],
}


def events(fault, **more):
    scenario = GAME.model_copy(update={"fault": tuple(fault), **more})
    return [event for event in run(scenario, 3).trace if not is_target(event)]


def is_target(event):
    return isinstance(event, FaultStarted | FaultEnded) and isinstance(event.fault, CustomFault)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FIXED)
def test_the_run_is_that_of_a_fault_of_the_pursuer_that_chases(kind):
    targeted = events([kind(start=2.0, end=4.0)])
    assert targeted == events(FIXED[kind]([4]))
    assert targeted != events(FIXED[kind]([3]))


@pytest.mark.parametrize("kind", FIXED)
def test_several_chasers_are_taken_in_the_order_of_their_capture_times(kind):
    """At the start all chase: the fastest of all would capture first."""
    (fault,) = (kind(start=0.05, end=1.0, chasers=2),)
    begun = [event.fault for event in run(GAME.model_copy(update={"fault": (fault,)}), 3).trace.of(FaultStarted)]
    parts = [part for part in begun if not isinstance(part, CustomFault)]
    nodes = [node for part in parts for named in part.named().values() for node in named]
    assert (len(nodes), nodes[0]) == (2, 4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FIXED)
def test_without_a_chaser_nothing_happens(kind):
    idle = {"protocol": lambda me: iter(()), "team": Team(count=5, active_at_start=0.0)}
    assert events([kind(start=2.0, end=4.0)], **idle) == events([], **idle)


def test_a_chaser_that_is_cut_off_goes_on_and_hears_nothing():
    result = run(GAME.model_copy(update={"fault": (ChaserCut(start=2.0, end=4.0),)}), 3)
    lost = [event for event in result.trace.of(Lost) if event.cause == "partition"]
    assert lost
    assert all(4 in (event.src, event.dst) for event in lost)
    assert {event.pursuer for event in result.trace.of(Decided) if 2e9 < event.t < 4e9} >= {4}
    assert active_time(result) > 5.0


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["sap", "best_response", "cbaa", "cbba"])
def test_the_crash_of_the_chaser_leaves_teams_idle_that_believe_it_to_chase(protocol):
    """The evader runs from slow pursuers until the belief times out, and then none can be in time.

    The controls: `centralised` chases on, and the crash of a pursuer that does not chase harms nobody.
    """
    game = GAME.with_({"protocol": protocol, "record.messages": False})
    prop = "idle at most 2 in total against centralised"
    crash, other = ChaserCrash(start=0.6), Crash(start=0.6, node=1)
    margins = [judge(prop, run(game.model_copy(update={"fault": (fault,)}), 4)).margin for fault in (crash, other)]
    assert margins[0] < -20.0
    assert margins[1] >= 0.0


def heard(fault, **more):
    """Return (src, sent, action, arrivals) of each broadcast of a run with a fault."""
    result = run(GAME.model_copy(update={"fault": fault, "horizon": 3.0, **more}), 3)
    return [(sent.src, sent.created, sent.body.active, sent.arrival) for sent in result.trace.of(Broadcast)]


@pytest.mark.parametrize("delay", [inf, 0.5])
def test_the_first_message_after_each_change_of_action_is_lost_or_late(delay):
    last, news = {}, 0
    for src, created, action, arrival in heard((NewsFault(start=1.0, delay=delay),)):
        if created >= 1_000_000_000:
            is_news = last.get(src) != action
            late = LOST if delay == inf else created + 600_000_000
            assert {*arrival} == {late if is_news else created + 100_000_000}
            last[src], news = action, news + is_news
    assert news >= 5


@pytest.mark.parametrize("network", [{}, {"transport": "reliable"}])
@pytest.mark.parametrize("dissemination", ["flooding", "gossip"])
def test_news_is_lost_in_messages_that_relay_records(dissemination, network):
    """The first transmission of each record with another action is, to all; repetitions and other records are not."""
    scenario = GAME.with_({"announce.dissemination": dissemination, "horizon": 0.7})
    scenario = scenario.model_copy(update={"fault": (NewsFault(),), "network": Links(latency=0.1, **network)})
    last, news = {}, 0
    for sent in run(scenario, 3).trace.of(Sent):
        own = [record for record in relayed_records(carried(sent.body)) or () if record.src == sent.src]
        if own and getattr(sent.body, "attempt", 1) == 1:
            link, action = (sent.src, sent.dst), own[0].body.active
            is_news = last.get(link) != action
            assert (sent.arrival == LOST) == is_news
            last[link], news = action, news + is_news
    assert news >= 20


def test_the_number_of_changes_is_bounded():
    lost = [src for src, _, _, arrival in heard((NewsFault(changes=2),)) if {*arrival} == {LOST}]
    assert len(lost) == 2


def test_a_liar_may_be_the_pursuer_that_chases():
    """With seed 3 it is the last one, after a second."""
    lie = {"start": 2.0, "end": 4.0, "action": "stay"}
    chosen = run(GAME.model_copy(update={"fault": (Liar(chaser=True, **lie),)}), 3)
    assert [*chosen.trace] == [*run(GAME.model_copy(update={"fault": (Liar(node=4, **lie),)}), 3).trace]
    assert [*chosen.trace] != [*run(GAME.model_copy(update={"fault": (Liar(node=3, **lie),)}), 3).trace]
    old = ReplayAttack(chaser=True, start=2.0, end=4.0, delay=1.5)
    fixed = ReplayAttack(node=4, start=2.0, end=4.0, delay=1.5)
    traces = [[*run(GAME.model_copy(update={"fault": (fault,)}), 3).trace] for fault in (old, fixed)]
    assert traces[0] == traces[1]
    idle = {"protocol": lambda me: iter(()), "team": Team(count=5, active_at_start=0.0)}
    assert not run(GAME.model_copy(update={"fault": (Liar(chaser=True, **lie),), **idle}), 3).trace.of(FaultStarted)


@pytest.mark.parametrize("named", [{}, {"node": 1, "chaser": True}, {"node": 1, "share": 0.5}])
def test_a_liar_is_named_in_one_way(named):
    with pytest.raises(ValueError, match="should have one of these: a node, chaser = true, or a share of the team"):
        Liar(start=1.0, **named)


class Intercepting(Fault):
    start: float = 0.0
    answer: Any

    def begin(self, site):
        return site.intercept(lambda src, receivers, body: self.answer)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ([1, 2], "should return the extra delay, s, by receiver"),
        ({1: "x"}, "should return the extra delay, s, by receiver"),
        ({77: 1.0}, "should name receivers of the message, got 77"),
        ({1: -1.0}, "an extra delay, in s, should be at least 0, got -1"),
        ({1: nan}, "an extra delay, in s, should be at least 0, got nan"),
    ],
)
def test_a_wrong_answer_of_an_interception_is_told(answer, message):
    with pytest.raises(ValueError, match=message):
        run(GAME.model_copy(update={"fault": (Intercepting(answer=answer),)}), 3)


def test_an_interception_needs_a_function_of_sender_receivers_and_body():
    class Wrong(Intercepting):
        def begin(self, site):
            return site.intercept(self.answer)

    for answer, message in ((3, "should be given a function of sender, receivers and body"), (lambda src: {}, "src")):
        with pytest.raises(ValueError, match=message):
            run(GAME.model_copy(update={"fault": (Wrong(answer=answer),)}), 3)


def test_two_interceptions_delay_together():
    faults = MessageFault(messages=(1,), delay=0.25), MessageFault(messages=(1, 2), delay=0.5)
    (first, *_) = heard(faults)
    undisturbed = heard(())[0][3][0]
    assert [t - undisturbed for t in first[3][:3]] == [750_000_000, 500_000_000, 0]


def test_they_are_kinds_of_a_scenario_file():
    faults = load(SCENARIOS / "properties.toml").fault
    assert [type(fault) for fault in faults] == [ChaserCrash, ChaserCut]
    with pytest.raises(ValueError, match="chasers: should be greater than or equal to 1"):
        ChaserCrash(start=1.0, chasers=0)
