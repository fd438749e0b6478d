"""What pursuers see of the evader, what is reported to them, and what they make of it."""

from math import inf, isnan, pi

import networkx as nx
import numpy as np
import pytest
from pydantic import ValidationError

import desim
from desim import Scenario
from desim.kernel.events import Sent
from desim.kernel.faults import Crash
from desim.kernel.graphs import Edges
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.pursuit.evasion import ConstantHeading, Diffusion, Still
from desim.pursuit.events import Decided, Ended, Sampled, Started
from desim.pursuit.sensing import PORT, Sensing, spiral
from desim.pursuit.word import Announcements
from desim.scenario import Evader, Recording, Team
from protocols.schedules import Poisson

OF_THE_PURSUIT = (Started, Decided, Sampled, Ended)


def scenario(sensing=None, **keys):
    """Return a small team whose members do not see far."""
    settings = {"horizon": 8.0, "team": Team(count=6), "record": Recording(trajectory=0.1, messages=True)} | keys
    return Scenario(sensing=sensing or Sensing(radius=4.0), **settings)


def pursuit(result):
    return [event for event in result.trace if isinstance(event, OF_THE_PURSUIT)]


def looks(questions, period=0.1):
    """Return a protocol that asks something of every pursuer every so often, and the list of (time, id, answer)."""
    found = []

    def behaviour(me):
        for k in range(1, 10**6):
            yield me.at(k * period)
            found.append((me.now, me.id, questions(me)))

    return behaviour, found


@pytest.mark.parametrize(("kind", "payload"), [("sap", "action"), ("cbba", "time"), ("argmin", "state")])
def test_who_sees_everything_does_as_who_is_not_limited(kind, payload):
    """Beyond any distance there is, but finite: all that is decided and sampled is the same, event for event."""
    protocol = desim.scenario.PROTOCOLS.choices()[kind]()
    keys = {"protocol": protocol, "network": Links(latency=Constant(value=0.05))}
    # An evader that a sender has not told everybody of is reckoned on along its path only without limits.
    keys["announce"] = Announcements(payload=payload, reckoning="cheap")
    unlimited = desim.run(scenario(Sensing(), **keys))
    assert pursuit(desim.run(scenario(Sensing(radius=1e6), **keys))) == pursuit(unlimited)
    assert pursuit(desim.run(scenario(Sensing(radius=2.0), **keys))) != pursuit(unlimited)


@pytest.mark.parametrize("estimate", ["hold", "constant_velocity", "worst_case"])
def test_who_never_sees_anything_never_moves(estimate):
    result = desim.run(scenario(Sensing(radius=0.0, estimate=estimate)))
    start, *_, end = result.trace.of(Sampled)
    assert start.pursuers == end.pursuers
    assert not any(result.trace.of(Started)[0].active)
    assert not any(decided.active for decided in result.trace.of(Decided))
    assert result.trace.of(Ended)[0].reason == "horizon"


def late_by(estimate, runs):
    """Return by how much believed times of capture exceed the true ones, wherever there is a belief from memory."""
    behaviour, found = looks(lambda me: (me.capture_time(), me.capture_times()[me.id], me.may_chase()))
    sensing = Sensing(radius=2.0, estimate=estimate, lost_after=2.0)
    wild = Evader(strategy=Diffusion(sigma=1.0), speed=2.0)
    team = Team(count=12, speeds=3.0, active_at_start=0.0)
    for seed in range(runs):
        desim.run(scenario(sensing, protocol=behaviour, evader=wild, team=team, horizon=20.0), seed)
    return np.array([believed - true for _, _, (believed, true, able) in found if able and believed != true])


def test_the_worst_case_is_an_upper_bound_in_every_case():
    """Ten thousand cases and more in which the evader was not seen; a bound only for this estimate, the control."""
    excess = late_by("worst_case", runs=9)
    assert len(excess) >= 10_000
    assert excess.min() >= -1e-9
    for estimate in ("hold", "constant_velocity"):
        assert (late_by(estimate, runs=1) < -0.01).mean() > 0.1


def seen_once(sensing, strategy, asks, **keys):
    """Return what pursuer 0 answers every 0.1 s, of an evader that leaves its sight after about a second."""
    behaviour, found = looks(asks)
    team = Team(positions=((0.0, 0.0), (50.0, 0.0)), speeds=1.0, active_at_start=0.0)
    evader = Evader(position=(2.0, 0.0), speed=0.9, strategy=strategy)
    desim.run(scenario(sensing, team=team, evader=evader, protocol=behaviour, **keys))
    return {round(t, 1): answer for t, pursuer, answer in found if pursuer == 0}


def test_an_evader_that_goes_straight_is_where_its_velocity_says():
    place = seen_once(Sensing(radius=3.0, lost_after=inf), ConstantHeading(angle=0.0), lambda me: me.evader())
    assert max(abs(place[t] - (2.0 + 0.9 * t)) for t in place) < 1e-9
    assert max(place) == 7.9


def test_an_estimate_that_holds_stays_where_the_evader_was_last_seen():
    """It leaves the sight of 3 m after 1.111 s; what is remembered is the last motion step before that."""
    sensing = Sensing(radius=3.0, estimate="hold", lost_after=inf)
    place = seen_once(sensing, ConstantHeading(angle=0.0), lambda me: me.evader())
    assert place[1.1] == pytest.approx(2.99)
    assert [place[t] for t in place if t >= 1.2] == [pytest.approx(2.999)] * 68


def test_the_worst_case_grows_with_age():
    """From 3 m on phi = (d + v_e age - eps) / (v - v_e): it rises by v_e / (v - v_e) = 9 s per s."""
    sensing = Sensing(radius=3.0, estimate="worst_case", lost_after=inf)
    phi = seen_once(sensing, ConstantHeading(angle=0.0), lambda me: me.capture_time())
    assert phi[3.0] - phi[2.0] == pytest.approx(9.0)
    assert phi[2.0] == pytest.approx((2.999 + 0.9 * (2.0 - 1.11) - 0.1) / 0.1)


def test_who_has_lost_it_stays_or_searches():
    """It is last seen at 1.11 s, and so lost from 3.11 s on."""
    for when_lost, knows in (("stay", False), ("search", True)):
        sensing = Sensing(radius=3.0, lost_after=2.0, when_lost=when_lost)
        answers = seen_once(sensing, ConstantHeading(angle=0.0), lambda me: (me.may_chase(), me.evader()))
        assert answers[3.1] == (True, pytest.approx(2.0 + 0.9 * 3.1))
        assert answers[3.2][0] == knows
        assert isnan(answers[3.2][1].real) != knows


def test_the_search_goes_round_where_the_evader_was_lost():
    """Turns are 2 R_s apart: what is within R_s of the way is a disk that grows."""
    sensing = Sensing(radius=3.0, estimate="hold", lost_after=0.5)
    place = seen_once(sensing, ConstantHeading(angle=0.0), lambda me: me.evader(), horizon=60.0)
    radii = [abs(place[t] - 2.999) for t in place if t > 1.7]
    assert radii == sorted(radii)
    lengths = np.linspace(0.0, 5000.0, 20_000)
    way = np.array([spiral(length, 6.0) for length in lengths])
    angle = np.unwrap(np.angle(way[1:]))
    turn = np.interp(angle[1000:] + 2.0 * pi, angle, np.abs(way[1:]))[:-5000] - np.abs(way[1001:-5000])
    assert turn == pytest.approx(6.0)
    gone = np.abs(np.diff(way[100:])).sum()
    assert gone == pytest.approx(lengths[-1] - lengths[100], rel=0.01)


def on_a_line(count, *, pass_on):
    """Return when each of a team on a line first had an estimate; only pursuer 0 sees the evader, which stands."""
    behaviour, found = looks(lambda me: me.may_chase(), period=0.01)
    graph = Edges.of(nx.path_graph(count))
    team = Team(positions=tuple((10.0 * k, 0.0) for k in range(count)), active_at_start=0.0, speeds=1.0)
    desim.run(
        scenario(
            Sensing(radius=3.0, pass_on=pass_on),
            team=team,
            evader=Evader(position=(0.0, 2.0), strategy=Still()),
            network=Links(graph=graph, latency=Constant(value=0.05)),
            protocol=behaviour,
            horizon=2.0,
        )
    )
    return [min((t for t, j, able in found if j == k and able), default=inf) for k in range(count)]


def test_sightings_travel_as_messages_hop_by_hop():
    """Each hop takes the latency and, on the way, what is left of a period; who does not see does not know before."""
    known = on_a_line(5, pass_on=True)
    hops = np.diff(known)
    assert known[0] == 0.01
    assert (hops >= 0.05 - 1e-9).all()
    assert (hops <= 0.15 + 0.01 + 1e-9).all()


def test_only_who_sees_reports_if_nobody_passes_on():
    known = on_a_line(5, pass_on=False)
    assert known[1] < 0.2
    assert known[2:] == [inf] * 3


def test_a_report_has_its_size_and_tells_the_newest():
    """Header of 16 bytes and six numbers of 8. Nobody tells older news than it told before."""
    result = desim.run(scenario(Sensing(radius=9.0, period=0.05)))
    sent = [event for event in result.trace.of(Sent) if hasattr(event.body[0], "seen")]
    assert {event.size for event in sent} == {64}
    told = [(event.flight, event.src, event.body[0].seen) for event in sent]
    newest = {}
    for _, src, seen in sorted(set(told)):
        assert seen >= newest.get(src, -1.0)
        newest[src] = seen
    assert len(newest) >= 4
    assert PORT == "sightings"


def test_who_recovers_without_memory_has_no_sighting():
    crash = Crash(node=0, at=2.0, until=3.0, memory=False, scope="robot")
    sensing = Sensing(radius=3.0, lost_after=inf)
    answers = seen_once(sensing, ConstantHeading(angle=0.0), lambda me: me.may_chase(), fault=(crash,))
    assert answers[1.9]
    assert not answers[3.5]


def test_nobody_runs_past_the_place_where_it_believes_the_evader_to_be():
    """The evader is last seen at 3.25 m, 3 m from the pursuer, which waits there: else it would go to and fro."""

    def chase(me):
        me.assign(1)
        yield me.at(1e6)

    team = Team(positions=((0.0, 0.0),), speeds=1.0)
    away = Evader(position=(2.0, 0.0), speed=5.0, strategy=ConstantHeading(angle=0.0))
    sensing = Sensing(radius=3.0, estimate="hold", lost_after=inf)
    base = scenario(sensing, team=team, evader=away, protocol=chase, prune="none")
    ends = [sample.pursuers[0] for sample in desim.run(base).trace.of(Sampled)][-3:]
    assert len(set(ends)) == 1
    assert ends[0] == (pytest.approx(3.25), 0.0)


@pytest.mark.parametrize("schedule", [Poisson(rate=5.0)])
def test_limited_sight_is_reproducible(schedule):
    protocol = desim.scenario.PROTOCOLS.choices()["sap"](schedule=schedule)
    base = scenario(Sensing(radius=3.0), protocol=protocol)
    first, again = (list(desim.run(base, 5).trace.lines()) for _ in range(2))
    assert first == again


@pytest.mark.parametrize(
    ("key", "value"),
    [("radius", -1.0), ("period", 0.0), ("lost_after", 0.0), ("estimate", "guess"), ("when_lost", "cry"), ("view", 1)],
)
def test_bad_sensing_is_an_error_that_names_the_key(key, value):
    with pytest.raises(ValidationError, match=rf"sensing\.{key}"):
        Scenario(sensing={key: value})
