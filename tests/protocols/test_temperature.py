"""Temperatures of log-linear learning."""

from itertools import combinations
from math import exp, inf, log, nan
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, run
from desim.kernel.models.clock_skew import ClockSkew
from desim.pursuit.team.announcements import Announcements, TimedAssignment
from desim.pursuit.team.beliefs import Belief
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Motion, Recording
from protocols.temperature import AdaptiveTau, ConstantTau, GeometricTau, LogarithmicTau, PaperTau, slots_seen

# Closed forms.


def test_the_papers_temperature_is_infinite_at_first_and_a_thousandth_after_a_hundred_slots():
    assert PaperTau()(0.0) == 0.0
    assert 1 / PaperTau()(1.0) == 10.0
    assert 1 / PaperTau()(100.0) == pytest.approx(0.001)
    assert 1 / PaperTau(scale=3.0)(2.0) == pytest.approx(0.75)


@given(st.floats(0.0, 1e9), st.floats(0.01, 100.0), st.floats(1.001, 100.0))
def test_the_logarithmic_temperature_is_its_scale_over_a_logarithm(eta, scale, offset):
    """tau = c / ln(eta + k0); finite at first, because k0 > 1."""
    assert LogarithmicTau(scale=scale, offset=offset)(eta) * scale == pytest.approx(log(eta + offset), rel=1e-12)
    assert 0.0 < LogarithmicTau(scale=scale, offset=offset)(0.0) < inf


def test_hajeks_temperature_cools_so_slowly_that_an_upward_step_is_made_infinitely_often():
    """sum over k of exp(-d / tau_k) = sum of (k + 2)^(-d / c): without bound iff d <= c.

    For d = c it is the harmonic series, 2^m more slots add ln 2 each time they are doubled; for d = 2 c it is less than
    pi^2 / 6. The paper's temperature, exp(-k^2 / 10), ends below 3.
    """

    def steps(tau, height, slots):
        return sum(exp(-height * tau(k)) for k in slots)

    slow = LogarithmicTau(scale=1.5)
    assert steps(slow, 1.5, range(1000, 2000)) == pytest.approx(log(2002 / 1002), rel=1e-3)
    assert steps(slow, 1.5, range(2000, 4000)) == pytest.approx(log(4002 / 2002), rel=1e-3)
    assert steps(slow, 3.0, range(10_000)) == pytest.approx(3.14159265**2 / 6 - 1, rel=1e-3)
    assert steps(PaperTau(), 1.0, range(10_000)) == pytest.approx(0.5 * (1 + (10 * 3.14159265) ** 0.5), rel=1e-6)


def test_the_geometric_temperature_falls_to_its_floor_and_a_constant_one_does_not_change():
    """2 s halved eight times is 1/128 s, above the floor of 1/200 s; the ninth time it would be 1/256 s."""
    tau = GeometricTau(first=2.0, ratio=0.5, floor=0.005)
    assert [1 / tau(k) for k in range(9)] == pytest.approx([2.0 / 2**k for k in range(9)], rel=1e-12)
    assert 1 / tau(0.5) == pytest.approx(2.0 / 2**0.5)
    assert [1 / tau(k) for k in (9, 10, 1e9)] == pytest.approx([0.005] * 3, rel=1e-12)
    assert [1 / GeometricTau(first=0.1, floor=0.2)(k) for k in (0, 50)] == pytest.approx([0.2, 0.2])
    assert ConstantTau(value=0.5)(0.0) == ConstantTau(value=0.5)(1e9) == 2.0


@given(st.floats(0.0, 1e4), st.sampled_from([PaperTau(scale=2.0), ConstantTau(), LogarithmicTau(), GeometricTau()]))
def test_the_adaptive_temperature_cools_as_another_does(eta, cooling):
    assert AdaptiveTau(cooling=cooling)(eta) == cooling(eta)


# How many slots a pursuer counts.

TURNS = [0.05 + 0.1 * k for k in range(50)]
SLOT = 0.1


def watch(tau, teammate, *, observer=0, count=3, fault=(), until=5.0):
    """Return eta at each of the turns of a pursuer whose phi is 2 s, while its teammates run `teammate`.

    Records are trusted for 0.35 s, none is known at first, and only `teammate` announces.
    """
    seen = []

    def protocol(me):
        if me.id != observer:
            yield from teammate(me)
            return
        slots = slots_seen(tau, me, SLOT)
        for turn in TURNS:
            yield me.at(turn)
            seen.append(next(slots))

    run(
        Scenario(
            horizon=until,
            team=Team(positions=[(2.1, 0.0)] * count, speeds=1.0, active_at_start=0.0),
            evader=Evader(position=(0.0, 0.0), speed=0.0),
            motion=Motion(static=True),
            protocol=protocol,
            announce=Announcements(payload="time", trigger="never", belief_timeout=0.35, start="silent"),
            fault=fault,
            record=Recording(trajectory=0.0),
        )
    )
    return seen


def since(turns, events):
    """Return how many slots have passed at each turn since the last of the reheating events, or since 0 s."""
    return [(turn - max([0.0, *(s for s in events if s <= turn)])) / SLOT for turn in turns]


def eventful(me):
    """Pursuer 2 announces all the time, an action that changes, and ties with the observer. Pursuer 1:

    1 to 1.9 s: announces, and is slower than the observer (a new teammate, at the turn of 1.05 s).
    2 to 2.9 s: is faster (a change of order, at 2.05 s). 3 to 3.9 s: slower again (another, at 3.05 s).
    From 4 s on it is silent: its record of 3.9 s is trusted until 4.25 s, and not at the turn of 4.35 s.
    """
    for k in range(50):
        yield me.at(0.1 * k)
        if me.id == 2:
            me.publish(TimedAssignment(k % 3 == 0, 2.0))
        elif 10 <= k < 40:
            me.publish(TimedAssignment(k % 2 == 0, 1.0 if 20 <= k < 30 else 4.0))


REHEATING = {"new_teammate": [1.05], "order": [2.05, 3.05], "silence": [4.35]}


@pytest.mark.parametrize("listed", [each for k in range(4) for each in combinations(REHEATING, k)], ids=repr)
def test_reheating_happens_only_at_the_listed_events(listed):
    """For each choice of the three; a teammate's action, or one that ties and comes later, is no reheating event."""
    expected = since(TURNS, [turn for each in listed for turn in REHEATING[each]])
    assert watch(AdaptiveTau(reheat_on=listed), eventful) == pytest.approx(expected, abs=1e-9)


def test_other_temperatures_count_from_the_start_whatever_happens():
    assert watch(GeometricTau(), eventful) == pytest.approx(since(TURNS, []), abs=1e-9)


def test_reheating_on_order_covers_every_evader_and_captures():
    """Pursuer 0 is first of evader 1, until 1 is, from 1 s on, and of evader 2, which is captured at 2 s.

    That no time is announced for evader 3 at 1.5 s does not matter: nan is no time.
    """
    me, eta = SimpleNamespace(id=0, restarts=0, now=0.0), []
    phi = {2: nan}
    me.evaders = lambda: [1, 2, 3] if me.now < 2.0 else [1, 3]
    me.capture_time = lambda evader: 3.0
    me.beliefs = lambda evader=1: {1: Belief(1, phi[evader])}
    slots = slots_seen(AdaptiveTau(reheat_on=("order",)), me, 0.5)
    for me.now in (0.0, 0.5, 1.0, 1.5, 2.0, 2.5):
        phi[1], phi[3] = 4.0 if me.now < 1.0 else 2.0, nan if me.now == 1.5 else 9.0
        eta.append(next(slots))
    assert eta == [0.0, 1.0, 0.0, 1.0, 0.0, 1.0]


@pytest.mark.parametrize(("restarts", "eta"), [(0, 4.0), (1, 0.0)])
def test_a_pursuer_restarted_without_memory_counts_slots_from_the_restart(restarts, eta):
    """Its first turn is at 2 s, in slots of 0.5 s."""
    me = SimpleNamespace(id=0, restarts=restarts, now=2.0)
    me.evaders, me.capture_time, me.beliefs = lambda: [1], lambda evader: 3.0, lambda evader=1: {}
    slots = slots_seen(AdaptiveTau(), me, 0.5)
    assert next(slots) == eta
    me.now = 3.0
    assert next(slots) == eta + 2.0


def test_teammates_known_at_the_first_turn_do_not_cause_reheating():
    def teammate(me):
        for k in range(50):
            yield me.at(0.1 * k)
            me.publish(TimedAssignment(True, 1.0))

    assert watch(AdaptiveTau(), teammate) == pytest.approx(since(TURNS, []), abs=1e-9)


def test_a_returning_pursuer_is_a_new_teammate_again():
    """Silent from 1 s to 3 s: not trusted any more at 1.35 s, received again at 3.05 s."""

    def teammate(me):
        for k in range(50):
            yield me.at(0.1 * k)
            if not 10 <= k < 30:
                me.publish(TimedAssignment(False, 4.0))

    seen = watch(AdaptiveTau(reheat_on=("new_teammate",)), teammate)
    assert seen == pytest.approx(since(TURNS, [3.05]), abs=1e-9)
    seen = watch(AdaptiveTau(reheat_on=("silence",)), teammate)
    assert seen == pytest.approx(since(TURNS, [1.35]), abs=1e-9)


def test_of_two_that_tie_the_lower_number_is_first():
    """Pursuer 0 announces 4 s, and from 2 s on 2 s, as the observer has: it goes ahead of 1 but not of 0."""

    def teammate(me):
        for k in range(50):
            yield me.at(0.1 * k)
            me.publish(TimedAssignment(True, 4.0 if k < 20 else 2.0))

    order = AdaptiveTau(reheat_on=("order",))
    assert watch(order, teammate, count=2, observer=1) == pytest.approx(since(TURNS, [2.05]), abs=1e-9)
    assert watch(order, teammate, count=2, observer=0) == pytest.approx(since(TURNS, []), abs=1e-9)


@pytest.mark.parametrize("tau", [AdaptiveTau(reheat_on=()), PaperTau()], ids=repr)
def test_a_clock_that_is_behind_counts_no_slots_below_zero(tau):
    """3 s behind: its turns at 0.05 s, 0.15 s ... come at 3.05 s, 3.15 s ...; a turn before 0 is none of 0."""
    seen = []

    def protocol(me):
        slots = slots_seen(tau, me, SLOT)
        for k in range(10):
            yield me.at(k - 3.0)
            seen.append(next(slots))

    skew = ClockSkew(node=0, offset=-3.0)
    run(Scenario(team=Team(count=1), protocol=protocol, fault=(skew,), horizon=9.5, motion=Motion(static=True)))
    assert seen == pytest.approx([0, 0, 0, 0, 10, 20, 30, 40, 50, 60])
