"""Filters of noisy sightings: gains, order, consistency, and the fusion of tracks that share information."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desim.kernel.core.units import SECOND
from desim.pursuit.sensing.correction import (
    _rounding_error,
    corrected_by_position,
    corrected_by_state,
    decorrelated,
)
from desim.pursuit.sensing.fusion import determinant_of, fused, fused_by_corrections, informed, inverse
from desim.pursuit.sensing.noise import Covariance, PositionNoise, RangeBearingNoise
from desim.pursuit.sensing.tracking import (
    AlphaBeta,
    Filter,
    Kalman,
    Measurement,
    Track,
    merged,
    stationary_gains,
)

STEP = SECOND // 10
ISOTROPIC = Covariance(0.25, 0.0, 0.25)
BAND = 3.255, 4.821
"""95 % interval of the mean of 50 chi-square variables with 4 degrees of freedom (Bar-Shalom et al. 2001, 5.4.2)."""


@pytest.mark.parametrize("index", [0.1, 1.0, 10.0])
def test_the_gains_are_those_of_a_stationary_kalman_filter(index):
    """The covariance of a filter of one coordinate, by numpy, after so many sightings that it stays as it is."""
    f, push = np.array([[1.0, 1.0], [0.0, 1.0]]), index**2 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    covariance = np.eye(2)
    for _ in range(500):
        covariance = f @ covariance @ f.T + push
        gain = covariance[:, 0] / (covariance[0, 0] + 1.0)
        covariance = covariance - np.outer(gain, covariance[0])
    assert stationary_gains(index) == pytest.approx(tuple(gain), rel=1e-9)


@pytest.mark.parametrize("model", [AlphaBeta(), Kalman()], ids=lambda model: model.kind)
def test_a_track_begins_at_rest_where_the_evader_was_measured(model):
    assert model.start(Measurement(5, 0, 3.0, -4.0, ISOTROPIC))[:2] == (5, (3.0, -4.0, 0.0, 0.0))


TRIANGLE = np.triu_indices(4)


def upper(matrix):
    """Return the upper triangle of the covariance of a state, row by row."""
    return tuple(np.array(matrix)[TRIANGLE].tolist())


def whole(triangle):
    """Return the (4, 4) covariance of a state, given its upper triangle."""
    matrix = np.zeros((4, 4))
    matrix[TRIANGLE] = triangle
    return matrix + matrix.T - np.diag(matrix.diagonal())


def spread(rng, size):
    """Return a random covariance whose standard deviations differ by up to a factor of 10."""
    root = rng.normal(size=(size, size)) * 10.0 ** rng.uniform(-1, 0, size)
    return root @ root.T + 1e-3 * np.eye(size)


def dot(a, b):
    """Return the product of two vectors, summed from the first entry on."""
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += x * y
    return total


def corrected(state, covariance, seen, errors):
    """Return a state and its covariance after a measurement of its first entries, with matrices that are lists."""
    before = [line[i] for i, line in enumerate(covariance)]
    for row, entry, variance in decorrelated(seen, errors):
        spread = [dot(line, row) for line in covariance]
        total = dot(spread, row) + variance
        if total <= _rounding_error(row, before):  # the state is as exact as the number, up to rounding
            continue
        gain = [entry / total for entry in spread]
        off, n = entry - dot(row, state), range(4)
        left = [[covariance[i][j] - gain[i] * spread[j] for j in n] for i in n]
        kept = [dot(line, row) for line in left]
        above = {(i, j): left[i][j] - kept[i] * gain[j] + variance * gain[i] * gain[j] for i in n for j in n[i:]}
        state = [x + k * off for x, k in zip(state, gain, strict=True)]
        covariance = [[above[min(i, j), max(i, j)] for j in n] for i in n]
    return state, covariance


@given(st.integers(0, 2**32), st.sampled_from([(4, 2), (4, 4)]))
def test_a_measurement_corrects_a_state_by_the_textbook(seed, sizes):
    """x + K (z - H x) and P - K H P with K = P H' (H P H' + R)^-1, by numpy (Bar-Shalom et al. 2001, 5.2.3)."""
    rng, (n, k) = np.random.default_rng(seed), sizes
    state, seen, p, r = rng.normal(size=n), rng.normal(size=k), spread(rng, n), spread(rng, k)
    gain = p[:, :k] @ np.linalg.inv(p[:k, :k] + r)
    moved, covariance = corrected(state.tolist(), p.tolist(), seen.tolist(), r.tolist())
    assert np.allclose(moved, state + gain @ (seen - state[:k]), atol=1e-9)
    assert np.allclose(covariance, p - gain @ p[:k], atol=1e-9)


@given(st.integers(0, 2**32), st.floats(-5.0, 5.0))
def test_a_covariance_is_predicted_by_the_textbook(seed, t):
    """F P F' + Q of the continuous white noise acceleration (Bar-Shalom et al. 2001, 6.2.2), also backwards."""
    p, eye = spread(np.random.default_rng(seed), 4), np.eye(2)
    f = np.block([[eye, t * eye], [0 * eye, eye]])
    push = 4.0 * np.kron([[abs(t) ** 3 / 3, t * abs(t) / 2], [t * abs(t) / 2, abs(t)]], eye)
    stamp = round(t * SECOND)
    found = Kalman(velocity_diffusion=2.0).predict(Track(0, (0.0,) * 4, upper(p)), stamp).covariance
    assert np.allclose(whole(found), f @ p @ f.T + push, rtol=1e-6, atol=1e-6)


@given(st.integers(0, 2**32), st.integers(1, 5 * SECOND), st.integers(1, 5 * SECOND))
def test_a_prediction_does_not_depend_on_the_times_in_between(seed, first, second):
    track, model = Track(0, (1.0, 2.0, 3.0, 4.0), upper(spread(np.random.default_rng(seed), 4))), Kalman()
    at_once, by_halves = (
        model.predict(track, first + second),
        model.predict(model.predict(track, first), first + second),
    )
    assert by_halves.state == pytest.approx(at_once.state)
    assert np.allclose(by_halves.covariance, at_once.covariance)


def test_the_key_of_the_filters_that_depended_on_the_interval_is_refused_with_the_new_one():
    for model in (AlphaBeta, Kalman):
        with pytest.raises(ValueError, match=r"use velocity_diffusion instead, in m/s per sqrt\(s\)"):
            model(acceleration=1.0)


NEARLY_EXACT = [
    RangeBearingNoise(range=0.0, bearing=0.05),
    RangeBearingNoise(range=0.0, bearing=0.7),
    RangeBearingNoise(range=1e-6, bearing=0.3),
    RangeBearingNoise(range=0.3, bearing=0.0),
    RangeBearingNoise(range=0.0, bearing=0.0),
    *(PositionNoise(deviation=deviation) for deviation in (0.0, 1e-12, 1e-9, 1e-6, 1.0)),
]


def is_positive(covariance):
    """Return whether a matrix is symmetric, and none of its eigenvalues is negative beyond rounding."""
    found = np.array(covariance)
    values = np.linalg.eigvalsh(found)
    return (found == found.T).all() and found.diagonal().min() > 0.0 and values[0] >= -1e-15 * values[-1]


@pytest.mark.slow
@settings(max_examples=20)
@given(st.integers(0, 2**32))
def test_every_covariance_is_positive_however_exact_the_sightings_are(seed):
    updates(seed, 10)


def singular(rng, size):
    """Return a random covariance of rank 1, of which the standard deviations differ by up to a factor of 10^9."""
    root = rng.normal(size=size) * 10.0 ** rng.uniform(-6, 3, size)
    return np.outer(root, root)


def test_an_exact_measurement_of_an_exact_position_counts_however_uncertain_the_velocity_is():
    """Variances of 1e-16 m^2 are no rounding error of 1e4 (m/s)^2: the state moves half-way."""
    before = (1e-16, 0.0, 0.0, 0.0, 1e-16, 0.0, 0.0, 1e4, 0.0, 1e4)
    moved, after = corrected_by_position((0.0,) * 4, before, (1e-8, -3e-8), (1e-16, 0.0, 1e-16))
    assert moved == pytest.approx((5e-9, -1.5e-8, 0.0, 0.0), rel=1e-12, abs=0.0)
    assert (after[0], after[4]) == pytest.approx((5e-17, 5e-17), rel=1e-12, abs=0.0)


def test_a_covariance_of_rank_one_stays_positive_after_a_measurement_of_rank_one():
    rng = np.random.default_rng(1)
    for _ in range(300):
        before = singular(rng, 4)
        _, after = corrected([0.0] * 4, before.tolist(), [0.0] * 4, singular(rng, 4).tolist())
        assert np.linalg.eigvalsh(np.array(after))[0] > -1e-12 * np.trace(before)


@given(st.integers(0, 2**32), st.sampled_from([spread, singular]), st.sampled_from([spread, singular]))
def test_a_state_corrected_by_a_state_is_that_corrected_entry_by_entry(seed, spread_before, spread_of_errors):
    """To the last bit, also if a covariance is singular, or all variances are equal."""
    rng = np.random.default_rng(seed)
    state, seen = rng.normal(size=(2, 4)).tolist()
    eye = np.diag(rng.choice([0.0, 0.25, 1.0], size=4)).tolist()
    for before, errors in (
        (spread_before(rng, 4).tolist(), spread_of_errors(rng, 4).tolist()),
        (spread_before(rng, 4).tolist(), eye),
        (eye, spread_of_errors(rng, 4).tolist()),
    ):
        moved, covariance = corrected(state, before, seen, errors)
        assert corrected_by_state(state, upper(before), seen, upper(errors)) == (tuple(moved), upper(covariance))
        place, of_place = seen[:2], [line[:2] for line in errors[:2]]
        moved, covariance = corrected(state, before, place, of_place)
        xx, xy, yy = of_place[0][0], of_place[0][1], of_place[1][1]
        by_position = corrected_by_position(state, upper(before), place, (xx, xy, yy))
        assert by_position == (tuple(moved), upper(covariance))


@pytest.mark.whole
def test_thousands_of_covariances_are_positive():
    for seed in range(40):
        updates(seed, 80)


def updates(seed, count):
    """Check merged sightings, tracks and fusions at random places, times and noises."""
    rng = np.random.default_rng(seed)
    model = Kalman(velocity_diffusion=float(10.0 ** rng.uniform(-6, 2)))
    place, stamp, track, other = rng.normal(size=2) * 10.0 ** rng.uniform(-1, 4), 0, None, None

    def seen():
        noise = NEARLY_EXACT[rng.integers(len(NEARLY_EXACT))]
        offset = complex(*rng.normal(size=2)) * float(10.0 ** rng.uniform(-1, 2))
        return Measurement(stamp, 0, *place.tolist(), noise.covariance(offset))

    for _ in range(count):
        sighting = seen()
        for _ in range(rng.integers(3)):
            sighting = merged(sighting, seen())
            xx, xy, yy = sighting.covariance
            assert is_positive([[xx, xy], [xy, yy]])
        track = model.start(sighting) if track is None else model.update(track, sighting)
        assert is_positive(whole(track.covariance))
        other = track if other is None or rng.random() < 0.1 else model.predict(other, stamp)
        for how in ("naive", "covariance_intersection"):
            assert is_positive(whole(fused([informed(track), informed(other)], how).covariance))
        stamp += int(10.0 ** rng.uniform(6, 11))


def course(rng, count, state, diffusion):
    """Return the (count, 4) true states of an evader whose velocity diffuses, at intervals of `STEP`."""
    t = STEP / SECOND
    root = diffusion * np.linalg.cholesky([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
    states = [np.array(state)]
    for _ in range(count - 1):
        x, y, vx, vy = states[-1]
        states.append(np.array([x + t * vx, y + t * vy, vx, vy]) + (root @ rng.standard_normal((2, 2))).ravel())
    return states


def sightings(seed, count, *, noise=ISOTROPIC, observer=0):
    """Return sightings of an evader whose velocity diffuses, and its true states."""
    rng = np.random.default_rng(seed)
    states = course(rng, count, [5.0, -3.0, 1.0, 0.5], Kalman().velocity_diffusion)
    root = np.linalg.cholesky([[noise.xx, noise.xy], [noise.xy, noise.yy]])
    places = [state[:2] + root @ rng.standard_normal(2) for state in states]
    return [Measurement(k * STEP, observer, x, y, noise) for k, (x, y) in enumerate(places)], states


def filtered(model, seen, window=100 * SECOND):
    made = Filter(model, window)
    for each in seen:
        made.add(each)
    return made


def nees(track, state):
    """Return the normalised estimation error squared."""
    error = np.array(track.state) - state
    return float(error @ np.linalg.solve(whole(track.covariance), error))


def nis(track, seen):
    """Return the normalised innovation squared of a sighting after a track."""
    _, state, covariance = Kalman().predict(track, seen.stamp)
    noise = seen.covariance
    innovation = np.array([seen.x, seen.y]) - state[:2]
    expected = whole(covariance)[:2, :2] + [[noise.xx, noise.xy], [noise.xy, noise.yy]]
    return float(innovation @ np.linalg.solve(expected, innovation))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [ISOTROPIC, Covariance(0.5, 0.3, 0.4)])
def test_the_errors_of_a_kalman_filter_are_as_large_as_it_says(noise):
    """The mean of 50 runs of 4 squared errors is in its 95 % band; the control assumes a third of the noise."""
    small = Covariance(*(each / 9 for each in noise))
    errors, control, innovations = [], [], []
    for seed in range(50):
        seen, states = sightings(seed, 40, noise=noise)
        errors.append(nees(filtered(Kalman(), seen).track, states[-1]))
        sure = [each._replace(covariance=small) for each in seen]
        control.append(nees(filtered(Kalman(), sure).track, states[-1]))
        innovations.append(nis(filtered(Kalman(), seen[:-1]).track, seen[-1]))
    assert BAND[0] < np.mean(errors) < BAND[1]
    assert np.mean(control) > BAND[1]
    assert abs(np.mean(innovations) - 2.0) < 3 * np.sqrt(4.0 / 50)


def first_order(noise, offset):
    """Return the covariance of a range and a bearing to first order, and the rotated matrix it comes from."""
    turn = offset / abs(offset)
    rotation = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
    xx, xy, _, yy = (rotation @ np.diag([noise.range**2, (noise.bearing * abs(offset)) ** 2]) @ rotation.T).ravel()
    return Covariance(xx, xy, yy)


def tracked_from_afar(seed, observers, *, is_biased=False):
    """Return the error of a track along x, m, and the normalised squared error, after sightings at 20 m.

    There are 20 sightings of each of several observers, or 40 of a single one, whose first second is still biased.

    The biased way is the conversion at the measured bearing, with the covariance to first order there.
    """
    rng, noise, model = np.random.default_rng(seed), RangeBearingNoise(range=0.3, bearing=0.1), Kalman()
    states = course(rng, 40 if observers == 1 else 20, [20.0, 0.0, 0.5, 0.3], model.velocity_diffusion)
    made = Filter(model, 100 * SECOND, None if is_biased else noise.covariance)
    for k, state in enumerate(states):
        for observer in range(observers):
            origin = complex(0.0, 0.3 * observer)
            seen = noise(complex(*state[:2]) - origin, *rng.standard_normal(2).tolist())
            if is_biased:
                seen *= np.exp(-(noise.bearing**2) / 2)
            covariance = first_order(noise, seen) if is_biased else noise.covariance(seen)
            place = seen + origin
            made.add(Measurement(k * STEP, observer, place.real, place.imag, covariance, origin.real, origin.imag))
    error = np.array(made.track.state) - states[-1]
    return error[0], nees(made.track, states[-1])


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("observers", [1, 6])
def test_a_range_and_a_bearing_give_an_unbiased_track(observers):
    """At 20 m with .3 m and .1 rad: the normalised squared error is in its band, and the mean error is within chance.

    Control: the conversion at the measured bearing. Its ellipses meet beyond the arc of the sightings, r s^2 / 2 =
    .1 m too far (Bar-Shalom & Li 1995, section 1.6.2: it is consistent only if r s^2 / s_r < .4; here .67).
    """
    errors, squares = np.array([tracked_from_afar(seed, observers) for seed in range(50)]).T
    biased, control = np.array([tracked_from_afar(seed, observers, is_biased=True) for seed in range(50)]).T
    assert BAND[0] < squares.mean() < BAND[1] < control.mean()
    standard_error = errors.std() / np.sqrt(50)
    assert abs(errors.mean()) < 3 * standard_error
    assert biased.mean() > 3 * standard_error


@pytest.mark.parametrize("model", [AlphaBeta(), Kalman()])
def test_sightings_of_one_time_are_merged_by_their_inverse_covariances(model):
    """Three equal ones are their mean, with a third of the covariance; in any order of arrival."""
    rng, (seen, _) = np.random.default_rng(4), sightings(2, 12)
    several, one = [], []
    for each in seen:
        errors = rng.normal(size=(3, 2)).tolist()
        several += [each._replace(observer=k, x=each.x + dx, y=each.y + dy) for k, (dx, dy) in enumerate(errors)]
        dx, dy = np.mean(errors, axis=0)
        third = Covariance(*(value / 3.0 for value in each.covariance))
        one.append(each._replace(x=each.x + dx, y=each.y + dy, covariance=third))
    track = filtered(model, one).track
    for order in (range(len(several)), rng.permutation(len(several)).tolist()):
        found = filtered(model, [several[k] for k in order]).track
        assert found.state == pytest.approx(track.state, rel=1e-9)


def test_a_sighting_as_old_as_the_window_still_has_a_track_before_it():
    seen, _ = sightings(6, 31)
    window = seen[-1].stamp - seen[-11].stamp
    late = seen[-11]._replace(observer=1, x=seen[-11].x + 0.4)
    whole = filtered(Kalman(), [*seen, late]).track
    assert filtered(Kalman(), [*seen, late], window).track == whole
    assert filtered(Kalman(), [*seen, late], window - 1).track == filtered(Kalman(), seen).track != whole


def test_merged_sightings_are_a_kalman_filter_of_each_by_itself():
    """Of other covariances: one is sure along x, the other along y."""
    (first, _, last), _ = sightings(5, 3)
    other = last._replace(observer=1, x=last.x + 0.5, covariance=Covariance(0.1, 0.05, 2.0))
    by_itself = Kalman().start(first)
    for each in (last._replace(covariance=Covariance(3.0, -0.2, 0.2)), other):
        by_itself = Kalman().update(by_itself, each)
    found = filtered(Kalman(), [first, last._replace(covariance=Covariance(3.0, -0.2, 0.2)), other]).track
    assert found.state == pytest.approx(by_itself.state, rel=1e-9)
    assert found.covariance == pytest.approx(by_itself.covariance, rel=1e-9)


@pytest.mark.slow
def test_the_alpha_beta_filter_is_the_stationary_kalman_filter():
    """After 200 sightings at equal intervals both have the same gains; with another acceleration they differ."""
    seen, _ = sightings(3, 200)
    tracks = [filtered(model, seen).track for model in (AlphaBeta(), Kalman(), AlphaBeta(velocity_diffusion=1.0))]
    assert tracks[0].state == pytest.approx(tracks[1].state, abs=1e-6)
    assert tracks[2].state != pytest.approx(tracks[1].state, abs=1e-2)


@pytest.mark.parametrize("model", [AlphaBeta(), Kalman()])
def test_sightings_in_any_order_and_twice_give_the_track_of_those_in_order(model):
    seen, _ = sightings(1, 5)
    in_order = filtered(model, seen).track
    for order in permutations(seen):
        assert filtered(model, [*order, order[0]]).track == in_order


@pytest.mark.slow
@given(st.lists(st.integers(0, 400), min_size=20, max_size=20), st.integers(0, 9))
def test_a_filter_of_late_sightings_equals_one_without_latency_a_latency_ago(delays, seed):
    """Sighting k arrives after up to 0.4 s: once all up to an instant have arrived, the track there is the same."""
    seen, _ = sightings(seed, 20)
    late = sorted(seen, key=lambda each: each.stamp + delays[each.stamp // STEP] * SECOND // 1000)
    model, made, plain = Kalman(), Filter(Kalman(), 100 * SECOND), Filter(Kalman(), 100 * SECOND)
    for each in late:
        made.add(each)
    for each in seen:
        plain.add(each)
    assert made.track == plain.track
    assert made.at(25 * STEP) == model.predict(plain.track, 25 * STEP)


def test_what_is_older_than_the_window_is_ignored():
    seen, _ = sightings(1, 30)
    made = filtered(Kalman(), seen[3:], window=5 * STEP)
    before = made.track
    made.add(seen[0])
    assert made.track == before
    assert len(made._sightings) <= 7
    assert before == filtered(Kalman(), seen[3:]).track


def exchanged(seed, how, rounds=20):
    """Return the track of the first of two observers that fuse each other's fused tracks, and the true state."""
    one, states = sightings(seed, rounds)
    rng = np.random.default_rng([seed, 1])
    other = [
        Measurement(each.stamp, 1, *(state[:2] + 0.5 * rng.standard_normal(2)), ISOTROPIC)
        for each, state in zip(one, states, strict=True)
    ]
    model = Kalman()
    tracks = [model.start(one[0]), model.start(other[0])]
    for pair in zip(one[1:], other[1:], strict=True):
        tracks = [model.update(track, each) for track, each in zip(tracks, pair, strict=True)]
        known = [informed(track) for track in tracks]
        tracks = [fused(known, how), fused(known[::-1], how)]
    return tracks[0], states[-1]


@pytest.mark.slow
def test_naive_fusion_of_shared_information_is_overconfident_and_covariance_intersection_is_not():
    """50 runs: the mean squared error is above its band, by far, and with the intersection not above it."""
    ways = ("naive", "covariance_intersection")
    mean = {how: np.mean([nees(*exchanged(seed, how)) for seed in range(50)]) for how in ways}
    assert mean["naive"] > 2 * BAND[1]
    assert mean["covariance_intersection"] < BAND[1]


def test_the_fusion_of_independent_tracks_is_their_weighted_mean():
    """Variances 1 and 4 give 0.8; the intersection, with weights 256 to 1, is no surer than the better track."""
    eye = np.eye(4)
    one, other = Track(0, (0.0,) * 4, upper(eye)), Track(0, (10.0,) * 4, upper(4 * eye))
    known = [informed(one), informed(other)]
    naive, safe = fused(known, "naive"), fused(known, "covariance_intersection")
    assert naive.state == pytest.approx([2.0] * 4)
    assert np.allclose(whole(naive.covariance), 0.8 * eye)
    assert safe.state == pytest.approx([2.5 / 256.25] * 4)
    assert np.allclose(whole(safe.covariance), 257 / 256.25 * eye)


def intersected(covariances, measure):
    """Return the covariance of an intersection by numpy, one by one, with weights inverse to a measure."""
    first, *others = covariances
    for other in others:
        w = measure(other) / (measure(first) + measure(other))
        first = np.linalg.inv(w * np.linalg.inv(first) + (1 - w) * np.linalg.inv(other))
    return first


@given(st.integers(0, 2**32), st.floats(-3.0, 3.0), st.floats(0.0, 6.0))
def test_an_intersection_is_the_same_in_another_unit_of_time_and_along_other_axes(seed, exponent, turn):
    """The covariance is that of numpy, in the first units."""
    rng = np.random.default_rng(seed)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    change = np.kron(np.diag([1.0, 10.0**exponent]), rotation)
    covariances = [spread(rng, 4) for _ in range(3)]
    there = [informed(Track(0, (0.0,) * 4, upper(change @ p @ change.T))) for p in covariances]
    expected = change @ intersected(covariances, np.linalg.det) @ change.T
    scale = np.outer(*[np.sqrt(expected.diagonal())] * 2)
    assert np.allclose(whole(fused(there, "covariance_intersection").covariance) / scale, expected / scale, atol=1e-6)


def test_weights_by_traces_depend_on_the_unit_of_time():
    """The control of the test before."""
    rng, change = np.random.default_rng(1), np.diag([1.0, 1.0, 60.0, 60.0])
    covariances = [spread(rng, 4) for _ in range(3)]
    for measure, is_free in ((np.linalg.det, True), (np.trace, False)):
        expected = change @ intersected(covariances, measure) @ change
        there = intersected([change @ p @ change for p in covariances], measure)
        assert np.allclose(there, expected, rtol=1e-3) is is_free


@given(st.integers(0, 2**32), st.integers(1, 7), st.sampled_from(["naive", "covariance_intersection"]))
def test_tracks_that_are_fused_by_information_are_those_that_are_corrected(seed, count, how):
    """To 1e-9 of the largest entry of the state and of the variances; to the last bit where one is nearly singular."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-100.0, 100.0, size=4) * [1.0, 1.0, 0.01, 0.01]
    covariances = [spread(rng, 4) for _ in range(count)]
    states = [rng.multivariate_normal(truth, covariance).tolist() for covariance in covariances]
    tracks = [Track(7, tuple(state), upper(p)) for state, p in zip(states, covariances, strict=True)]
    quick, plain = fused([informed(track) for track in tracks], how), fused_by_corrections(tracks, how)
    assert quick.stamp == plain.stamp == 7
    assert np.allclose(quick.state, plain.state, rtol=0.0, atol=1e-9 * np.abs(plain.state).max())
    deviations = np.sqrt(whole(plain.covariance).diagonal())
    assert (
        np.abs(whole(quick.covariance - np.array(plain.covariance))) <= 1e-9 * np.outer(deviations, deviations)
    ).all()
    exact = [*tracks, Track(7, tracks[0].state, upper(singular(rng, 4)))]
    assert informed(exact[-1]).information is None
    assert fused([informed(track) for track in exact], how) == fused_by_corrections(exact, how)


@given(st.integers(0, 2**32))
def test_a_covariance_is_inverted_in_closed_form_unless_it_is_nearly_singular(seed):
    matrix = spread(np.random.default_rng(seed), 4)
    inverted = inverse(upper(matrix))
    share = np.linalg.det(matrix) / matrix.diagonal().prod()
    assert determinant_of(upper(matrix)) == pytest.approx(np.linalg.det(matrix), rel=1e-6)
    if inverted is None:
        assert share < 1.01e-4
    else:
        assert share > 0.99e-4
        assert np.allclose(whole(inverted[0]) @ matrix, np.eye(4), atol=1e-6)
        assert inverted[1] == pytest.approx(np.linalg.det(matrix), rel=1e-9)
    assert inverse(upper(np.zeros((4, 4)))) is None
