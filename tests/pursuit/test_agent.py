"""The agent: what a protocol may know and do."""

import pytest

from desim import Scenario, run
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.agent import Assignment
from desim.pursuit.events import Decided
from desim.pursuit.word import Announcements
from desim.scenario import Evader, Team


def play(protocol, latency=0.0, **changes):
    """Run a protocol for three pursuers at 1, 2 and 4 m (speed 1) of an evader that stands still, r(0) = 10 s."""
    given = {
        "horizon": 10.0,
        "team": Team(positions=[(1.0, 0.0), (2.0, 0.0), (4.0, 0.0)], speeds=1.0, active_at_start=0.0),
        "evader": Evader(position=(0.0, 0.0), speed=0.0),
        "protocol": protocol,
        "network": Links(latency=Constant(value=latency)),
        "announce": Announcements(trigger="revision"),
    }
    return run(Scenario(**(given | changes)))


def test_the_gain_is_judged_against_what_has_arrived():
    """Pursuer 2 (phi = 3.9) hears of pursuer 0 (phi = 0.9, chasing since 1 s) 0.5 s late."""
    seen = {}

    def protocol(me):
        if me.id == 0:
            yield me.at(0.5)
            me.announce()
            yield me.at(0.75)
            me.assign(True)
            me.announce()
            me.assign(False)  # so that it does not capture
        if me.id == 2:
            for t in (0.0, 1.2, 1.25, 1.3):
                yield me.at(t)
                seen[t] = (me.believed_active(), round(me.gain(), 9), me.time_left())

    play(protocol, latency=0.5)
    assert seen[0.0] == ([], 6.1, 10.0)
    assert seen[1.2] == ([], 4.9, 8.8)
    assert seen[1.25] == (*seen[1.3][:2], 8.75) == ([0], -1.5, 8.75)


def test_an_active_teammate_that_cannot_capture_does_not_count():
    """Pursuer 0 (v = 0) says that it chases; its phi is inf, so pursuer 2 gains r - phi = 10 - 3.9 all the same."""

    def protocol(me):
        yield me.at(me.id * 0.0)
        if me.id == 0:
            me._network.publish(0, Assignment(active=True))
        if me.id == 2:
            seen.append((me.believed_active(), me.gain()))

    seen = []
    team = Team(positions=[(1.0, 0.0), (2.0, 0.0), (4.0, 0.0)], speeds=[0.0, 1.0, 1.0], active_at_start=0.0)
    play(protocol, team=team)
    assert seen == [([0], pytest.approx(6.1))]


def test_a_pursuer_that_cannot_capture_stays_whatever_it_wants():
    def protocol(me):
        yield me.at(1.0)
        me.assign(True)
        actions.append(me.action)

    actions = []
    team = Team(positions=[(1.0, 0.0), (2.0, 0.0)], speeds=[0.0, 1.0], active_at_start=1.0)
    assert [d.active for d in play(protocol, team=team, horizon=1.5).trace.of(Decided)] == actions == [False, True]


def test_nobody_commands_a_pursuer_that_does_not_exist():
    def protocol(me):
        yield me.at(0.5)
        me.command(-1, True)

    with pytest.raises(ValueError, match="there is no pursuer -1"):
        play(protocol)


def test_an_agent_knows_itself_and_its_team():
    def protocol(me):
        yield me.sleep(0.25)
        assert (me.now, me.team_size, me.action) == (0.25, 3, False)
        assert me.capture_times() == pytest.approx([0.9, 1.9, 3.9])
        assert me.capture_time() == me.capture_times()[me.id]
        assert me.stream("x").random() != me.shared_stream("x").random()
        done.append((me.id, me.shared_stream("x").random()))

    done = []
    play(protocol)
    assert [pursuer for pursuer, _ in done] == [0, 1, 2]
    assert len({draw for _, draw in done}) == 1


def test_agents_talk_by_message():
    heard = []

    def protocol(me):
        if me.id == 0:
            me.send(2, "to one")
            me.send(None, "to all")
        while True:
            yield me.arrival()
            heard.extend((me.id, me.now, message.body) for message in me.mail())

    play(protocol, latency=0.125)
    assert heard == [(1, 0.125, "to all"), (2, 0.125, "to one"), (2, 0.125, "to all")]


def test_decisions_of_one_instant_are_made_in_the_order_of_ids_and_see_each_other_without_latency():
    """All three find nobody active at 1 s; the first chases, and the others hear of it at once."""

    def protocol(me):
        yield me.at(1.0)
        me.assign(me.gain() > 0)
        me.announce()

    assert [d.active for d in play(protocol).trace.of(Decided)] == [True, False, False]
    assert [d.active for d in play(protocol, latency=1e-9).trace.of(Decided)] == [True, True, True]


def test_a_protocol_that_fails_fails_the_run_with_its_own_error():
    def protocol(me):
        yield me.sleep(0.1)
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        play(protocol)
