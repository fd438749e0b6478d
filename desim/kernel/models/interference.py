"""Models of interference: which frames a receiver gets of those that overlap at it.

A model is called with an `Overlap`: one frame, the frames that overlap it, and k of its receivers. Whether frames
overlap is judged by the times at which they are transmitted; propagation delays are neglected. A receiver that itself
transmits meanwhile gets nothing, whatever the model returns for it.
"""

import math
from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import Field

from desim.config.arrays import Bools, Floats, Integers
from desim.config.choice import OneOf
from desim.config.model import RESOLUTION, Flag, Positive, Value
from desim.kernel.core.portable_math import exp, log
from desim.kernel.models.coherence import ChannelState, Variation
from desim.kernel.models.fading import (
    RiceFactor,
    Shape,
    nakagami_powers,
    nakagami_quantiles,
    rice_powers,
    rice_quantiles,
)
from desim.kernel.models.traits import Exponent, InterferenceTraits

Decibels = Annotated[float, Field(ge=-300, le=300, strict=True)]
NEAREST = 1e-3
"""Least distance in the path loss, m; at smaller distances the power is the same."""
LN_10 = math.log(10.0)
SEPARATION = 30.0 / 125.0
"""Largest distance of the frequencies of two LoRa frames that interfere, in bandwidths."""
ISOLATION = {
    "goursaud": (
        (6, -16, -18, -19, -19, -20),
        (-24, 6, -20, -22, -22, -22),
        (-27, -27, 6, -23, -25, -25),
        (-30, -30, -30, 6, -26, -28),
        (-33, -33, -33, -33, 6, -29),
        (-36, -36, -36, -36, -36, 6),
    ),
    "croce": (
        (1, -8, -9, -9, -9, -9),
        (-11, 1, -11, -12, -13, -13),
        (-15, -13, 1, -13, -14, -15),
        (-19, -18, -17, 1, -17, -18),
        (-22, -22, -21, -20, 1, -20),
        (-25, -25, -25, -24, -23, 1),
    ),
}
"""Smallest ratio of the power of a frame to that of an overlapping one at which the frame is received, dB. Rows are the
spreading factors of the frame, 7 to 12, columns those of the overlapping one. The diagonals are not used."""


class LoRaSignal(NamedTuple):
    """The parameters of a LoRa frame."""

    spreading_factor: int
    bandwidth: float
    """Hz"""
    frequency: float
    """Hz"""
    preamble: int
    """Number of symbols."""


class Frame:
    """A transmission on the air.

    Attributes:
        number: the number of the transmission; -1 for an acknowledgement.
        draw: the number of its random draws, different for each attempt to send a transmission.
        src: the node that transmits.
        begin: start of the airtime, ns.
        end: end of the airtime, ns.
        overlapping: the frames that overlap it, by start.
        sensed_by: the nodes that sense it, see `desim.kernel.channel.carrier_sense.CarrierSense.listeners`.
        locked: (n,) which nodes lock on to its preamble; None: all.
    """

    __slots__ = ("begin", "draw", "end", "locked", "number", "overlapping", "sensed_by", "src")

    def __init__(self, number: int, draw: int, src: int, begin: int, end: int, sensed_by: Integers):
        self.number, self.draw, self.src, self.begin, self.end = number, draw, src, begin, end
        self.sensed_by = sensed_by
        self.overlapping: list[Frame] = []
        self.locked: Bools | None = None


def unknown_channel(_: Frame) -> ChannelState:
    """Raise ValueError: the overlap was made without `channel`."""
    raise ValueError("shadowing needs the states of the channels (`Overlap.channel`)")


class Overlap(NamedTuple):
    """A frame, the frames that overlap it, and k of its receivers.

    `audible`, `distances` and `uniforms` take one of the frames, and return an array with one item per receiver.
    """

    frame: Frame
    receivers: Integers
    """(k,) the receivers."""
    others: Sequence[Frame]
    audible: Callable[[Frame], Bools]
    """Whether each receiver is linked to the sender of the frame, and within range."""
    distances: Callable[[Frame], Floats]
    """The distances of the receivers from the sender of the frame, m."""
    uniforms: Callable[[Frame], Floats]
    """Uniform draws in (0, 1), the same in each call with the same frame and receiver."""
    signal: Callable[[Frame], LoRaSignal]
    """Returns the parameters of a LoRa frame; only for a medium of this kind."""
    channel: Callable[[Frame], ChannelState] = unknown_channel
    """Returns the states of the channels from the sender of the frame to the receivers. The states always have
    `shadowing`, and `normals` only if `fading` of the network is "correlated"."""
    is_correlated: bool = False
    """Whether fading follows from `channel`; if not, it follows from `uniforms`."""


class Interference(Protocol):
    """A model of interference: `model(overlap)` returns (k,) whether each receiver gets the frame.

    A model may have an attribute `lock`; see `desim.kernel.models.traits.InterferenceTraits`.
    """

    needs_positions: ClassVar[bool]
    """Whether the model uses distances."""

    @property
    def has_noise(self) -> bool:
        """Whether a frame may be lost although no other overlaps it."""

    def __call__(self, overlap: Overlap) -> Bools: ...  # noqa: D102


class Faded(Value):
    """The fields of models of interference in which the power of a frame at a receiver may fade.

    The power is multiplied by a random variable of mean 1, drawn for each frame and receiver, and by lognormal
    shadowing. With `network.fading = "correlated"` both are processes in time and place, see
    `desim.kernel.models.coherence.Coherence`.
    """

    fading: Literal["none", "rayleigh", "nakagami", "rice"] = "none"
    """Fading of the power of each frame at each receiver, see `desim.kernel.models.fading`."""
    m: Shape = 1.0
    """Shape m of Nakagami fading, at least 0.5: 1 is Rayleigh fading."""
    k: RiceFactor = 3.0
    """Ratio K of the power of the strong path of Rice fading to that of all others, not in dB: 0 is Rayleigh fading."""
    shadowing: Annotated[float, Field(ge=0, le=100, strict=True)] = 0.0
    """Standard deviation of the shadowing of the power, dB, drawn as `network.fading` says: once per pair of nodes, for
    each frame, or correlated; 0: none.

    If in doubt, 0; about 4 in the open, 8 to 12 among buildings.
    """

    @property
    def varies(self) -> tuple[Variation, ...]:
        """The causes for which the power of a frame at a given distance is random."""
        shadowing: tuple[Variation, ...] = ("shadowing",) if self.shadowing else ()
        return shadowing if self.fading == "none" else ("fading", *shadowing)

    @property
    def unused_fields(self) -> dict[str, str]:
        """The shapes of the other kinds of fading."""
        shapes = (("m", "nakagami"), ("k", "rice"))
        return {name: f"fading {self.fading!r}" for name, fading in shapes if fading != self.fading}

    def gains(self, uniforms: Floats) -> Floats:
        """Return the (k,) factors by which (k,) powers fade, given uniform draws in (0, 1)."""
        if self.fading == "rayleigh":
            return -log(uniforms)
        if self.fading == "nakagami":
            return nakagami_quantiles(self.m, uniforms)
        return rice_quantiles(self.k, uniforms) if self.fading == "rice" else np.ones(len(uniforms))

    def _level(self, overlap: "Overlap", frame: Frame, exponent: float) -> Floats:
        """Return (k,) the power of a frame at the receivers, dB, relative to that at 1 m without fading."""
        level = _log(overlap.distances(frame)) * (-10.0 * exponent / LN_10)
        if self.shadowing:
            level = level - self.shadowing * overlap.channel(frame).shadowing()
        return level if self.fading == "none" else level + log(self._faded(overlap, frame)) * (10.0 / LN_10)

    def _faded(self, overlap: "Overlap", frame: Frame) -> Floats:
        """Return the (k,) factors by which the power of a frame fades at the receivers."""
        if not overlap.is_correlated:
            return self.gains(overlap.uniforms(frame))
        normals = overlap.channel(frame).normals
        if self.fading == "rice":
            return rice_powers(self.k, normals)
        return nakagami_powers(self.m if self.fading == "nakagami" else 1.0, normals)


class Collision(Value):
    """Frames that overlap at a receiver are all lost there."""

    needs_positions: ClassVar[bool] = False
    has_noise: ClassVar[bool] = False
    kind: Literal["collision"] = "collision"

    def __call__(self, overlap: Overlap) -> Bools:
        """Return where no other frame is audible."""
        received = np.ones(len(overlap.receivers), dtype=bool)
        for other in overlap.others:
            received &= ~overlap.audible(other)
        return received


class CaptureEffect(Faded):
    """A frame is received if it is stronger, by a threshold, than each frame that overlaps it.

    The power of a frame decreases with distance d as d^-exponent (log-distance path loss). All nodes transmit with the
    same power.
    """

    needs_positions: ClassVar[bool] = True
    has_noise: ClassVar[bool] = False
    kind: Literal["capture"] = "capture"
    threshold: Annotated[float, Field(ge=0, le=300, strict=True)] = 6.0
    """Smallest ratio of the powers of a frame and of each other frame, dB.

    If in doubt, 10 for 802.11 and 6 for LoRa: with 0 the stronger frame always survives, with a large value none does.
    """
    exponent: Exponent = 3.0
    """Path loss exponent: 2 in free space, 3 to 4 over ground."""
    lock: Flag = False
    """Whether a receiver locks on to the first frame that it hears, and loses every frame that begins before that frame
    ends. It locks at once: the time of a preamble is not modelled."""

    def __call__(self, overlap: Overlap) -> Bools:
        """Return where the frame is stronger, by the threshold, than each audible frame."""
        power = self._level(overlap, overlap.frame, self.exponent)
        received = np.ones(len(power), dtype=bool)
        for other in overlap.others:
            is_weaker = self._level(overlap, other, self.exponent) + self.threshold <= power
            received &= is_weaker | ~overlap.audible(other)
        return received


class Sinr(Faded):
    """A frame is received if its power exceeds noise plus interference by a threshold throughout its airtime.

    Interference at an instant is the sum of the powers of all other frames that are on the air. It has no range: all
    overlapping frames count. The power of a frame at distance d is power * d^-exponent, and fades.
    """

    needs_positions: ClassVar[bool] = True
    kind: Literal["sinr"] = "sinr"
    threshold: Decibels = 6.0
    """Smallest ratio of the power of a frame and the sum of the powers of all others and noise, dB."""
    exponent: Exponent = 3.0
    """Path loss exponent: 2 in free space, 3 to 4 over ground."""
    fading: Literal["none", "rayleigh", "nakagami", "rice"] = "rayleigh"
    """Fading of the power of each frame at each receiver, see `desim.kernel.models.fading`."""
    power: Positive = 1.0
    """Power at a distance of 1 m, in any unit."""
    noise: Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)] = 0.0
    """Power of noise, in the unit of `power`."""

    @property
    def has_noise(self) -> bool:
        """Whether there is noise."""
        return self.noise > 0.0

    def __call__(self, overlap: Overlap) -> Bools:
        """Return where the signal-to-interference-and-noise ratio reaches the threshold."""
        power = self._power(overlap, overlap.frame)
        other_powers = [self._power(overlap, other) for other in overlap.others]
        max_disturbance = np.full(len(power), self.noise)
        # Interference increases only where a frame begins, so its maximum is at one of these instants.
        for instant in sorted({max(other.begin, overlap.frame.begin) for other in overlap.others}):
            disturbance = np.full(len(power), self.noise)
            for other, other_power in zip(overlap.others, other_powers, strict=True):
                if other.begin <= instant < other.end:
                    disturbance += other_power
            max_disturbance = np.maximum(max_disturbance, disturbance)
        return np.asarray(power >= 10.0 ** (self.threshold / 10.0) * max_disturbance)

    def _power(self, overlap: Overlap, frame: Frame) -> Floats:
        power: Floats = self.power * exp(-self.exponent * _log(overlap.distances(frame)))
        if self.shadowing:
            power = power * exp(overlap.channel(frame).shadowing() * (-self.shadowing * LN_10 / 10.0))
        return power if self.fading == "none" else power * self._faded(overlap, frame)


class LoRaInterference(Faded):
    """LoRa frames with capture (Bor, Roedig, Voigt & Alonso 2016, "Do LoRa Low-Power Wide-Area Networks Scale?").

    Two frames interfere if their spreading factors are equal and their frequencies at most 30, 60 or 120 kHz apart, at
    a bandwidth of 125, 250 or 500 kHz. A frame that is stronger than the other by the threshold is received. A weaker
    frame is received only if the other ends before the last five symbols of the weaker one's preamble. In that case
    LoRaSim, the simulator of Bor et al., receives both frames; here the earlier one is lost unless it is stronger. A
    frame is also lost to one of another spreading factor that is stronger by more than the isolation between the two.
    Which frames a receiver is tuned to is a matter of the medium (`gateways`).
    """

    needs_positions: ClassVar[bool] = True
    has_noise: ClassVar[bool] = False
    kind: Literal["lora"] = "lora"
    threshold: Annotated[float, Field(ge=0, le=300, strict=True)] = 6.0
    """Smallest ratio of the powers of two frames with which the stronger is received, dB."""
    exponent: Exponent = 2.08
    """Path loss exponent; 2.08 was measured by Bor et al."""
    isolation: Literal["orthogonal", "goursaud", "croce"] = "orthogonal"
    """Isolation between spreading factors: perfect, as computed by Goursaud & Gorce 2015, "Dedicated Networks for IoT",
    or as measured by Croce et al. 2018, "Impact of LoRa Imperfect Orthogonality"."""

    def __call__(self, overlap: Overlap) -> Bools:
        """Return where no other frame destroys the frame."""
        signal = overlap.signal(overlap.frame)
        symbol_time = 2**signal.spreading_factor / signal.bandwidth / RESOLUTION  # ns
        critical_time = overlap.frame.begin + round((signal.preamble - 5) * symbol_time)
        power = self._level(overlap, overlap.frame, self.exponent)
        received = np.ones(len(power), dtype=bool)
        for other in overlap.others:
            other_signal = overlap.signal(other)
            is_apart = abs(other_signal.frequency - signal.frequency) > SEPARATION * signal.bandwidth
            if is_apart or other.end <= critical_time:
                continue
            advantage = power - self._level(overlap, other, self.exponent)
            if other_signal.spreading_factor == signal.spreading_factor:
                received &= (advantage >= self.threshold) | ~overlap.audible(other)
            elif self.isolation != "orthogonal":
                min_ratio = ISOLATION[self.isolation][signal.spreading_factor - 7][other_signal.spreading_factor - 7]
                received &= (advantage >= min_ratio) | ~overlap.audible(other)
        return received


def _log(distances: Floats) -> Floats:
    """Return the natural logarithms of distances, m, of at least `NEAREST`."""
    return log(np.maximum(distances, NEAREST))


INTERFERENCES = OneOf(
    Collision,
    CaptureEffect,
    Sinr,
    LoRaInterference,
    needs=("needs_positions", "has_noise"),
    takes=("overlap",),
    traits=InterferenceTraits,
)
