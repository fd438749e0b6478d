"""The latency that `tc netem` of Linux gives to packets: delay, jitter, distribution and reordering."""

from collections import defaultdict
from dataclasses import replace
from functools import lru_cache, partial
from math import fsum
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, model_validator

from desim.config.arrays import Bools, Floats
from desim.config.model import Counted, FirstError, NotEmpty, Probability, Time, Unsigned, Value
from desim.config.trust import resolve_path
from desim.kernel.core.link_context import LinkContext
from desim.kernel.models.correlation import RANGE, CorrelatedNumbers, LinkMemory
from desim.kernel.models.netem_tables import HIGHEST, LONGEST, LOWEST, SCALE, SIZE, TABLES, read_table

MAX_JITTER = (2**31 - 1) / 1e9
"""Largest jitter in Linux, s."""
TableNumber = Annotated[int, Field(ge=LOWEST, le=HIGHEST, strict=True)]


class Netem(Value):
    """The latency of `tc netem delay TIME JITTER CORRELATION distribution NAME reorder PERCENT CORRELATION gap N`.

    A message is delayed by `delay` + `jitter` t[U] / 8192, at least 0, where t is a table, mostly of 4096 numbers, and
    U is random. Without a table, the delay is uniform between `delay` - `jitter` and `delay` + `jitter`. A reordered
    message is not delayed at all (Hemminger 2005, "Network Emulation with NetEm"; Linux, net/sched/sch_netem.c). Linux
    keeps the last random numbers of each queueing discipline, this model those of each link.
    """

    kind: Literal["netem"] = "netem"
    delay: Time = 0.1
    """Mean latency if the distribution is symmetric, s."""
    jitter: Annotated[float, Field(ge=0, le=MAX_JITTER, allow_inf_nan=False, strict=True), Unsigned, Counted] = 0.0
    """Unit of the distribution, s: half of the width if it is uniform, the standard deviation if it is normal; for
    pareto and paretonormal the standard deviation is 0.82 and 0.83 of it."""
    correlation: Probability = 0.0
    """Share of the last random number of the link in the next one, in [0, 1]. As in Linux, it has no effect with a
    table. Without a table, it has an effect only if the jitter is about 1 s, or the correlation about 0.9. The reason:
    U is the random number modulo the length of the table, or modulo 2 `jitter` in ns."""
    distribution: Literal["uniform", "normal", "pareto", "paretonormal"] = "uniform"
    """Distribution of the jitter; the tables of the last three are those of iproute2."""
    table: Annotated[tuple[TableNumber, ...], FirstError(), NotEmpty(), Field(max_length=LONGEST)] | None = None
    """Instead of a distribution: a table of 1 to 16384 numbers, usually 4096."""
    file: str | None = None
    """Instead of a distribution: path of a table NAME.dist, relative to the scenario file. The file is read once, when
    the model is created."""
    reorder: Probability = 0.0
    """Probability that a message is not delayed, in [0, 1]."""
    reorder_correlation: Probability = 0.0
    """Share of the last random number of the link in the next one for `reorder`, in [0, 1]; see the loss
    `correlated`."""
    gap: Annotated[int, Field(ge=1, le=2**32 - 1, strict=True)] = 1
    """At least gap - 1 messages of a link are delayed between two that are not."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or data.get("file") is None:
            return data
        if excluded := [name for name in ("distribution", "table") if data.get(name) is not None]:
            raise ValueError(f"should have either a file or a {excluded[0]}")
        return data | {"file": None, "table": read_table(resolve_path(data["file"], info))}

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.table is not None and self.distribution != "uniform":
            raise ValueError("should have either a distribution or a table")
        if self.delay == 0.0 and (self.reorder or (self.jitter and self.numbers() is not None)):
            raise ValueError("reorder, and a jitter with a table, need a delay > 0, as in tc")
        return self

    def numbers(self) -> tuple[int, ...] | None:
        """Return the numbers of the table; None if the distribution is uniform."""
        return self.table if self.distribution == "uniform" else TABLES[self.distribution]()

    def start_run(self, size: int) -> Any:
        """Return the model of one run: one that keeps the state of each link, if the links have any."""
        return self if self._is_memoryless else _NetemLinks(self)

    def quantile(self, u: Floats) -> Floats:
        """Return the u-quantile of the latency, s, as if reordering were not correlated."""
        reordered = self._reordered_share
        if reordered == 1.0:
            return np.zeros_like(u)
        # Reordered messages are the fastest, so they take the lowest u: the quantile function stays monotone.
        return np.where(u < reordered, 0.0, self._delay_quantile(np.maximum(u - reordered, 0.0) / (1.0 - reordered)))

    def mean_latency(self) -> float | None:
        """Return the mean latency, s; None if reordering is correlated, which changes the share of reordered messages.

        The mean of a uniform distribution is taken over 4096 values.
        """
        if self.reorder_correlation and 0.0 < self.reorder < 1.0:
            return None
        size = len(self.numbers() or range(SIZE))
        return (1.0 - self._reordered_share) * fsum(self._delay_quantile((np.arange(size) + 0.5) / size)) / size

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw (count,) latencies, s, without state."""
        return self.quantile(rng.random(count))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Draw (k,) latencies, s, one per receiver."""
        model = self if self._is_memoryless else context.of_run(self, Netem.start_run, rng)
        return model.draw(len(context.dst), rng) if model is self else model(context, rng)

    @property
    def _is_memoryless(self) -> bool:
        """Whether the latencies of a link are independent."""
        return not self.correlation and (not self.reorder or (self.gap == 1 and not self.reorder_correlation))

    @property
    def _reordered_share(self) -> float:
        """The share of reordered messages: each follows gap - 1 delayed ones and a geometric number of trials."""
        return self.reorder / (1.0 + self.reorder * (self.gap - 1))

    def _delay_quantile(self, u: Floats) -> Floats:
        """Return the u-quantile of the latency, s, of messages that are not reordered."""
        units = 2.0 * u - 1.0
        if self.distribution != "uniform" or self.table is not None:
            quantiles = _quantiles(self.distribution, self.table)
            units = quantiles.take((u * len(quantiles)).astype(np.intp), mode="clip")
        return np.maximum(self.delay + self.jitter * units, 0.0)


@lru_cache(maxsize=64)
def _quantiles(distribution: str, table: tuple[int, ...] | None) -> Floats:
    """Return the quantiles of a distribution or a table in units of sigma; a conversion takes 0.3 ms."""
    quantiles: Floats = np.sort(TABLES[distribution]() if table is None else table) / SCALE
    quantiles.setflags(write=False)
    return quantiles


class _NetemLinks:
    """`Netem` in one run, with the last random numbers of each link and the number of messages since a reordered one.

    The random numbers have the range of Linux, 0 .. 2^32 - 1, because the effect of a correlation depends on the range.
    """

    def __init__(self, model: Netem):
        self._model = model
        numbers = model.numbers()
        # As in Linux, a random number is taken modulo the length of the table, or the width of the distribution in ns.
        half = max(round(model.jitter * 1e9), 1)
        self._table = None if numbers is None else np.array(numbers) / SCALE
        self._half, self._modulus = half, np.uint64(2 * half if numbers is None else len(numbers))
        self._limit = np.uint64(round(model.reorder * (RANGE - 1)))
        self._jitters = CorrelatedNumbers(model.correlation)
        self._reorders = CorrelatedNumbers(model.reorder_correlation)
        self._since_reordered: defaultdict[int, LinkMemory] = defaultdict(partial(LinkMemory, 0.0))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return the (k,) latencies, s."""
        latencies = np.zeros(len(context.dst))
        delayed = ~self._reordered(context, rng)
        latencies[delayed] = self._delays(self._jitters(_to(context, delayed), rng))
        return latencies

    def _delays(self, numbers: NDArray[np.uint64]) -> Floats:
        """Return the (k,) delays, s, given (k,) random numbers."""
        index = (numbers % self._modulus).astype(np.int64)
        units = (index - self._half) / self._half if self._table is None else self._table[index]
        return np.maximum(self._model.delay + self._model.jitter * units, 0.0)

    def _reordered(self, context: LinkContext, rng: np.random.Generator) -> Bools:
        """Return (k,) booleans, whether the message is reordered on each link."""
        if not self._limit:
            return np.zeros(len(context.dst), bool)
        row = self._since_reordered[context.src]
        row.select(context.dst)
        reordered = row.value >= self._model.gap - 1
        # Only links whose gap is over draw a number, as in Linux: the memory of the others must not advance.
        reordered[reordered] = self._reorders(_to(context, reordered), rng) <= self._limit
        row.value[:] = np.where(reordered, 0.0, row.value + 1.0)
        return reordered


def _to(context: LinkContext, selected: Bools) -> LinkContext:
    """Return the context of the transmission to some of its receivers only."""
    return context if selected.all() else replace(context, dst=context.dst[selected], known_distances=None)
