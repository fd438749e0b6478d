"""Teams whose eyes err: what a pursuer knows, reports and forgets, and that captures follow the truth."""

from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest

from desim import Scenario, run, summary
from desim.kernel.core.events import Sent
from desim.kernel.core.units import SECOND
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Estimated, Sampled
from desim.pursuit.motion.environment import Environment
from desim.pursuit.motion.flow import SteadyFlow
from desim.pursuit.sensing.noise import PositionNoise, RangeBearingNoise, covariance_of
from desim.pursuit.sensing.noisy_sensing import NoisySensor, Sighted, Tracked
from desim.pursuit.sensing.sensing import Sensing, spiral
from desim.pursuit.sensing.tracking import AlphaBeta, Kalman
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import PROTOCOLS, Capture, Motion, Recording
from desim.testing.pursuits import watched
from protocols.local_min import LocalMin
from protocols.schedules.periodic import Poisson

NOISE = PositionNoise(deviation=0.3)


def scenario(sensing, **changes):
    given = {
        "team": Team(positions=[(0.0, 0.0), (9.0, 0.0), (0.0, 9.0)], speeds=1.5, active_at_start=0.0),
        "evader": Evader(position=(5.0, 5.0), strategy="constant_heading"),
        "protocol": LocalMin(schedule=Poisson(rate=5.0)),
        "sensing": sensing,
        "capture": Capture(radius=0.3),
        "record": Recording(messages=True),
    }
    return Scenario(**given | changes)


def looked(sensing, at, look, seed=1, **changes):
    """Return what a protocol sees that looks at some times, s; pursuers stay."""
    found = []

    def watch(me):
        for t in at:
            yield me.at(t)
            found.append(look(me))
        yield me.sleep(1e6)

    run(scenario(sensing, protocol=watch, **changes), seed, lambda event: event.t > (at[-1] + 0.05) * SECOND)
    return found


def sensed_covariance(entries):
    """Return the covariance that a sensor takes from the noise of a user."""
    noise = SimpleNamespace(covariance=lambda offset: entries)
    return covariance_of(noise, 1j)


@pytest.mark.parametrize(
    "entries",
    [(1, 2, 1), (1, -1, 1), (0, 0, 1), (-1, 0, -1), (1, 0, np.inf), (np.inf, 0, 1), (np.nan, 0, 1), (1, 0), 3],
)
def test_the_covariance_of_a_users_noise_is_positive_definite(entries):
    assert sensed_covariance(np.array([2, -1, 1])) == (2.0, -1.0, 1.0)
    with pytest.raises(ValueError, match=r"xx, xy and yy of a positive definite matrix, in m\^2, got"):
        sensed_covariance(entries)


def test_the_error_of_a_sighting_is_proportional_to_the_deviation():
    """All draws are the same; without an estimator the newest sighting holds."""
    still = {"evader": Evader(position=(5.0, 5.0), speed=0.0)}
    errors = []
    for deviation in (0.1, 0.2):
        sensing = Sensing(noise=PositionNoise(deviation=deviation), estimate="hold", period=1.0)
        errors.append(np.array(looked(sensing, [0.02, 0.07], lambda me: me.evader() - (5 + 5j), **still)))
    assert np.allclose(errors[1], 2 * errors[0])
    assert len(set(errors[0].tolist())) == 6


def test_pursuers_err_independently_of_each_other_and_of_the_sensing_range():
    sensing = [Sensing(noise=NOISE, estimate="hold", period=9.0, radius=radius) for radius in (7.5, np.inf)]
    near, all_of_them = (looked(each, [0.02], lambda me: me.evader()) for each in sensing)
    assert near == all_of_them
    assert len({round(abs(place - (5 + 5j)), 9) for place in near}) == 3


def test_the_order_in_which_tracks_arrive_does_not_count():
    """The fusion of three tracks depends on their order, which is that of their sources."""

    def fused_both_ways(me):
        view = me._view
        view._read_reports()
        reports, now = view._tracks[1], view._clock.stamp
        before = view._fuse(1, now)
        view._tracks[1] = dict(reversed(reports.items()))
        return len(reports), before == view._fuse(1, now)

    sensing = Sensing(noise=NOISE, estimator=Kalman(), fusion="covariance_intersection", period=0.1)
    assert looked(sensing, [0.5], fused_both_ways) == [(2, True)] * 3


@pytest.mark.parametrize(("flow", "speed"), [("none", 11.0), ({"kind": "uniform", "velocity": [3.0, 0.0]}, 14.0)])
def test_a_filter_begins_with_the_speed_of_the_evader_over_ground(flow, speed):
    """Its variance of the velocity after the first sighting, and after 0.02 s in which it grows by diffusion."""
    sensing = Sensing(noise=NOISE, estimator=Kalman(velocity_diffusion=1.0), period=9.0)
    fast = {"evader": Evader(position=(5.0, 5.0), speed=11.0), "environment": {"flow": flow}}
    variances = looked(sensing, [0.02], lambda me: me._view.track(1).covariance[7], **fast)
    assert variances == pytest.approx([speed**2 + 0.02] * 3)


@pytest.mark.parametrize("period", [9.0, 0.1])
@pytest.mark.parametrize("estimator", [AlphaBeta(), Kalman()])
def test_a_filter_is_nearer_to_the_truth_than_single_sightings(estimator, period):
    """Over 40 sightings of an evader of constant velocity; the mean error is below 3/4 of that of sightings.

    Reports of the two others, which see the evader at the same instants, reduce it further.
    """

    def error(me):
        return abs(me.evader() - me.global_state.evader(1))

    at = [0.5 + 0.05 * k for k in range(30)]
    plain = looked(Sensing(noise=NOISE, estimate="hold", period=9.0), at, error)
    estimated = looked(Sensing(noise=NOISE, estimator=estimator, period=period), at, error)
    assert np.mean(estimated) < (0.75 if period == 9.0 else 0.55) * np.mean(plain)


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    "noise",
    [
        PositionNoise(deviation=0.0),
        RangeBearingNoise(range=0.0, bearing=0.0),
        RangeBearingNoise(range=0.0, bearing=1e-3),
        RangeBearingNoise(range=0.01, bearing=0.0),
    ],
)
@pytest.mark.parametrize(
    ("estimator", "fusion"),
    [(AlphaBeta(), "by_stamp"), (Kalman(), "by_stamp"), (Kalman(), "naive"), (Kalman(), "covariance_intersection")],
)
def test_noise_may_be_zero(noise, estimator, fusion):
    """In one direction, or in both: then the estimate is the truth from the second sighting on."""
    sensing = Sensing(noise=noise, estimator=estimator, fusion=fusion, period=0.1)
    at = [0.26 + 0.05 * k for k in range(20)]
    errors = looked(sensing, at, lambda me: abs(me.evader() - me.global_state.evader(1)))
    is_exact = not any(dict(noise)[key] for key in dict(noise) if key != "kind")
    assert max(errors) < (1e-4 if is_exact else 0.1)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("estimator", [AlphaBeta(), Kalman()])
def test_a_range_may_be_exact_in_every_run(estimator):
    sensing = Sensing(noise=RangeBearingNoise(range=0.0, bearing=0.3), estimator=estimator)
    for seed in range(8):
        assert run(Scenario(team=Team(count=6), sensing=sensing, horizon=1.0), seed).trace


def test_a_reported_track_is_that_of_its_observer():
    """Pursuer 1 sees nothing: what it estimates is what pursuer 0 does, unless a sighting is newer than the report."""
    sensing = Sensing(radius=9.0, noise=NOISE, estimator=Kalman(), fusion="naive", interval=0.2, period=0.02)
    team = Team(positions=[(0.0, 0.0), (40.0, 40.0)], speeds=1.5, active_at_start=0.0)
    case = scenario(sensing, team=team, record=Recording(trajectory=0.05, estimates=True), horizon=1.5)
    by_time = {}
    for event in run(case, 1).trace.of(Estimated):
        by_time.setdefault(event.t, {})[event.pursuer] = event[3:]
    pairs = [each for each in by_time.values() if len(each) == 2]
    alike = sum(one == other for one, other in (each.values() for each in pairs))
    assert len(pairs) > 20
    assert alike >= 0.6 * len(pairs)


def test_decisions_count_the_mean_distance():
    """Beside the evader the mean distance is that of the errors, greater than that to the estimate."""
    sensing = Sensing(noise=NOISE, estimator=Kalman(), period=9.0)
    team = {"team": Team(positions=[(5.0, 5.3)], speeds=1.5, active_at_start=0.0), "capture": Capture(radius=1e-3)}
    place, phi = looked(sensing, [0.01], lambda me: (me.evader() - me.position(), me.capture_time()), **team)[0]
    assert phi > (abs(place) - 1e-3) / 0.6


@pytest.mark.parametrize(
    ("fusion", "kind", "size"), [("by_stamp", Sighted, 16 + 8 * 10), ("naive", Tracked, 16 + 8 * 16)]
)
def test_a_report_has_the_bytes_of_what_it_says(fusion, kind, size):
    """Evader, time, observer, 2 positions and 3 numbers of covariance; or evader, time, 4 of state and 10."""
    sensing = Sensing(noise=NOISE, estimator=Kalman(), fusion=fusion, period=0.1)
    result = run(scenario(sensing), 1, lambda event: event.t > 0.5 * SECOND)
    reports = [event for event in result.trace.of(Sent) if event.body and isinstance(event.body[0], kind)]
    assert reports
    assert {event.size for event in reports} == {size}


@pytest.mark.parametrize("fusion", ["by_stamp", "naive", "covariance_intersection"])
def test_reports_reach_a_pursuer_that_sees_nothing(fusion):
    """Two see the evader up to 7.5 m; the third, 30 m away, knows its place from reports, 0.2 s late."""
    far = {"team": Team(positions=[(3.0, 5.0), (5.0, 3.0), (30.0, 5.0)], speeds=1.5, active_at_start=0.0)}
    far["network"] = Links(latency=Constant(value=0.2))
    sensing = Sensing(noise=NOISE, estimator=Kalman(), fusion=fusion, period=0.1, radius=7.5)
    found = looked(sensing, [0.1, 1.5], lambda me: abs(me.evader() - me.global_state.evader(1)), **far)
    assert np.isnan(found[2])
    assert found[5] < 0.6


def test_a_pursuer_that_loses_its_memory_loses_its_tracks():
    """After a crash without memory of a lone pursuer out of range nothing is known any more."""
    team = {"team": Team(positions=[(0.0, 0.0)], speeds=1.5, active_at_start=0.0)}
    evader = {"evader": Evader(position=(2.9, 0.0), strategy={"kind": "constant_heading", "angle": 0.0})}
    sensing = Sensing(noise=PositionNoise(deviation=0.01), estimator=Kalman(), radius=3.0)
    for memory in (True, False):
        crash = Crash(node=0, start=1.0, end=1.5, memory=memory)
        found = []

        def watch(me, found=found):
            while True:
                yield me.sleep(0.2)
                found.append(bool(np.isnan(me.evader())))

        run(scenario(sensing, protocol=watch, fault=[crash], **team, **evader), 1, lambda event: event.t > 2 * SECOND)
        assert found[-1] is not memory


def test_a_pursuer_whose_track_is_too_old_stays_or_searches_from_where_the_track_ended():
    """The evader leaves at 0.2 s, so its track ends at 0.7 s; 0.1 s later the search is 0.15 m along its spiral."""
    team = {"team": Team(positions=[(0.0, 0.0)], speeds=1.5, active_at_start=0.0)}
    evader = {"evader": Evader(position=(2.9, 0.0), speed=0.5, strategy={"kind": "constant_heading", "angle": 0.0})}
    noise, estimator = PositionNoise(deviation=1e-6), Kalman(velocity_diffusion=1e-4)
    for on_lost in ("stay", "search"):
        sensing = Sensing(noise=noise, estimator=estimator, radius=3.001, track_timeout=0.5, on_lost=on_lost)
        before, after = looked(sensing, [0.6, 0.8], lambda me: me.evader(), **team, **evader)
        assert before == pytest.approx(2.9 + 0.5 * 0.6, abs=1e-3)
        assert bool(np.isnan(after)) is (on_lost == "stay")
    assert after - (2.9 + 0.5 * 0.7) == pytest.approx(spiral(0.15, 2.0 * 3.001), abs=1e-3)


@pytest.mark.slow
def test_captures_follow_the_truth():
    """A pursuer that stands where it believes the evader to be captures it only where it is."""
    result = run(scenario(Sensing(noise=PositionNoise(deviation=2.0), estimate="hold")), 3)
    assert summary(result).captured in {True, False}
    watched(scenario(Sensing(noise=PositionNoise(deviation=2.0), estimate="hold")), 3)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "wind"), [(0.9, 0.0), (90.0, 0.0), (0.9, 90.0)])
def test_the_first_tracks_of_an_evader_of_any_speed_are_as_exact_as_the_filter_says(speed, wind):
    """In 60 runs, the mean squared error of the second position, in units of the stated one, is 2 +- .26, or less."""
    sensing = Sensing(noise=NOISE, interval=0.1, estimator=Kalman())
    team, evader = Team(positions=[(999.0, 0.0)], speeds=0.0), Evader(speed=speed, strategy="constant_heading")
    flow = Environment(flow=SteadyFlow(velocity=(wind, 0.0)))
    record = Recording(trajectory=0.1, estimates=True)
    case = scenario(sensing, team=team, evader=evader, environment=flow, record=record, horizon=0.15)
    squares = []
    for seed in range(60):
        trace = run(case, seed).trace
        (_, _, _, x, y, *covariance), (place,) = trace.of(Estimated)[-1], trace.of(Sampled)[-1].evaders
        xx, xy, yy = covariance
        error = np.array([x, y]) - place
        squares.append(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
    assert np.mean(squares) < 2.0 + 4 * 0.26


@pytest.mark.whole
def test_less_noise_costs_less_time():
    """5 runs: with 0.01 m of noise the active time is that of exact sight within 5 %, with 1 m it is greater."""
    times = {}
    for deviation in (None, 0.01, 1.0):
        noise = {} if deviation is None else {"noise": PositionNoise(deviation=deviation), "estimator": Kalman()}
        case = scenario(Sensing(**noise), evader=Evader(position=(5.0, 5.0)), record=Recording(trajectory=0.0))
        times[deviation] = np.mean([summary(run(case, seed)).active_time for seed in range(5)])
    assert times[0.01] == pytest.approx(times[None], rel=0.05)
    assert times[1.0] > 1.1 * times[None]


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize(
    ("kind", "fusion"), [*zip(PROTOCOLS.choices(), cycle(["by_stamp", "covariance_intersection"]), strict=False)]
)
def test_every_protocol_bears_noise(kind, fusion):
    """Both ways to fuse reports in turn: a protocol does not know in which one its estimates were made."""
    noisy = Sensing(
        noise=RangeBearingNoise(), estimator=Kalman(), fusion=fusion, radius=6.0, relay=True, interval=0.1, period=0.2
    )
    case = scenario(
        noisy,
        protocol=PROTOCOLS.choice(kind)(),
        horizon=2.0,
        evader=(Evader(count=2),),
        motion=Motion(step=0.02),
        announce=Announcements(payload="state"),
        network=Links(latency=Constant(value=0.1)),
    )
    assert watched(case, 2).trace.events == run(case, 2).trace.events


@pytest.mark.slow
def test_recorded_estimates_change_nothing_and_are_the_tracks():
    """One for each pursuer that is up and has a track, at each sample; without covariances there are none."""
    sensing = Sensing(noise=NOISE, estimator=Kalman(), fusion="covariance_intersection")
    base = scenario(sensing, network=Links(latency=Constant(value=0.1)), horizon=2.0, fault=(Crash(node=2, start=1.0),))
    traces = [
        run(base.model_copy(update={"record": Recording(messages=True, estimates=estimates)}), 1).trace
        for estimates in (False, True)
    ]
    assert [each for each in traces[1] if not isinstance(each, Estimated)] == list(traces[0])
    found = traces[1].of(Estimated)
    samples = {event.t: event for event in traces[1].of(Sampled)}
    assert {(each.t, each.pursuer) for each in found} == {
        (t, pursuer) for t in samples for pursuer in (0, 1, 2) if pursuer < 2 or t < SECOND
    }
    unlike = [
        (complex(each.x, each.y) - complex(*samples[each.t].evaders[0])).real ** 2 / each.xx
        for each in found
        if each.t > SECOND / 2
    ]
    assert 0.1 < np.mean(unlike) < 2.0
    assert all(each.xx * each.yy > each.xy**2 for each in found)
    unfiltered = Sensing(noise=NOISE, estimate="hold")
    assert not run(scenario(unfiltered, record=Recording(estimates=True), horizon=0.2)).trace.of(Estimated)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("offset", [0.05, 0.0])
def test_predictions_that_are_shared_are_those_of_each_pursuer(offset, monkeypatch):
    """The same trace if the sensor forgets each prediction at once, also if one clock is wrong."""
    sensing = Sensing(noise=NOISE, estimator=Kalman(), fusion="naive")
    record = Recording(messages=True, estimates=True)
    clocks = (ClockSkew(offset=offset, node=0),) if offset else ()
    case = scenario(sensing, network=Links(latency=Constant(value=0.1)), horizon=0.5, fault=clocks, record=record)
    shared = list(run(case, 1).trace)
    predicted = NoisySensor.predicted

    def forgetting(sensor, reports, now):
        sensor._predicted_at = None
        return predicted(sensor, reports, now)

    monkeypatch.setattr(NoisySensor, "predicted", forgetting)
    assert list(run(case, 1).trace) == shared
    assert any(isinstance(event, Estimated) for event in shared)
