"""What networks receive over channels that are correlated in time and place, with and without contention."""

from math import inf, log10, sqrt

import numpy as np
import pytest
from scipy.stats import ncx2

from desim.config.errors import KeyedError
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.positions import PositionSource
from desim.kernel.core.units import SECOND
from desim.kernel.models.access import Aloha
from desim.kernel.models.coherence import Coherence
from desim.kernel.models.fading import nakagami_powers, rice_powers
from desim.kernel.models.graphs import Complete
from desim.kernel.models.interference import CaptureEffect, Sinr
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate
from desim.kernel.models.reception import Disk, LogDistance, Nakagami, QuasiUnitDisk, Rice
from desim.kernel.network import Network
from desim.kernel.topology.correlated_channel import CorrelatedChannel, Ends

COHERENCE = Coherence(frequency=1e9, doppler=5.0, decorrelation=3.0, shared=0.4)
STARTS = np.array([(0.0, 0.0), (8.0, 2.0), (-3.0, 9.0)])
VELOCITIES = np.array([(1.0, 0.0), (-0.5, 0.5), (0.0, 0.0)])
RANGE = 10.0


class Moving(PositionSource):
    """Nodes that move straight on."""

    max_speed = 1.0

    def __init__(self, clock):
        self._clock = clock

    def __call__(self):
        return places(self._clock.now / SECOND)


def places(t):
    return STARTS + VELOCITIES * t


def sent(links, times, seed=1, src=0):
    """Return (times, 2) whether each of two receivers gets the broadcasts that node `src` makes at some times, s."""
    clock = Clock()
    net = Network(clock, Complete()(3), links, seed=seed, positions=Moving(clock))
    for number, time in enumerate(times):
        Instant(clock, round(time * SECOND), Phase.DECISION).callbacks.append(
            lambda _, body=number: net.send(src, None, body, size=100)
        )
    clock.run(until=round((times[-1] + 1.0) * SECOND))
    others = [node for node in range(3) if node != src]
    got = [{message.body for message in net.inbox(node).drain()} for node in others]
    return np.array([[number in bodies for bodies in got] for number in range(len(times))])


def state(time, src, dst, seed=1, coherence=COHERENCE):
    """Return the distance and the state of the channel between two nodes at a time."""
    at = places(time)
    channel = CorrelatedChannel(coherence, seed, 3).between(Ends(src, np.array([dst]), at[src], at[[dst]], time))
    return np.hypot(*(at[src] - at[dst])), channel


TIMES = np.arange(0.0, 2.0, 0.029)
POWERS = {
    "log_distance": lambda channel: -8.0 * channel.shadowing().item(),
    "nakagami": lambda channel: 10.0 * log10(nakagami_powers(1.5, channel.normals).item()),
    "rice": lambda channel: 10.0 * log10(rice_powers(2.0, channel.normals).item()),
}
"""By kind, the power in dB above its mean in the state of a channel."""


@pytest.mark.parametrize("reception", [LogDistance(shadowing=8.0), Nakagami(m=1.5), Rice(k=2.0)], ids=lambda m: m.kind)
@pytest.mark.parametrize("check", ["send", "delivery"])
def test_a_message_is_received_if_the_power_at_that_time_and_place_suffices(reception, check):
    """The power is computed once more here, from the state of the channel and the distance; delivery is 20 ms later."""
    links = Links(
        range=RANGE, reception=reception, fading="correlated", coherence=COHERENCE, range_check=check, latency=0.02
    )
    got = sent(links, TIMES)
    expected = []
    for time in TIMES + (0.02 if check == "delivery" else 0.0):
        row = []
        for dst in (1, 2):
            apart, channel = state(time, 0, dst)
            margin = 10.0 * reception.exponent * log10(RANGE / apart)
            power = POWERS[reception.kind](channel)
            row.append(power >= -margin)
        expected.append(row)
    assert got.tolist() == expected
    assert 5 < got.sum() < got.size - 5


def test_both_directions_have_the_same_fate_at_one_instant():
    links = Links(range=RANGE, reception=Nakagami(), fading="correlated", coherence=COHERENCE)
    there, back = sent(links, TIMES, src=0)[:, 0], sent(links, TIMES, src=1)[:, 0]
    assert there.tolist() == back.tolist()
    fresh = links.model_copy(update={"fading": "message"})
    assert sent(fresh, TIMES, src=0)[:, 0].tolist() != sent(fresh, TIMES, src=1)[:, 0].tolist()


def test_a_repetition_within_a_millisecond_meets_the_fade_that_it_should_outlast():
    """80 pairs of messages 1 ms apart; without memory almost half of them differ in fate."""
    times = np.sort(np.concatenate([np.arange(0.0, 8.0, 0.1), np.arange(0.0, 8.0, 0.1) + 0.001]))
    links = Links(range=9.0, reception=Rice(k=0.0), fading="correlated", coherence=Coherence(doppler=5.0))
    differ = {}
    for fading in ("correlated", "message"):
        got = sent(links.model_copy(update={"fading": fading}), times)[:, 0]
        differ[fading] = (got[::2] != got[1::2]).sum()
    assert differ["correlated"] <= 3
    assert differ["message"] > 20


@pytest.mark.slow
def test_the_share_of_received_messages_is_the_probability_of_reception():
    """Over 400 seeds, at rest: with memory as without; s.e. 0.025."""
    reception = Rice(k=3.0)
    links = Links(range=RANGE, reception=reception, fading="correlated", coherence=Coherence(doppler=1.0, waves=16))
    got = [sent(links, [0.0], seed=seed)[0].tolist() for seed in range(400)]
    for column, dst in enumerate((1, 2)):
        apart = np.hypot(*(STARTS[0] - STARTS[dst]))
        (probability,) = reception(np.array([apart]), RANGE)
        assert probability == pytest.approx(ncx2.sf(8.0 * (apart / RANGE) ** 3, 2, 6.0))
        assert probability < 0.85
        assert abs(np.mean(got, axis=0)[column] - probability) < 3.0 * sqrt(probability * (1 - probability) / 400)


# Contention.


def contending(drawn="correlated", **model):
    """Return links of nodes that contend, with noise that is as strong as a frame at the range without fading."""
    noise = RANGE**-3.0 / 10.0**0.6
    radio = Bitrate(bitrate=800_000.0, access=Aloha(), reception=Sinr(noise=noise, **model))
    return Links(fading=drawn, coherence=COHERENCE if drawn == "correlated" else Coherence(), medium=radio)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "power"),
    [
        ({"fading": "none", "shadowing": 8.0}, lambda channel: -8.0 * channel.shadowing().item()),
        ({"fading": "rayleigh"}, lambda channel: 10.0 * log10(nakagami_powers(1.0, channel.normals).item())),
        (
            {"fading": "rice", "k": 2.0, "shadowing": 5.0},
            lambda channel: 10.0 * log10(rice_powers(2.0, channel.normals).item()) - 5.0 * channel.shadowing().item(),
        ),
        (
            {"fading": "nakagami", "m": 0.8},
            lambda channel: 10.0 * log10(nakagami_powers(0.8, channel.normals).item()),
        ),
    ],
    ids=["shadowing", "rayleigh", "rice and shadowing", "nakagami"],
)
def test_a_frame_is_received_if_its_power_at_its_end_is_above_the_noise(model, power):
    """A frame takes 1 ms, and overlaps no other."""
    got = sent(contending(**model), TIMES)
    expected = []
    for time in TIMES + 0.001:
        row = []
        for dst in (1, 2):
            apart, channel = state(time, 0, dst)
            row.append(power(channel) >= 30.0 * log10(apart / RANGE))
        expected.append(row)
    assert got.tolist() == expected
    assert 5 < got.sum() < got.size - 5


def test_uncorrelated_shadowing_of_frames_is_that_of_the_pair_or_of_the_frame():
    """At equal distances, per link each pair has one fate, and both directions have the same."""
    times = np.arange(0.0, 1.0, 0.01)
    for drawn, varies in (("per_link", False), ("message", True)):
        links = contending(drawn, shadowing=9.0, fading="none")
        got = sent(links, times)
        assert (len(set(got[:, 1].tolist())) > 1) == varies
        if not varies:
            back = sent(links, times, src=2)
            assert got[0, 1] == back[0, 0]


@pytest.mark.slow
def test_a_stronger_frame_is_one_whose_channel_is_better():
    """Nodes 1 and 2 transmit at once; receiver 0 gets the one that the state of its channel favours by 1 dB."""
    radio = Bitrate(
        bitrate=800_000.0, access=Aloha(), reception=CaptureEffect(threshold=1.0, fading="rice", shadowing=4.0)
    )
    links = Links(fading="correlated", coherence=COHERENCE, medium=radio)
    clock = Clock()
    net = Network(clock, Complete()(3), links, seed=1, positions=Moving(clock))
    for number, time in enumerate(TIMES):
        for src in (1, 2):
            Instant(clock, round(time * SECOND), Phase.DECISION).callbacks.append(
                lambda _, src=src, body=number: net.send(src, 0, (src, body), size=100)
            )
    clock.run(until=3 * SECOND)
    got = {message.body for message in net.inbox(0).drain()}
    expected = set()
    for number, time in enumerate(TIMES + 0.001):
        level = {}
        for src in (1, 2):
            apart, channel = state(time, src, 0)
            faded = rice_powers(3.0, channel.normals).item()
            level[src] = 10.0 * log10(faded) - 30.0 * log10(apart) - 4.0 * channel.shadowing().item()
        expected |= {(src, number) for src in (1, 2) if level[src] >= level[3 - src] + 1.0}
    assert got == expected
    assert {src for src, _ in got} == {1, 2}


# Bad values.


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: Links(range=9.0, reception=Rice(), fading="correlated"), "coherence: frequency or doppler"),
        (
            lambda: Links(range=9.0, reception=Nakagami(), fading="correlated", coherence=Coherence(decorrelation=5.0)),
            "coherence: frequency or doppler",
        ),
        (
            lambda: Links(range=9.0, reception=LogDistance(), fading="correlated", coherence=Coherence(doppler=5.0)),
            "coherence: decorrelation",
        ),
        (lambda: contending(shadowing=5.0).model_copy(update={"coherence": Coherence(doppler=1.0)}), "decorrelation"),
        (lambda: Links(range=9.0, reception=QuasiUnitDisk(), fading="correlated"), "QuasiUnitDisk has no power"),
        (lambda: Links(range=9.0, reception=lambda d, r: d < r, fading="correlated"), "reception"),
        (lambda: Coherence(frequency=0.0), "frequency"),
        (lambda: Coherence(frequency=-2.4e9), "frequency"),
        (
            lambda: Coherence(frequency=2.4),
            "frequency: should be greater than or equal to 1000000; Carrier frequency f, Hz",
        ),
        (lambda: Coherence(frequency=868), "frequency: should be greater than or equal to 1000000"),
        (lambda: Coherence(doppler=0.0), "doppler"),
        (lambda: Coherence(doppler=float("nan")), "doppler"),
        (lambda: Coherence(decorrelation=0.0), "decorrelation"),
        (lambda: Coherence(decorrelation=-1.0), "decorrelation"),
        (lambda: Coherence(decorrelation=inf), "decorrelation"),
        (lambda: Coherence(shared=1.0), "shared"),
        (lambda: Coherence(shared=-0.1), "shared"),
        (lambda: Coherence(waves=4), "waves"),
        (lambda: Rice(k=-1.0), "k"),
        (lambda: Nakagami(m=0.4), "m"),
        (lambda: Sinr(k=-1.0), "k"),
        (lambda: Sinr(m=0.4), "m"),
        (lambda: Sinr(shadowing=-1.0), "shadowing"),
    ],
)
def test_what_is_missing_or_wrong_is_told(make, problem):
    with pytest.raises(KeyedError, match=problem):
        make()


def test_a_channel_that_is_not_asked_lacks_nothing():
    """A disk has no power that changes, and shadowing of 0 dB needs no decorrelation distance."""
    assert Links(range=9.0, reception=Disk(), fading="correlated").coherence == Coherence()
    assert contending().medium.reception.shadowing == 0.0


def test_nodes_without_positions_cannot_be_shadowed():
    radio = Bitrate(bitrate=1e6, access=Aloha(), reception=Sinr(shadowing=3.0))
    links = Links(fading="correlated", coherence=COHERENCE, medium=radio)
    with pytest.raises(KeyedError, match="needs positions"):
        Network(Clock(), Complete()(3), links)


def test_a_model_of_a_user_follows_the_channel_with_a_method_of_its_own():
    """It receives where the first Gaussian process is positive; a wrong answer is told."""

    class Positive(Rice):
        def received(self, distances, range, channel):  # noqa: A002
            return channel.normals(1)[0] > 0.0

    links = Links(range=RANGE, reception=Positive(), fading="correlated", coherence=Coherence(doppler=5.0))
    got = sent(links, TIMES)[:, 0]
    expected = [state(time, 0, 1, coherence=Coherence(doppler=5.0))[1].normals(1).item() > 0.0 for time in TIMES]
    assert got.tolist() == expected

    class Wrong(Rice):
        def received(self, distances, range, channel):  # noqa: A002
            return 0.5

    with pytest.raises(ValueError, match="received should return a boolean for each of"):
        sent(links.model_copy(update={"reception": Wrong()}), TIMES)
