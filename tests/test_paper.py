"""With an ideal network the simulator is the paper: step for step, in law, and in closed form."""

from collections import Counter
from itertools import chain

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim import Scenario, run, summary
from desim.kernel.events import Broadcast
from desim.kernel.latency import Constant
from desim.kernel.links import Links
from desim.kernel.seeds import stream
from desim.pursuit.events import Decided, Ended, Sampled, Started
from desim.pursuit.game import gibbs, logit, profiles
from desim.pursuit.word import Announcements
from desim.scenario import Capture, Evader, Motion, Recording, Team
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Poisson, SharedSeed
from protocols.temperature import ConstantTau


def time_stepped_loop(x, e, active, v, v_e, eps, t_f, delta, owners=None, draws=None):
    """Algorithm 2 of Lee & Bakolas as one plain loop, or Algorithm 3 if there are no owners.

    owners[k] revises at k delta, with the draws of the generator draws[owner]. Returns the positions at every k delta
    (pursuers, then evader), who was active in every slot, and the time of capture (None: not captured).
    """
    x, e, active, paths, profiles = x.copy(), e.copy(), list(active), [], []
    for k in range(round(t_f / delta) + 1):
        paths.append(np.vstack([x, e]))
        d = np.linalg.norm(e - x, axis=1)
        if (d <= eps).any():
            return np.array(paths), profiles, k * delta
        able = v > v_e
        phi, r = np.where(able, (d - eps) / np.where(able, v - v_e, 1.0), np.inf), t_f - k * delta
        if owners is None:
            active = [i == phi.argmin() and phi[i] < r for i in range(len(x))]
        elif k >= 1:
            i = owners[k]
            others = [phi[j] for j in range(len(x)) if active[j] and j != i]
            gain = (np.mean(others) - phi[i]) / (len(others) + 1) if others else r - phi[i]
            with np.errstate(over="ignore", invalid="ignore"):
                active[i] = draws[i].random() < 1 / (1 + np.exp(-gain * k**2 / 10))
        e = e + v_e * delta * (e - x[d.argmin()]) / d.min()
        for i in np.flatnonzero(active):
            x[i] += v[i] * delta * (e - x[i]) / np.linalg.norm(e - x[i])
        profiles.append(tuple(map(bool, active)))
    return np.array(paths), profiles, None


@st.composite
def pursuits(draw):
    """A random team, configuration, start, slot and horizon."""
    count = draw(st.sampled_from([1, 2, 3, 5, 8, 20, 40]))
    seed = draw(st.integers(0, 2**31))
    rng = np.random.default_rng(seed)
    return {
        "positions": rng.uniform(0, 12, (count, 2)),
        "evader": rng.uniform(4, 8, 2),
        "speeds": rng.uniform(0.8, 2.0, count),
        "active": draw(st.sampled_from([0.0, 0.5, 1.0])),
        "delta": draw(st.sampled_from([0.1, 0.05, 0.02, 0.01])),
        "horizon": draw(st.sampled_from([1.0, 3.0, 8.0])),
        "seed": seed,
    }


def simulated(case, protocol, trigger="revision"):
    """Run a pursuit in the simulator with h = delta and an ideal network, recording positions at every step."""
    scenario = Scenario(
        horizon=case["horizon"],
        team=Team(positions=case["positions"].tolist(), speeds=case["speeds"].tolist(), active_at_start=case["active"]),
        evader=Evader(position=tuple(case["evader"].tolist())),
        capture=Capture(test="sample"),
        motion=Motion(step=case["delta"]),
        protocol=protocol,
        announce=Announcements(trigger=trigger),
        record=Recording(trajectory=case["delta"], messages=True),
    )
    return run(scenario, case["seed"])


def active_in_every_slot(trace, delta):
    """Return who was active from k delta to (k + 1) delta, for every k before the end."""
    active, profiles = list(trace.of(Started)[0].active), []
    decisions = iter([*trace.of(Decided), Decided(10**18, 0, False)])
    decision = next(decisions)
    for k in range(round(trace.of(Ended)[0].t / 1e9 / delta)):
        while decision.t <= round(k * delta * 1e9):
            active[decision.pursuer] = decision.active
            decision = next(decisions)
        profiles.append(tuple(active))
    return profiles


def compare(case, result, owners=None, draws=None):
    """Hold the trajectory, the assignments and the capture of a run against the plain loop."""
    delta, trace = case["delta"], result.trace
    start = trace.of(Started)[0]
    paths, profiles, captured = time_stepped_loop(
        *(case["positions"], case["evader"], start.active, case["speeds"]),
        *(0.9, 0.1, case["horizon"], delta, owners, draws),
    )
    end, samples = trace.of(Ended)[0], trace.of(Sampled)
    assert (end.reason == "captured") == (captured is not None)
    if captured is not None:
        assert end.t / 1e9 == pytest.approx(captured, abs=1e-9)
    assert active_in_every_slot(trace, delta) == profiles[: round(end.t / 1e9 / delta)]
    ours = np.array([[*sample.pursuers, sample.evader] for sample in samples])
    assert len(ours) == len(paths)
    assert ours == pytest.approx(paths, abs=1e-9)


@settings(max_examples=150, deadline=None)
@given(pursuits(), st.sampled_from(["revision", "change", "both"]))
def test_algorithm_2_is_the_plain_loop_step_for_step(case, trigger):
    """Trajectory, assignments and capture time to 1e-9, with the same draws, whenever word goes out."""
    count, steps = len(case["positions"]), round(case["horizon"] / case["delta"])
    slots = stream(case["seed"], "shared slots")
    blocks = [slots.integers(count, size=4096) for _ in range(1 + steps // 4096)]
    owners = [None, *chain.from_iterable(blocks)]
    draws = [stream(case["seed"], "decisions", i) for i in range(count)]
    result = simulated(case, SpatialAdaptivePlay(schedule=SharedSeed(slot=case["delta"])), trigger)
    compare(case, result, owners, draws)


@settings(max_examples=100, deadline=None)
@given(pursuits())
def test_algorithm_3_is_the_plain_loop_step_for_step(case):
    compare(case, simulated(case, Centralised(slot=case["delta"])))


def test_the_comparison_notices_a_pursuer_that_is_a_little_faster():
    """The control of the two tests above: a speed off by 1e-6 is seen."""
    case = {
        "positions": np.array([[0.0, 0.0], [9.0, 1.0]]),
        "evader": np.array([4.0, 4.0]),
        "speeds": np.array([1.0, 2.0]),
        "active": 1.0,
        "delta": 0.1,
        "horizon": 8.0,
        "seed": 1,
    }
    result = simulated(case, Centralised(slot=0.1))
    with pytest.raises(AssertionError):
        compare(case | {"speeds": np.array([1.0, 2.000001])}, result)
    compare(case, result)


def test_every_decision_is_broadcast_to_everyone_and_arrives_at_once():
    case = {
        "positions": np.random.default_rng(1).uniform(0, 20, (6, 2)),
        "evader": np.array([10.0, 10.0]),
        "speeds": np.ones(6),
        "active": 1.0,
        "delta": 0.1,
        "horizon": 5.0,
        "seed": 2,
    }
    trace = simulated(case, SpatialAdaptivePlay(schedule=SharedSeed(slot=0.1))).trace
    decided, told = trace.of(Decided), trace.of(Broadcast)
    assert [(d.t, d.pursuer, d.active) for d in decided] == [(b.t, b.src, b.body.active) for b in told]
    assert all(b.arrival == (b.t,) and len(b.dst) == 5 for b in told)
    assert len(decided) == 49


@pytest.mark.parametrize("speed", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("test", ["segment", "sample"])
def test_one_pursuer_captures_after_the_closed_form(speed, test):
    """(d - eps) / (v - v_e) with d = 5, eps = 0.1, v_e = 0.9; sampled, the next multiple of h = 1 ms."""
    scenario = Scenario(
        horizon=60.0,
        team=Team(positions=[(0.0, 0.0)], speeds=speed),
        evader=Evader(position=(3.0, 4.0)),
        capture=Capture(test=test),
        motion=Motion(step=0.001),
        protocol=Centralised(),
        record=Recording(trajectory=0.0),
    )
    exact = 4.9 / (speed - 0.9)
    found = summary(run(scenario)).capture_time
    if test == "segment":
        assert found == pytest.approx(exact, abs=1e-8)
    else:
        assert 0.0 <= found - exact <= 0.001 + 1e-9


PHI = (1.0, 2.0, 4.0, 8.0)
RELAY = profiles(4).index((True, False, False, False))


def static_game(protocol):
    """Four pursuers of speed 1 at distances phi + eps of an evader that stands still; nobody moves, r = 25 s."""
    return Scenario(
        horizon=25.0,
        team=Team(positions=[(phi + 0.1, 0.0) for phi in PHI], speeds=1.0),
        evader=Evader(position=(0.0, 0.0), speed=0.0),
        motion=Motion(frozen=True),
        protocol=protocol,
        record=Recording(trajectory=0.0),
    )


def laws(scenario, seeds):
    """Return for each seed the share of decision instants after which each profile stood; 1 s of burn-in left out."""
    shares = []
    for seed in seeds:
        active, counts, now = [True] * len(PHI), Counter(), 0
        for decision in run(scenario, seed).trace.of(Decided):
            if now != decision.t > 10**9:
                counts[tuple(active)] += 1
            now, active[decision.pursuer] = decision.t, decision.active
        shares.append([counts[profile] / counts.total() for profile in profiles(len(PHI))])
    return np.array(shares)


def distance(p, q):
    """Return the total variation between two laws."""
    return np.abs(p - q).sum() / 2


@pytest.mark.slow
@pytest.mark.parametrize(("tau", "relay"), [(1.0, 0.3452), (0.5, 0.6041), (0.2, 0.9168)])
def test_the_running_simulator_follows_the_gibbs_law(tau, relay):
    """800,000 decisions under Poisson clocks over instant links: total variation below 0.01.

    The standard error of P(relay) is that of the means of eight seeds. The control, the law of a temperature that is
    20 % off, is farther away.
    """
    protocol = SpatialAdaptivePlay(tau=ConstantTau(value=tau), schedule=Poisson(rate=1000.0))
    found = laws(static_game(protocol), range(8))
    law, error = found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert distance(law, gibbs(PHI, 25.0, tau)) < 0.01
    assert distance(law, gibbs(PHI, 25.0, 1.2 * tau)) > 0.01
    assert distance(law, gibbs(PHI, 25.0, 0.8 * tau)) > 0.01
    assert error[RELAY] < 0.004
    assert law[RELAY] == pytest.approx(relay, abs=4 * error[RELAY])


@pytest.mark.slow
@pytest.mark.parametrize(("tau", "relay"), [(1.0, 0.2286), (0.5, 0.4930), (0.2, 0.9037)])
def test_when_everybody_decides_at_once_the_law_is_another(tau, relay):
    """Four at every instant, each by what was said the instant before: not the Gibbs law, but an exact chain's."""

    def all_at_once(me):
        for k in range(1, 25_000):
            yield me.at(k * 0.001)
            me.assign(me.rng.random() < logit([0.0, me.gain()], 1.0 / tau)[1])
            me.announce()

    late = Links(latency=Constant(value=0.0005))
    found = laws(static_game(all_at_once).model_copy(update={"network": late}), range(5))
    error = found.std(axis=0, ddof=1)[RELAY] / np.sqrt(len(found))
    assert error < 0.005
    assert found.mean(axis=0)[RELAY] == pytest.approx(relay, abs=4 * error + 1e-3)
    assert abs(relay - gibbs(PHI, 25.0, tau)[RELAY]) > 4 * error + 1e-3
