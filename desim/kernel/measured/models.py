"""Links as they were measured: models of latency and loss that follow a table of measurements over time.

A signal strength, such as RSSI, is a model of loss, and not of reception. A reception model is a function of distance
and range, which the network also uses to find neighbours; a measured signal depends on neither.
"""

import math
import re
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from desim.config.arrays import Bools, Floats
from desim.config.model import MAX_TIME, Flag
from desim.config.number_files import is_fill
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.portable_math import exp
from desim.kernel.measured.base import LinkTrace
from desim.kernel.measured.measurements import PER_SECOND, Unit
from desim.kernel.measured.playback import Playback

MAX_SIGNAL = 1000.0
"""Largest absolute value of a signal strength, dB; in some logs, a greater one stands for no signal."""
RECEIVED = frozenset({"prr", "pdr", "received", "reception", "delivered", "delivery", "success"})
"""Words in the name of a column of probabilities of reception."""
LOST = frozenset({"loss", "lost", "plr", "per", "drop", "dropped"})
"""Words in the name of a column of losses."""
IN_DBM = frozenset({"rssi", "rsrp", "rscp", "dbm"})
"""Words in the name of a column of powers in dBm; in their place, 127 or 0 often stands for no signal."""
MAX_EXPONENT = 700.0
"""Limit of exponents: exp(710) is infinite."""


class LatencyTrace(LinkTrace):
    """The latency of each message is the measured one of its link at that time; a missing value loses the message."""

    NOUN: ClassVar[str] = "a latency"

    kind: Literal["trace"] = "trace"
    unit: Unit = "s"
    """Unit of the values: s, ms, us or ns."""
    rtt: Flag = False
    """Whether the values are round-trip times, which are divided by 2."""

    def _units(self) -> list[tuple[str, str, str]]:
        return [*super()._units(), ("unit", self.value, self.unit)]

    @property
    def doubt(self) -> tuple[str, str] | None:
        """Round-trip times read as one-way latencies, or a number that may mean no answer; see `LinkTrace.doubt`."""
        if "rtt" in self.value.lower() and not self.rtt:
            return "rtt", f"column {self.value!r} seems to have round-trip times: rtt = true halves them"
        if is_fill(largest := float(self.measurements.values.max())):
            return "value", f"{largest:g} {self.unit} may stand for a message without an answer: leave its cells empty"
        return None

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value that the table may have."""
        return 0.0, MAX_TIME * self._per_second

    @property
    def _per_second(self) -> int:
        """The value of a one-way latency of 1 s."""
        return PER_SECOND[self.unit] * (2 if self.rtt else 1)

    def scaled(self, values: Floats) -> Floats:
        """Return values of the table as one-way latencies, s."""
        return values / self._per_second

    def mean_latency(self) -> float | None:
        """Return the mean latency over time and links, s."""
        return Playback(self).mean()

    def start_run(self, size: int) -> "PlayedLatencies":
        """Return the model of one run."""
        return PlayedLatencies(self)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> float | Floats:
        """Return the latency of each link, (k,), or one for all, s; if it is missing, that of the row before."""
        latencies: float | Floats = context.of_run(self, LatencyTrace.start_run, rng)(context, rng)
        return latencies

    def is_lost(self, context: LinkContext) -> bool | Bools:
        """Return which messages are lost, because their rows have no value; for a model that calls this one."""
        played = context.of_run(self, LatencyTrace.start_run, None)
        return False if played.is_lost is None else played.is_lost(context)


class PlayedLatencies:
    """`LatencyTrace` in one run.

    Attributes:
        is_lost: as in `desim.kernel.models.traits.LinkTraits`.
        time_span: as in `desim.kernel.models.traits.LinkTraits`.
    """

    def __init__(self, trace: LatencyTrace):
        self._playback = Playback(trace)
        self.is_lost = self._playback.is_missing if self._playback.loses else None
        self.time_span = trace.span

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> float | Floats:
        """Return the latencies; see `LatencyTrace`."""
        latencies: float | Floats = self._playback.values(context)
        return latencies


class _LossTrace(LinkTrace):
    """Base of the traces of loss."""

    def start_run(self, size: int) -> "PlayedLosses":
        """Return the model of one run."""
        return PlayedLosses(self)

    def loss(self, values: Any) -> Any:
        """Return the probabilities of loss at values in the unit of the model, or booleans if losses are certain."""
        return values

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools:
        """Draw the (k,) losses; return one for all receivers if it is certain."""
        lost: bool | Bools = context.of_run(self, _LossTrace.start_run, rng)(context, rng)
        return lost


class LossTrace(_LossTrace):
    """A message is lost with the probability that was measured on its link at that time, which may be 0 or 1."""

    NOUN: ClassVar[str] = "a probability of loss"
    LIMITS: ClassVar[tuple[float, float]] = (0.0, 1.0)

    kind: Literal["trace"] = "trace"
    received: Flag = False
    """Whether the values are probabilities of reception, such as a packet reception ratio, instead of loss."""

    def _units(self) -> list[tuple[str, str, str]]:
        return [*super()._units(), ("value", self.value, "numbers from 0 to 1")]

    @property
    def doubt(self) -> tuple[str, str] | None:
        """Probabilities of reception that are read as those of loss, or the reverse; see `LinkTrace.doubt`."""
        words = set(re.findall("[a-z]+", self.value.lower()))
        if not self.received and words & RECEIVED:
            return "received", f"column {self.value!r} seems to have probabilities of reception: set received = true"
        if self.received and words & LOST:
            return "received", f"column {self.value!r} seems to have losses: leave out received"
        return None

    def scaled(self, values: Floats) -> Floats:
        """Return values of the table as probabilities of loss."""
        return 1.0 - values if self.received else values


class SignalTrace(_LossTrace):
    """A message is lost where the signal measured on its link at that time is weak, for instance RSSI, RSRP or SNR.

    At a signal of x dB, the probability of loss is 1 / (1 + exp((x - threshold) / width)).
    """

    NOUN: ClassVar[str] = "a signal strength in dB"
    LIMITS: ClassVar[tuple[float, float]] = (-MAX_SIGNAL, MAX_SIGNAL)

    kind: Literal["signal_trace"] = "signal_trace"
    threshold: Annotated[float, Field(ge=-MAX_SIGNAL, le=MAX_SIGNAL, strict=True)] = -90.0
    """Signal strength at which half of the messages are lost, in the unit of the values: dBm or dB."""
    width: Annotated[float, Field(ge=0, le=MAX_SIGNAL, strict=True)] = 0.0
    """Width of the transition, dB; with 0, a message is lost if and only if the signal is below the threshold."""

    @property
    def doubt(self) -> tuple[str, str] | None:
        """A power that is too large for a received signal; see `LinkTrace.doubt`."""
        words, measured = set(re.findall("[a-z]+", self.value.lower())), self.measurements
        strongest = float(measured.values[~measured.is_missing].max(initial=-math.inf))
        if words & IN_DBM and strongest >= 0.0:
            return "value", f"no radio receives {strongest:g} dBm: if it stands for no signal, leave its cells empty"
        return None

    def loss(self, values: Any) -> Any:
        """Return the probabilities of loss, or booleans if the width is 0."""
        if not self.width:
            return values < self.threshold
        exponents = np.atleast_1d((values - self.threshold) / self.width)
        return 1.0 / (1.0 + exp(np.minimum(exponents, MAX_EXPONENT)))


class PlayedLosses:
    """`LossTrace` or `SignalTrace` in one run."""

    def __init__(self, trace: _LossTrace):
        self._trace, self._playback = trace, Playback(trace)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> bool | Bools:
        """Draw the losses; see `_LossTrace`."""
        lost = self._trace.loss(self._playback.values(context))
        if lost.dtype != bool:
            lost = rng.random(len(context.dst)) < lost
        if self._playback.loses:
            lost = lost | self._playback.is_missing(context)
        return lost  # type: ignore[no-any-return]
