"""Interference against its theory, and by hand on two or three nodes."""

from math import exp, inf, pi, sin, sqrt
from typing import ClassVar

import networkx as nx
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, f, gamma, ncx2

from desim.config.errors import KeyedError
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import Broadcast, Lost, Trace
from desim.kernel.models.access import Aloha, Csma, CsmaCa
from desim.kernel.models.interference import (
    ISOLATION,
    CaptureEffect,
    Collision,
    Frame,
    LoRaInterference,
    LoRaSignal,
    Overlap,
    Sinr,
)
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate, LoRa
from desim.kernel.network import Network

US, MS = 1000, 1_000_000
"""Nanoseconds in a microsecond and a millisecond."""
SIZE = 100
"""Bytes of a frame that takes 1 ms at 800 kbit/s."""
REPLICATIONS = 7
"""Independent runs of each measurement, from which the standard error of their mean is estimated."""
NO_NODES = np.empty(0, dtype=np.int64)


def network(reception, places, *, access=None, medium=None, graph=None, seed=0, **links):
    """Return a clock, a network of nodes at some places (x, or (x, y), m) with frames of 1 ms, and its trace."""
    clock, trace = Clock(), Trace()
    positions = np.array([place if isinstance(place, tuple) else (place, 0.0) for place in places])
    radio = medium or Bitrate(bitrate=800_000.0, access=access or Aloha(), reception=reception)
    graph = nx.complete_graph(len(places)) if graph is None else graph
    net = Network(clock, graph, Links(medium=radio, **links), seed=seed, trace=trace, positions=lambda: positions)
    return clock, net, trace


def at(clock, t, act, *arguments, **named):
    """Let something happen at a time, us."""
    Instant(clock, round(t * US), Phase.DECISION).callbacks.append(lambda _: act(*arguments, **named))


def received(trace):
    """Return the sender and receiver of each broadcast that is received."""
    lost = {(each.transmission, each.dst) for each in trace.of(Lost)}
    return {
        (each.src, dst)
        for each in trace.of(Broadcast)
        for dst, _ in each.fates()
        if (each.transmission, dst) not in lost
    }


def causes(trace):
    return {(each.src, each.dst): each.cause for each in trace.of(Lost)}


def z_score(values, theory):
    """Return the distance of the mean of independent measurements from a theory, in standard errors of the mean."""
    values = np.asarray(values, dtype=float)
    return (values.mean() - theory) / (values.std(ddof=1) / sqrt(len(values)))


def judged(model, apart, seed=0, *, times=None, signals=None):
    """Return (k,) whether k receivers get frame 0 of m frames, given (m, k) distances; all frames overlap it."""
    rng = np.random.default_rng(seed)
    times = times or [(0, 1000)] * len(apart)
    frames = [Frame(n, n, n, *times[n], NO_NODES) for n in range(len(apart))]
    uniforms = rng.random(np.shape(apart))
    return model(
        Overlap(
            frames[0],
            np.arange(len(apart[0])),
            frames[1:],
            lambda frame: np.ones(len(apart[0]), dtype=bool),
            lambda frame: np.asarray(apart[frame.number], dtype=float),
            lambda frame: uniforms[frame.number],
            lambda frame: signals[frame.number],
        )
    )


# Capture.


@pytest.mark.slow
@pytest.mark.parametrize(("exponent", "number"), [(2.08, 0.13245), (3.0, 0.19905)])
def test_a_frame_survives_another_from_a_random_place_with_1_over_2_k_squared(exponent, number):
    """Two senders are uniform in a disc round the receiver, c = 6 dB, k = 10^(c / (10 n)).

    The standard error of 60 000 pairs is 0.0015. The control is a threshold of 7 dB, of the model or of the formula:
    0.1064 and 0.1707.
    """

    def theory(threshold):
        return 0.5 / 10 ** (2 * threshold / (10 * exponent))

    apart = np.sqrt(np.random.default_rng(1).random((2, 60_000)))
    found = judged(CaptureEffect(exponent=exponent), apart)
    other = judged(CaptureEffect(exponent=exponent, threshold=7.0), apart)
    assert theory(6.0) == pytest.approx(number, abs=1e-5)
    assert abs(z_score(found, number)) < 3
    assert z_score(found, theory(7.0)) > 3
    assert z_score(other, number) < -3
    assert abs(z_score(other, theory(7.0))) < 3


@pytest.mark.slow
def test_a_network_captures_as_often_as_the_formula_says():
    """200 receivers, one after the other, each with two senders of its own that start together: n = 3, 0.19905.

    The standard error of 1400 pairs is 0.011. The control is `collision`, which receives none of 200 pairs.
    """
    found, none = [], 0
    for seed in range(REPLICATIONS):
        rng = np.random.default_rng(seed)
        angle, apart = 2 * pi * rng.random(400), np.sqrt(rng.random(400))
        places = [(1e6 * k, 0.0) for k in range(200)]
        places += [
            (1e6 * (k // 2) + r * np.cos(a), r * np.sin(a)) for k, (r, a) in enumerate(zip(apart, angle, strict=True))
        ]
        graph = nx.DiGraph([(200 + k, k // 2) for k in range(400)])
        graph.add_nodes_from(range(600))
        for model in (CaptureEffect(), Collision())[: 1 if seed else 2]:
            clock, net, _ = network(model, places, graph=graph)
            for k in range(400):
                at(clock, 2000 * (k // 2), net.publish, 200 + k, None, size=SIZE)
            clock.run()
            counts = net.message_counts()
            if model == Collision():
                none += counts.delivered
            else:
                found.append(counts.delivered / counts.sent)
    assert none == 0
    assert abs(z_score(found, 0.19905)) < 3
    assert z_score(found, 0.13245) > 3


def test_capture_by_hand():
    """n = 3: 6 dB are a ratio of 10^0.2 = 1.585 of the distances; node 0 is at 10 m, node 1 at 15.8 or 15.9 m."""
    for other, captured in ((15.8, False), (15.9, True)):
        clock, net, trace = network(CaptureEffect(), [-10.0, other, 0.0], graph=nx.Graph([(0, 2), (1, 2)]))
        at(clock, 0, net.publish, 1, None, size=SIZE)
        at(clock, 500, net.publish, 0, None, size=SIZE)
        clock.run()
        assert received(trace) == ({(0, 2)} if captured else set())
        assert set(causes(trace).values()) == {"collision"}


def test_capture_compares_with_each_frame_and_sinr_with_their_sum():
    """Two interferers are each 4.77 dB weaker, and 1.76 dB together: received with 4 dB if compared one by one."""
    apart = [[10.0], [10.0 * 3 ** (1 / 3)], [10.0 * 3 ** (1 / 3)]]
    assert judged(CaptureEffect(threshold=4.0), apart).tolist() == [True]
    assert judged(CaptureEffect(threshold=0.0), np.array([[3.0], [3.0]])).tolist() == [True]  # equal is enough for 0 dB
    assert judged(Sinr(threshold=4.0, fading="none"), apart).tolist() == [False]
    assert judged(Sinr(threshold=1.7, fading="none"), apart).tolist() == [True]
    assert judged(Sinr(threshold=1.8, fading="none"), apart).tolist() == [False]


@pytest.mark.parametrize(
    ("first", "lock", "gets"), [("weak", False, "strong"), ("weak", True, ""), ("strong", True, "strong")]
)
def test_a_receiver_that_locks_stays_with_the_first_preamble(first, lock, gets):
    """The weak frame is destroyed by the strong one in any case."""
    clock, net, trace = network(CaptureEffect(lock=lock), [1.0, 50.0, 0.0], graph=nx.Graph([(0, 2), (1, 2)]))
    at(clock, 0 if first == "strong" else 500, net.publish, 0, None, size=SIZE)
    at(clock, 0 if first == "weak" else 500, net.publish, 1, None, size=SIZE)
    clock.run()
    assert received(trace) == ({(0, 2)} if gets else set())


def test_a_receiver_does_not_lock_on_to_a_frame_that_it_does_not_hear():
    """Node 1 is out of range of node 2."""
    for within, gets in ((60.0, set()), (40.0, {(0, 2)})):
        graph = nx.Graph([(0, 2), (1, 2)])
        clock, net, trace = network(CaptureEffect(lock=True), [1.0, 50.0, 0.0], graph=graph, range=within)
        at(clock, 0, net.publish, 1, None, size=SIZE)
        at(clock, 500, net.publish, 0, None, size=SIZE)
        clock.run()
        assert received(trace) == gets


class FirstWins(Collision):
    """A model of a user: all frames are received by the nodes that lock on to them."""

    lock: ClassVar[bool] = True

    def __call__(self, overlap):
        return np.ones(len(overlap.receivers), dtype=bool)


def test_receivers_can_lock_under_a_model_of_a_user():
    clock, net, trace = network(FirstWins(), [1.0, 50.0, 0.0], graph=nx.Graph([(0, 2), (1, 2)]))
    at(clock, 500, net.publish, 0, None, size=SIZE)
    at(clock, 0, net.publish, 1, None, size=SIZE)
    clock.run()
    assert received(trace) == {(1, 2)}


# Fading.


def shares(model, ratio, frames=20_000, **given):
    """Return the share of frames that one interferer, farther away by a factor, does not destroy, and its error."""
    received = judged(model, [np.full(frames, 10.0), np.full(frames, 10.0 * ratio)], 5, **given)
    return received.mean(), sqrt(received.mean() * (1.0 - received.mean()) / frames)


@pytest.mark.slow_cases("0.5-CaptureEffect")
@pytest.mark.parametrize("kind", [CaptureEffect, Sinr])
@pytest.mark.parametrize("m", [0.5, 1.0, 4.0])
def test_two_nakagami_powers_have_a_ratio_of_fishers_distribution(kind, m):
    """P(S / I > th) = 1 - F(th; 2m, 2m), with th = 6 dB less the 9.03 dB of twice the distance; the control is 2m."""
    model = kind(fading="nakagami", m=m)
    found, error = shares(model, 2.0)
    assert abs(found - f.sf(10**0.6 / 8.0, 2 * m, 2 * m)) < 4 * error
    assert abs(found - f.sf(10**0.6 / 8.0, 4 * m, 4 * m)) > 4 * error


@pytest.mark.slow_cases("1.0-Sinr", "8.0-CaptureEffect")
@pytest.mark.parametrize("kind", [CaptureEffect, Sinr])
@pytest.mark.parametrize("k", [0.0, 1.0, 8.0])
def test_two_rician_powers_are_compared_as_their_distributions_say(kind, k):
    """The integral of the density of the interferer and the survival of the frame; the control is 2 K + 1."""

    def theory(k):
        scale = 1.0 / (2.0 * (k + 1.0))
        power = ncx2(2, 2 * k, scale=scale) if k else chi2(2, scale=scale)
        return quad(lambda x: power.pdf(x) * power.sf(10**0.6 / 8.0 * x), 0.0, 40.0, limit=200, points=[0.5, 1.0, 2.0])[
            0
        ]

    found, error = shares(kind(fading="rice", k=k), 2.0)
    assert abs(found - theory(k)) < 4 * error
    assert abs(found - theory(2 * k + 1)) > 4 * error


@pytest.mark.slow_cases("fading3-<lambda>")
@pytest.mark.parametrize(
    ("fading", "survival"),
    [
        ({"fading": "none"}, lambda x: float(x <= 1.0)),
        ({"fading": "rayleigh"}, lambda x: exp(-x)),
        ({"fading": "nakagami", "m": 3.0}, lambda x: gamma.sf(x, 3.0, scale=1 / 3)),
        ({"fading": "rice", "k": 3.0}, lambda x: ncx2.sf(8.0 * x, 2, 6.0)),
    ],
)
def test_with_noise_alone_a_frame_is_received_if_its_power_is_above_the_threshold(fading, survival):
    """th N d^a / P = 1/2; the control is twice as much noise."""
    th, frames = 10**0.6, 20_000
    model = Sinr(noise=0.5 / (th * 1000.0), **fading)
    found = judged(model, [np.full(frames, 10.0)], 7).mean()
    error = sqrt(0.25 / frames)
    assert abs(found - survival(0.5)) < 4 * error
    assert (
        abs(judged(model.model_copy(update={"noise": 1.05 / (th * 1000.0)}), [np.full(frames, 10.0)], 7).mean() - found)
        > 0.1
    )


def test_lora_frames_fade_too():
    """A frame is 6 dB stronger than another from its place with probability 1 / (1 + 10^0.6) if both fade."""
    alike = {"signals": [LoRaSignal(7, 125e3, 0.0, 8)] * 2, "times": [(0, 100 * MS)] * 2}
    assert not judged(LoRaInterference(), [np.full(9, 10.0), np.full(9, 10.0)], **alike).any()
    found, error = shares(LoRaInterference(fading="rayleigh"), 1.0, **alike)
    assert abs(found - 1.0 / (1.0 + 10**0.6)) < 4 * error


# Signal to interference and noise.


def test_interference_is_the_sum_of_the_frames_that_are_on_the_air_together():
    """Two interferers are each 7.06 dB weaker, and 4.05 dB together: with 5 dB the frame survives one at a time."""
    apart = [[10.0], [10.0 * 10 ** (7.06 / 30)], [10.0 * 10 ** (7.06 / 30)]]
    model = Sinr(threshold=5.0, fading="none")
    for begin, survives in ((1600, True), (1500, True), (1400, False)):
        times = [(1000, 2000), (500, 1500), (begin, begin + 1000)]
        assert judged(model, apart, times=times).tolist() == [survives]


def poisson_field(model, seed, *, count=800, radius=500.0, density=1e-4, apart=20.0):
    """Return the share of `count` receivers that get a frame from a distance, among Poisson interferers in a disc."""
    rng = np.random.default_rng(seed)
    numbers = rng.poisson(density * pi * radius**2, count)
    others = radius * np.sqrt(rng.random((numbers.max(), count)))
    others[np.arange(len(others))[:, np.newaxis] >= numbers] = inf
    return judged(model, [np.full(count, apart), *others], seed + 100).mean()


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 5e-7])
def test_a_frame_survives_poisson_interferers_with_rayleigh_fading_as_the_formula_says(noise):
    """exp(-l pi r^2 th^(2/a) (2 pi / a) / sin(2 pi / a)) = 0.6745, times exp(-th N r^a / P), which is 0.727 with noise.

    l = 1e-4, r = 20 m, th = 6 dB, a = 4. Interferers beyond 500 m change it by 0.001. The standard error of 5600
    receivers is 0.0063. The controls are a model without fading, and a threshold of 8 dB.
    """

    def theory(threshold, noise):
        th = 10 ** (threshold / 10)
        return exp(-1e-4 * pi * 400 * th**0.5 * (pi / 2) / sin(pi / 2)) * exp(-th * noise * 20**4)

    model = Sinr(exponent=4.0, noise=noise)
    found = [poisson_field(model, seed) for seed in range(REPLICATIONS)]
    assert theory(6.0, 0.0) == pytest.approx(0.6745, abs=1e-4)
    assert theory(6.0, 5e-7) / theory(6.0, 0.0) == pytest.approx(0.727, abs=1e-3)
    assert abs(z_score(found, theory(6.0, noise))) < 3
    assert z_score(found, theory(8.0, noise)) > 3
    still = [poisson_field(model.model_copy(update={"fading": "none"}), seed, count=400) for seed in range(4)]
    assert abs(z_score(still, theory(6.0, noise))) > 3


@pytest.mark.slow
def test_fading_is_drawn_for_each_frame_and_receiver_in_a_network():
    """One interferer twice as far: success with 1 / (1 + th 2^-a), 0.6680 with 6 dB and a = 3; the control is 9 dB.

    The noise, exp(-th N r^a) = 0.9, also counts for frames that nothing overlaps. 700 pairs of frames: the
    standard errors are 0.019 and 0.011.
    """
    th = 10**0.6
    model = Sinr(noise=-np.log(0.9) / (th * 1000.0))
    for both, theory in ((True, 0.9 / (1 + th / 8)), (False, 0.9)):
        clock, net, trace = network(model, [10.0, -20.0, 0.0], graph=nx.DiGraph([(0, 2), (1, 2)]))
        for k in range(700):
            at(clock, 2000 * k, net.publish, 0, None, size=SIZE)
            if both:
                at(clock, 2000 * k, net.publish, 1, None, size=SIZE)
        clock.run()
        lost = {each.transmission for each in trace.of(Lost)}
        found = [each.transmission not in lost for each in trace.of(Broadcast) if each.src == 0]
        assert len(found) == 700
        assert abs(z_score(found, theory)) < 3
        assert abs(z_score(found, 0.9 / (1 + 10**0.9 / 8))) > 3


def test_noise_alone_loses_a_weak_frame():
    """-30 dB at 10 m with a = 3, 6 dB above -36.1 dB and not above -35.9 dB."""
    for level, arrives in ((-36.1, True), (-35.9, False)):
        clock, net, trace = network(Sinr(fading="none", noise=10 ** (level / 10)), [0.0, 10.0])
        net.publish(0, None, size=SIZE)
        clock.run()
        assert received(trace) == ({(0, 1)} if arrives else set())
        assert causes(trace) == ({} if arrives else {(0, 1): "loss"})


# LoRa.


def lora_survival(nodes, seed, *, frames=450, period=1000.0, threshold=None, factors=None, frequencies=None):
    """Return the share of received messages of Poisson nodes, with 20 bytes, SF 12 and CR 4/8, at a gateway, node 0."""
    clock = Clock()
    reception = Collision() if threshold is None else LoRaInterference(threshold=threshold)
    radio = LoRa(
        access=Aloha(),
        reception=reception,
        coding_rate=4,
        spreading_factor=12,
        spreading_factors=None if factors is None else (12, *factors),
        frequencies=None if frequencies is None else (868e6, *frequencies),
    )
    places = np.vstack([[[0.0, 0.0]], np.random.default_rng(seed).normal(size=(nodes, 2))])
    net = Network(clock, nx.star_graph(nodes), Links(medium=radio), seed=seed, positions=lambda: places)
    rng = np.random.default_rng(seed)
    times = np.sort(rng.integers(round(frames * period / nodes * 1e9), size=frames)).tolist()
    for t, src in zip(times, (1 + rng.integers(nodes, size=frames)).tolist(), strict=True):
        Instant(clock, t, Phase.DECISION).callbacks.append(lambda _, src=src: net.send(src, 0, None, size=20))
    clock.run()
    counts = net.message_counts()
    return counts.delivered / counts.sent


def lora_shares(nodes, **options):
    return [lora_survival(nodes, seed, **options) for seed in range(REPLICATIONS)]


AIRTIME = LoRa(spreading_factor=12, coding_rate=4)(20)


@pytest.mark.slow
@pytest.mark.parametrize(("nodes", "number"), [(64, 0.806)])
def test_lora_without_capture_is_aloha(nodes, number):
    """e^(-2 (N-1) T / period), T = 1712.128 ms; the standard error is 0.008. The control is SF 11."""
    found = lora_shares(nodes)

    def theory(airtime):
        return exp(-2 * (nodes - 1) * airtime / 1000.0)

    assert pytest.approx(1.712128, abs=1e-9) == AIRTIME
    assert theory(AIRTIME) == pytest.approx(number, abs=5e-4)
    assert abs(z_score(found, theory(AIRTIME))) < 3
    assert z_score(found, theory(LoRa(spreading_factor=11, coding_rate=4)(20))) < -3


@pytest.mark.whole
def test_lora_frames_of_other_spreading_factors_and_frequencies_do_not_interfere():
    """Without capture (a threshold of 300 dB) a frame is lost if another overlaps it after three preamble symbols.

    Of 64 nodes with two frequencies that are 30.1 kHz apart, 31 others count: e^(-31 (2 T - 3 symbols) / period); at
    29.9 kHz all 63 do. With nodes of SF 12 on one half and SF 11 on the other, all survive more often.
    """
    symbol = 2**12 / 125e3

    def theory(others):
        return exp(-others * (2 * AIRTIME - 3 * symbol) / 1000.0)

    apart = lora_shares(64, threshold=300.0, frames=500, frequencies=(868e6, 868.0301e6) * 32)
    near = lora_shares(64, threshold=300.0, frames=500, frequencies=(868e6, 868.0299e6) * 32)
    assert abs(z_score(apart, theory(31))) < 3
    assert abs(z_score(near, theory(63))) < 3
    assert z_score(apart, theory(63)) > 3
    assert z_score(near, theory(31)) < -3
    factors = lora_shares(64, threshold=300.0, frames=500, factors=(12, 11) * 32)
    assert z_score(factors, theory(31)) > 3
    assert min(factors) > np.mean(near)


SYMBOL = 1_024_000
"""Duration of a symbol of SF 7 at 125 kHz, ns."""


def lora(own, other, apart, times=None, **model):
    """Return whether a receiver gets a frame, with the signals of two frames, their distances and times (symbols)."""
    times = times or [(0, 50), (10, 60)]
    signals = [LoRaSignal(*{"sf": 7, "bw": 125e3, "f": 0.0, "preamble": 8, **each}.values()) for each in (own, other)]
    in_ns = [(begin * SYMBOL, end * SYMBOL) for begin, end in times]
    (found,) = judged(LoRaInterference(**model), [[each] for each in apart], times=in_ns, signals=signals).tolist()
    return found


def test_the_stronger_of_two_lora_frames_is_received_if_it_is_stronger_by_6_db():
    """n = 2.08: 6 dB are a ratio of 10^(6 / 20.8) = 1.943 of the distances."""
    assert lora({}, {}, (1.0, 1.95))
    assert not lora({}, {}, (1.0, 1.94))
    assert not lora({}, {}, (1.95, 1.0))
    assert lora({}, {}, (1.0, 1.0), threshold=0.0)


def test_a_lora_frame_survives_if_the_other_ends_before_its_last_five_preamble_symbols():
    """Of 8 symbols of the preamble three may be lost; the critical section begins at 3 symbols after the start."""
    for end, survives in ((2.9, True), (3.0, True), (3.1, False)):
        assert lora({}, {}, (9.0, 1.0), [(0, 50), (-20, end)]) == survives
    assert lora({"preamble": 12}, {}, (9.0, 1.0), [(0, 50), (-20, 6.9)])
    assert not lora({"preamble": 5}, {}, (9.0, 1.0), [(0, 50), (-20, 0.1)])
    assert not lora({}, {}, (9.0, 1.0), [(0, 50), (49.0, 99)]), "the end of a frame has no such section"


@pytest.mark.parametrize(("bandwidth", "separation"), [(125e3, 30e3), (250e3, 60e3), (500e3, 120e3)])
def test_lora_frames_interfere_up_to_a_separation_of_their_frequencies(bandwidth, separation):
    for factor, survives in ((0.0, False), (0.99, False), (1.01, True), (-0.99, False), (-1.01, True)):
        other = {"bw": bandwidth, "f": 868e6 + factor * separation}
        assert lora({"bw": bandwidth, "f": 868e6}, other, (1.0, 1.0), [(0, 99), (0, 99)]) == survives


@pytest.mark.slow_cases("8-8-goursaud")
@pytest.mark.parametrize("isolation", sorted(ISOLATION))
@pytest.mark.parametrize("own", range(7, 13))
@pytest.mark.parametrize("other", range(7, 13))
def test_lora_frames_of_two_spreading_factors_need_the_isolation_between_them(isolation, own, other):
    """A frame survives if it is weaker than the other by at most the isolation; equal factors need the threshold."""
    least = 6.0 if own == other else ISOLATION[isolation][own - 7][other - 7]
    times = [(0, 9999), (0, 9999)]
    for margin, survives in ((0.1, True), (-0.1, False)):
        apart = (1.0, 10 ** ((least + margin) / 20.8))
        assert lora({"sf": own}, {"sf": other}, apart, times, isolation=isolation) == survives
    if own != other:
        assert lora({"sf": own}, {"sf": other}, (1e4, 1.0), times), "orthogonal"


SUMS = {
    "goursaud": ([-86, -104, -121, -138, -155, -174], [-144, -136, -131, -127, -122, -118]),
    "croce": ([-43, -59, -69, -88, -104, -121], [-91, -85, -82, -77, -75, -74]),
}
"""The sums of the rows and of the columns of each matrix: no number changes alone."""


def test_the_isolation_matrices_are_the_published_ones():
    """SF 7 among SF 8 and SF 12, and SF 12 among SF 7 and SF 11: Goursaud & Gorce 2015 and Croce et al. 2018."""
    for name, numbers in (("goursaud", (-16, -20, -36, -36)), ("croce", (-8, -9, -25, -23))):
        rows = ISOLATION[name]
        assert (rows[0][1], rows[0][5], rows[5][0], rows[5][4]) == numbers
        assert {len(row) for row in (*rows, rows)} == {6}
        assert ([sum(row) for row in rows], [sum(column) for column in zip(*rows, strict=True)]) == SUMS[name]
        for k, column in enumerate(zip(*rows, strict=True)):
            others = [*column[:k], *column[k + 1 :]]
            assert others == sorted(others, reverse=True), "a slower frame stands more of the same interference"
            assert max(others) < 0 < column[k]


def test_a_gateway_gets_lora_frames_of_two_spreading_factors_and_not_of_one():
    for factors, count in (((7, 7, 8), 2), ((7, 7, 7), 0)):
        radio = LoRa(access=Aloha(), reception=LoRaInterference(), spreading_factors=factors)
        clock, net, trace = network(None, [0.0, 10.0, -10.0], medium=radio, graph=nx.star_graph(2))
        net.publish(1, None, size=20)
        net.publish(2, None, size=20)
        clock.run()
        assert len(received(trace)) == count


# Hidden and exposed terminals, half duplex.

LINE = [0.0, 20.0, 10.0]
"""The places of A, B and C, m: node 2 is in the middle."""


def on_a_line(access, places, seed, *, load=0.1, frames=200, within=12.0):
    """Return the share of messages from nodes 0 and 1, each with a Poisson load, that node 2 gets."""
    clock, net, _ = network(Collision(), places, access=access, seed=seed, range=within)
    rng = np.random.default_rng(seed)
    for src in (0, 1):
        for t in rng.integers(round(frames * 1000 / load), size=frames).tolist():
            at(clock, t, net.send, src, 2, None, size=SIZE)
    clock.run()
    counts = net.message_counts()
    return counts.delivered / counts.sent


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("access", [Aloha(), Csma(), Csma(persistence="p_persistent")], ids=["aloha", "csma", "1"])
def test_carrier_sense_does_not_help_against_a_hidden_terminal(access):
    """A - C - B: survival at C is e^(-2G) of the other node, 0.8187 with G = 0.1, as with ALOHA.

    A node has a queue, so it is (1 - G) e^-G = 0.8144; the standard error is 0.011. The controls are the square of it,
    a carrier-sense range of 20 m, and a range of 20 m: in both, each node senses all others, and nothing is lost. Only
    1-persistent nodes still collide, less than 3 %: if each has a frame at the end of a frame, both start then.
    """
    theory, number = 0.9 * exp(-0.1), exp(-0.2)
    found = [on_a_line(access, LINE, seed) for seed in range(REPLICATIONS)]
    assert theory == pytest.approx(number, rel=0.006)
    assert abs(z_score(found, theory)) < 3
    assert z_score(found, theory**2) > 3
    if access == Aloha():
        assert on_a_line(access, LINE, 0, within=20.0) < 0.9
        return
    sensing = access.model_copy(update={"sensing_range": 20.0})
    heard = [on_a_line(access, LINE, 0, within=20.0), on_a_line(sensing, LINE, 0)]
    if access == Csma():
        assert heard == [1.0, 1.0]
    assert min(heard) > 0.97
    assert on_a_line(access.model_copy(update={"sensing_range": 19.9}), LINE, 0) < 0.9


def test_hidden_terminals_by_hand():
    """Node 1 senses the frame of node 0 only if its place is in range, or in the carrier-sense range."""
    for places, sensing_range, begin in ((LINE, None, 500.0), (LINE, 20.0, 1000.0), ([0.0, 10.0, 20.0], None, 1000.0)):
        access = Csma(persistence="p_persistent", sensing_range=sensing_range)
        clock, net, trace = network(Collision(), places, access=access, range=12.0)
        at(clock, 0, net.publish, 0, None, size=SIZE)
        at(clock, 500, net.publish, 1, None, size=SIZE)
        clock.run()
        assert [each.t / US for each in trace.of(Broadcast)] == [0.0, begin]
        assert (net.message_counts().lost > 0) == (begin == 500.0)


def test_an_exposed_terminal_waits_although_nothing_would_collide():
    """A line of 0 - 1 - 2 - 3, 10 m apart: 1 sends to 0, and 2 senses it. With a sensing range of 5 m it need not."""
    for sensing_range, begin in ((None, 1000.0), (5.0, 400.0)):
        access = Csma(persistence="p_persistent", sensing_range=sensing_range)
        clock, net, trace = network(Collision(), [0.0, 10.0, 20.0, 30.0], access=access, range=12.0)
        at(clock, 0, net.send, 1, 0, None, size=SIZE)
        at(clock, 400, net.publish, 2, None, size=SIZE)
        clock.run()
        assert [each.t / US for each in trace.of(Broadcast)] == [begin]
        lost = {(each.src, each.dst): each.cause for each in trace.of(Lost)}
        assert lost == ({} if sensing_range is None else {(2, 1): "half_duplex"})


@pytest.mark.parametrize(
    "model", [Collision(), CaptureEffect(), Sinr(), Sinr(threshold=-300.0)], ids=lambda model: model.kind
)
def test_a_node_that_transmits_receives_nothing(model):
    """Whatever the model: two nodes that send at the same time."""
    clock, net, trace = network(model, [0.0, 10.0])
    at(clock, 0, net.publish, 0, None, size=SIZE)
    at(clock, 999, net.publish, 1, None, size=SIZE)
    clock.run()
    assert causes(trace) == {(0, 1): "half_duplex", (1, 0): "half_duplex"}


def test_a_collision_is_where_both_frames_are_heard():
    """Nodes 0 to 3 on a line, 10 m apart, range 12 m; 0 and 3 send: 1 hears only 0, and 2 hears only 3."""
    clock, net, trace = network(Collision(), [0.0, 10.0, 20.0, 30.0], range=12.0)
    net.publish(0, None, size=SIZE)
    net.publish(3, None, size=SIZE)
    clock.run()
    assert received(trace) == {(0, 1), (3, 2)}


def test_an_acknowledgement_interferes_and_makes_its_node_deaf():
    """Node 1 acknowledges from 1028 us on; node 2, which does not sense it, sends to 1 at 1030 us, and 3 hears both."""
    graph = nx.DiGraph([(0, 1), (1, 3), (2, 1), (2, 3)])
    clock, net, trace = network(Collision(), [0.0] * 4, access=CsmaCa(window=1), graph=graph)
    net.send(0, 1, None, size=SIZE)
    at(clock, 1030, net.publish, 2, None, size=SIZE)
    clock.run()
    assert causes(trace) == {(2, 1): "half_duplex", (2, 3): "collision"}


@pytest.mark.parametrize("lock", [None, False, True])
def test_a_frame_that_ends_as_an_acknowledgement_begins_is_received(lock):
    """0 sends to 1 and 2 to 3, both from 28 to 1028 us; 1 acknowledges from 1038 us on, which 3 hears."""
    graph = nx.Graph([(0, 1), (2, 3), (1, 3)])
    reception = Collision() if lock is None else CaptureEffect(lock=lock)
    clock, net, _ = network(reception, [0.0, 1.0, 3.0, 2.0], access=CsmaCa(window=1), graph=graph)
    net.send(0, 1, None, size=SIZE)
    net.send(2, 3, None, size=SIZE)
    clock.run()
    counts = net.message_counts()
    assert (counts.transmissions, counts.delivered) == (2, 2)


# Bad values.


@pytest.mark.parametrize("reception", [CaptureEffect(), Sinr()], ids=lambda model: model.kind)
def test_reception_by_power_needs_positions(reception):
    radio = Bitrate(bitrate=8e5, access=Aloha(), reception=reception)
    with pytest.raises(ValueError, match="positions"):
        Network(Clock(), nx.complete_graph(2), Links(medium=radio))


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Bitrate(bitrate=1e6, access=Aloha(), reception=LoRaInterference()), "lora"),
        (lambda: CaptureEffect(threshold=-1.0), "threshold"),
        (lambda: CaptureEffect(exponent=0.0), "exponent"),
        (lambda: Sinr(noise=-1.0), "noise"),
        (lambda: Sinr(fading="rician"), "fading"),
        (lambda: LoRaInterference(isolation="none"), "isolation"),
        (lambda: LoRa(spreading_factors=(7, 8)), "access.kind"),
        (lambda: LoRa(access=Aloha(), spreading_factors=(6, 8)), "spreading_factors"),
        (lambda: Bitrate(bitrate=1e6, access=Aloha(), reception={"kind": "magic"}), "magic"),
    ],
)
def test_models_that_make_no_sense_are_refused(make, match):
    with pytest.raises(KeyedError, match=match):
        make()


@pytest.mark.parametrize("name", ["spreading_factors", "frequencies"])
def test_every_node_has_a_spreading_factor_and_a_frequency(name):
    values = (7, 8, 9) if name == "spreading_factors" else (868e6,) * 3
    radio = LoRa(access=Aloha(), **{name: values})
    with pytest.raises(ValueError, match=rf"^{name}: should have one for each of 2 nodes \(got 3\)"):
        Network(Clock(), nx.complete_graph(2), Links(medium=radio))


# Radios with one frequency and spreading factor.


def tuned(gateways, **signals):
    """Return the receptions and the causes of losses of a frame of each of three nodes, one after the other."""
    radio = LoRa(access=Aloha(), gateways=gateways, **signals)
    clock, net, trace = network(None, [0.0, 1.0, 2.0], medium=radio)
    for node in range(3):
        at(clock, 10_000_000 * node, net.publish, node, None, size=SIZE)
    clock.run()
    return received(trace), set(causes(trace).values())


@pytest.mark.parametrize(
    ("gateways", "expected"),
    [
        (None, {(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)}),
        ((), {(0, 2), (2, 0)}),
        ((1,), {(0, 1), (0, 2), (2, 0), (2, 1)}),
        ((0, 1, 2), {(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)}),
    ],
)
@pytest.mark.parametrize("signals", [{"spreading_factors": (7, 9, 7)}, {"frequencies": (868.1e6, 868.3e6, 868.1e6)}])
def test_a_radio_hears_the_frequency_and_the_spreading_factor_that_it_transmits_with(gateways, expected, signals):
    """Nodes 0 and 2 are alike; a gateway hears all. The default, in which all hear all, is the control."""
    got, why = tuned(gateways, **signals)
    assert got == expected
    assert why == (set() if len(expected) == 6 else {"tuning"})


@pytest.mark.parametrize(("offset", "hears"), [(31_250.0, True), (31_251.0, False)])
def test_a_radio_receives_up_to_a_quarter_of_the_bandwidth_beside_its_frequency(offset, hears):
    got, _ = tuned((), frequencies=(868.1e6, 868.1e6 + offset, 868.1e6))
    assert ((0, 1) in got) is hears


def test_a_tuned_radio_senses_its_own_channel_only():
    """On one channel the second waits for the first; on two it starts at once."""
    for factors, starts in (((7, 7, 7), 2), ((7, 9, 7), 1)):
        radio = LoRa(access=Csma(persistence="p_persistent"), gateways=(), spreading_factors=factors)
        clock, net, trace = network(None, [0.0, 1.0, 2.0], medium=radio)
        at(clock, 0, net.publish, 0, None, size=SIZE)
        at(clock, 1000, net.publish, 1, None, size=SIZE)
        clock.run()
        assert len({each.t // MS for each in trace.of(Broadcast) if each.t > 2 * MS}) == starts - 1


def test_a_gateway_that_is_no_node_is_refused():
    with pytest.raises(ValueError, match=r"^gateways: there is no node 3: the nodes are 0 .. 2"):
        tuned((3,), spreading_factors=(7, 7, 7))
