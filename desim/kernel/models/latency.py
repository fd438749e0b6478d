"""One-way latency of messages: frozen models that return the latencies to all receivers of a transmission at once.

A latency is always one-way; a round trip takes two. A model returns one number if all receivers have the same latency,
else one per receiver. A model may also have the methods of `desim.kernel.models.traits.LinkTraits`.
"""

from collections.abc import Iterable
from dataclasses import replace
from math import fsum, inf, isnan, log, log1p, sqrt
from statistics import fmean
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from pydantic import BaseModel, Field, ValidationInfo, model_validator

from desim.config.arrays import Floats
from desim.config.choice import OneOf
from desim.config.model import MAX_TIME, FirstError, Flag, Limit, NotEmpty, Speed, Time, Value
from desim.config.trust import resolve_path
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.portable_math import exp
from desim.kernel.core.seeds import ROOM, stream
from desim.kernel.measured.latency_file import latencies_of, matrix_of
from desim.kernel.measured.measurements import PER_SECOND, Unit
from desim.kernel.measured.models import LatencyTrace
from desim.kernel.models.link_draws import as_seconds
from desim.kernel.models.netem import Netem
from desim.kernel.models.traits import LinkTraits, model_of_run


class Latency(Protocol):
    """A model of the one-way latency: `latency(context, rng)` is one number >= 0, s, or k of them, one per receiver."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> float | Floats: ...  # noqa: D102


class Constant(Value):
    """Every message has the same latency."""

    kind: Literal["constant"] = "constant"
    value: Time = 0.0
    """One-way latency, s."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> float:
        """Return the latency, s."""
        return self.value

    def quantile(self, u: Floats) -> Floats:
        """Return the latency, s, which is the same for every u."""
        return np.full_like(u, self.value)

    def mean_latency(self) -> float | None:
        """Return the latency, s."""
        return self.value


class _Drawn(Value):
    """Base of the models whose draws do not depend on the link."""

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw (count,) latencies, s."""
        return self.quantile(rng.random(count))

    def quantile(self, u: Floats) -> Floats:
        """Return the u-quantile of the latency, s."""
        raise NotImplementedError

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Draw (k,) latencies, s, one per receiver."""
        return self.draw(len(context.dst), rng)


class Uniform(_Drawn):
    """Latencies are uniformly distributed between two bounds."""

    kind: Literal["uniform"] = "uniform"
    low: Time = 0.0
    """Minimum one-way latency, s."""
    high: Time = 0.1
    """Maximum one-way latency, s."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low should be at most high (got {self.low:g} and {self.high:g})")
        return self

    def quantile(self, u: Floats) -> Floats:
        """Return the u-quantile low + u (high - low), s."""
        return self.low + u * (self.high - self.low)

    def mean_latency(self) -> float | None:
        """Return the mean of both bounds, s."""
        return (self.low + self.high) / 2


class ShiftedExponential(_Drawn):
    """A fixed part plus an exponentially distributed one: d0 + Exp(m)."""

    kind: Literal["shifted_exponential"] = "shifted_exponential"
    offset: Time = 0.0
    """Fixed part d0, s."""
    mean: Time = 0.05
    """Mean m of the exponential part, s."""

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw (count,) latencies, s."""
        return self.offset + rng.exponential(self.mean, count)

    def quantile(self, u: Floats) -> Floats:
        """Return the u-quantile d0 - m ln(1 - u), s."""
        from scipy.special import xlog1py

        return self.offset - np.asarray(xlog1py(self.mean, -u))

    def mean_latency(self) -> float | None:
        """Return the mean d0 + m, s."""
        return self.offset + self.mean


class Gamma(_Drawn):
    """A fixed part plus a gamma-distributed one; for integer k, the sum of k exponential stages."""

    kind: Literal["gamma"] = "gamma"
    offset: Time = 0.0
    """Fixed part, s."""
    shape: Annotated[float, Field(gt=0, le=1e6, strict=True)] = 2.0
    """Shape k, the number of stages."""
    scale: Time = 0.01
    """Scale theta, the mean of a stage, s."""

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw (count,) latencies, s."""
        return self.offset + rng.gamma(self.shape, self.scale, count)

    def quantile(self, u: Floats) -> Floats:
        """Return the u-quantile, s."""
        from scipy.special import gammaincinv

        return self.offset + self.scale * np.asarray(gammaincinv(self.shape, u))

    def mean_latency(self) -> float | None:
        """Return the mean offset + k theta, s."""
        return self.offset + self.shape * self.scale


class Lognormal(_Drawn):
    """A fixed part plus a lognormal one, exp(N(mu, s^2)) with s^2 = ln(1 + cv^2) and mu = ln mean - s^2 / 2."""

    kind: Literal["lognormal"] = "lognormal"
    offset: Time = 0.0
    """Fixed part, s."""
    mean: Time = 0.05
    """Mean of the lognormal part, s."""
    cv: Annotated[float, Field(ge=0, le=1e3, strict=True)] = 0.5
    """Coefficient of variation of the lognormal part: standard deviation / mean."""

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw (count,) latencies, s."""
        if not self.mean:
            return np.full(count, self.offset)
        return self.offset + rng.lognormal(log(self.mean) - self._variance / 2, sqrt(self._variance), count)

    def quantile(self, u: Floats) -> Floats:
        """Return the u-quantile offset + mean exp(s z(u) - s^2 / 2), s; z(u) is the standard normal quantile."""
        from scipy.special import ndtri

        logarithms = sqrt(self._variance) * np.asarray(ndtri(u)) - self._variance / 2
        return self.offset + self.mean * exp(logarithms)

    def mean_latency(self) -> float | None:
        """Return the mean of both parts together, s."""
        return self.offset + self.mean

    @property
    def _variance(self) -> float:
        """The variance s^2 of the logarithm."""
        return log1p(self.cv**2)


class Empirical(_Drawn):
    """Latencies are drawn uniformly from a list, for instance of measurements."""

    kind: Literal["empirical"] = "empirical"
    values: Annotated[tuple[Time, ...], FirstError(), NotEmpty()] = ()
    """One-way latencies, s."""
    file: str | None = None
    """Instead of values: path of a text file of latencies in s, relative to the scenario file. The file is read once,
    when the model is created."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any, info: ValidationInfo) -> Any:
        if not isinstance(given, dict) or given.get("file") is None:
            return given
        if "values" in given:
            raise ValueError("should have values or a file of values, not both")
        return given | {"file": None, "values": latencies_of(resolve_path(given["file"], info))}

    @model_validator(mode="after")
    def _is_not_empty(self) -> Self:
        if not self.values:
            raise ValueError("should have values, or a file of values")
        return self

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw (count,) latencies, s."""
        return np.asarray(self.values)[rng.integers(len(self.values), size=count)]

    def quantile(self, u: Floats) -> Floats:
        """Return the empirical u-quantile of the list, s."""
        return np.sort(self.values)[(u * len(self.values)).astype(np.intp)]

    def mean_latency(self) -> float | None:
        """Return the mean of the list, s."""
        return fmean(self.values)


class Propagation(Value):
    """A fixed part plus distance / propagation speed, for instance for sound under water or light in space."""

    kind: Literal["propagation"] = "propagation"
    speed: Annotated[Speed, Field(gt=0)] = 1500.0
    """Propagation speed c, m/s; 1500 is sound in sea water."""
    fixed: Time = 0.0
    """Fixed part, s."""

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return fixed + d / c, s."""
        return self.fixed + context.distances / self.speed

    def mean_latency(self) -> float | None:
        """Return the fixed part, s, because distances are not known."""
        return self.fixed


TAKES = ("context", "rng")
"""The arguments of a latency."""
_WITH_QUANTILES = (Constant, Uniform, ShiftedExponential, Gamma, Lognormal, Empirical, Netem)
BASES = OneOf(*_WITH_QUANTILES, number=("constant", "value"), traits=LinkTraits)
JITTERS = OneOf(*_WITH_QUANTILES, number=("constant", "value"), takes=TAKES, traits=LinkTraits)


class PerPair(Value):
    """Each pair of nodes has its own base latency, drawn once per seed; each message adds a jitter."""

    kind: Literal["per_pair"] = "per_pair"
    base: Annotated[Any, BASES] = Lognormal()
    """Distribution of the base latencies of the pairs."""
    jitter: Annotated[Latency, JITTERS] = Constant()
    """Additional latency, drawn for each message."""
    symmetric: Flag = True
    """Whether both directions between two nodes have the same base latency."""

    @model_validator(mode="after")
    def _has_quantiles(self) -> Self:
        _check_quantiles(self.base)
        return self

    def start_run(self, size: int) -> Latency:
        """Return a model for one run of `size` nodes; it caches the base latencies."""
        base, jitter = model_of_run(self.base, size), model_of_run(self.jitter, size)
        _check_quantiles(base)
        # Not validated: what a model is in one run need not be a value of a scenario.
        return _Pairs(BaseModel.model_copy(self, update={"base": base, "jitter": jitter}), size)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        return self.base_latencies(context) + as_seconds(self.jitter(context, rng))

    def base_latencies(self, context: LinkContext) -> Floats:
        """Return the (k,) base latencies, s, of the links."""
        u = context.uniform("pair latency", symmetric=self.symmetric)
        latencies = np.asarray(self.base.quantile(u))
        if latencies.shape != u.shape:
            raise ValueError(
                f"quantile(u) should return a latency for each of {len(u)} u, got {latencies!r} from {self.base!r}"
            )
        return latencies

    def mean_latency(self) -> float | None:
        """Return the sum of the means of base and jitter, s; None if one of them is not known."""
        base, jitter = mean_latency(self.base), mean_latency(self.jitter)
        return None if base is None or jitter is None else base + jitter


def _check_quantiles(base: Any) -> None:
    if LinkTraits.of(base).quantile is None:
        inherits = " of its own, because the inherited one does not follow" if "quantile" in dir(base) else ""
        raise ValueError(f"base should have a method quantile(u){inherits}, {base!r} has none")


class _Pairs:
    """`PerPair` in one run; it caches the base latencies of each sender, at most `ROOM` numbers in all.

    Kept equal to base latencies computed at each use by
    `tests/kernel/test_latency.py::test_a_run_caches_the_latency_of_each_pair`.
    """

    def __init__(self, model: PerPair, size: int):
        self._model, self._all = model, np.arange(size)
        self._base: dict[int, Floats] = {}

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        if context.src not in self._base and (len(self._base) + 1) * len(self._all) <= ROOM:
            self._base[context.src] = self._model.base_latencies(replace(context, dst=self._all))
        kept = self._base.get(context.src)
        base = self._model.base_latencies(context) if kept is None else kept[context.dst]
        return base + as_seconds(self._model.jitter(context, rng))


class LatencyMatrix(Value):
    """Each link has a base latency from a matrix, for instance of measurements; each message adds a jitter."""

    kind: Literal["matrix"] = "matrix"
    values: Annotated[tuple[Annotated[tuple[Limit, ...], FirstError()], ...], FirstError()] = ()
    """(N, N) latencies, a row per sender; inf or nan where a link does not exist. In Python, it may be an array."""
    file: str | None = None
    """Instead of values: path of a text file with a line of N numbers per sender, separated by commas, semicolons, tabs
    or spaces, relative to the scenario file. The file is read once, when the model is created."""
    unit: Unit = "s"
    """Unit of the values: s, ms, us or ns; if in doubt, see which of them makes the greatest value plausible."""
    rtt: Flag = False
    """Whether the values are round-trip times, which are divided by 2."""
    jitter: Annotated[Latency, JITTERS] = Constant()
    """Additional latency, drawn for each message."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any, info: ValidationInfo) -> Any:
        if not isinstance(given, dict):
            return given
        values, file = given.get("values"), given.get("file")
        if file is not None:
            if values is not None:
                raise ValueError("should have values or a file of values, not both")
            values = matrix_of(resolve_path(file, info))
        if isinstance(values, list | tuple) and all(isinstance(row, list | tuple) for row in values):
            values = [[inf if _is_nan(number) else number for number in row] for row in values]
        return given | {"file": None} | ({} if values is None else {"values": values})

    @model_validator(mode="after")
    def _is_square(self) -> Self:
        if not self.values:
            raise ValueError("should have values, or a file of values")
        if len(self.values) < 2:
            raise ValueError("values should be a matrix of two or more nodes")
        for k, row in enumerate(self.values):
            if len(row) != len(self.values):
                raise ValueError(f"values should be a square: row {k} has {len(row)} of {len(self.values)} numbers")
        base = self.base_latencies
        for src, dst in np.argwhere((base > MAX_TIME) & (base < inf))[:1].tolist():
            which = f"got {base[src, dst]:g} s from {src} to {dst}"
            raise ValueError(f"a latency should be at most {MAX_TIME:g} s ({which})")
        return self

    def given(self) -> dict[str, Any]:
        """Return the fields that differ from their defaults, see `Value.given`; only the size of the matrix."""
        return super().given() | {"values": f"{len(self.values)} x {len(self.values)}"}

    @property
    def base_latencies(self) -> Floats:
        """The (N, N) one-way latencies, s; inf where a link does not exist, and 0 from a node to itself."""
        base = np.array(self.values, dtype=float) / (PER_SECOND[self.unit] * (2 if self.rtt else 1))
        np.fill_diagonal(base, 0.0)
        return base

    def check_links(self, size: int, links: Iterable[tuple[int, int]]) -> None:
        """Raise ValueError if the matrix is not one of `size` nodes, or has no latency for one of some links."""
        base = self.base_latencies
        if len(base) != size:
            raise ValueError(f"the matrix of latencies should have a row for each of {size} nodes, it has {len(base)}")
        for src, dst in links:
            if base[src, dst] == inf:
                raise ValueError(f"the matrix of latencies has none from {src} to {dst}")

    def start_run(self, size: int) -> "_PlayedMatrix":
        """Return the model of one run."""
        return _PlayedMatrix(self.base_latencies, model_of_run(self.jitter, size))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        return _PlayedMatrix(self.base_latencies, self.jitter)(context, rng)

    def mean_latency(self) -> float | None:
        """Return the mean over all links, s; None if that of the jitter is not known."""
        base, jitter = self.base_latencies, mean_latency(self.jitter)
        known = base[(base < inf) & ~np.eye(len(base), dtype=bool)]
        return None if jitter is None or not len(known) else fsum(known) / len(known) + jitter


def _is_nan(number: Any) -> bool:
    return number is None or (isinstance(number, float) and isnan(number))


class _PlayedMatrix:
    """`LatencyMatrix` in one run."""

    def __init__(self, base: Floats, jitter: Latency):
        self._base, self._jitter = base, jitter

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        base: Floats = self._base[context.src, context.dst]
        return base + as_seconds(self._jitter(context, rng))


def mean_latency(model: Latency) -> float | None:
    """Return the mean latency, s, of a model with a method `mean_latency`; None if it has none, or returns None.

    Raises:
        ValueError: if it returns anything else than a number.
    """
    mean = LinkTraits.of(model).mean_latency
    found = None if mean is None else mean()
    try:
        return None if found is None else float(found)
    except (TypeError, ValueError) as error:
        raise ValueError(f"mean_latency of {model!r} should return a number, s, or None, got {found!r}") from error


def mean_of(model: Latency, seed: int) -> float:
    """Return the mean latency, s, of a model that does not depend on links, or an estimate by a thousand draws."""
    if (mean := mean_latency(model)) is not None:
        return mean
    rng, of_run = stream(seed, "typical processing"), model_of_run(model, 1)
    draws = (as_seconds(of_run(LinkContext(0, np.zeros(1, dtype=np.intp)), rng)).item() for _ in range(1000))
    return fsum(draws) / 1000


LATENCIES = OneOf(
    *(*_WITH_QUANTILES, Propagation, PerPair, LatencyMatrix, LatencyTrace),
    number=("constant", "value"),
    takes=TAKES,
    traits=LinkTraits,
)
