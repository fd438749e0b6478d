"""One-way latency of messages: frozen models that return the latencies to all receivers of a transmission at once.

The models here need to know nothing of a link but its length. Those that give each link its own latency, and the list
of all models, are in `desim.kernel.models.latency_by_link`.

A latency is always one-way; a round trip takes two. A model returns one number if all receivers have the same latency,
else one per receiver. A model may also have the methods of `desim.kernel.models.traits.LinkTraits`.
"""

from math import fsum, log, log1p, sqrt
from statistics import fmean
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from desim.config.answers import wrong_answer
from desim.config.arrays import Floats
from desim.config.choice import OneOf
from desim.config.model import MAX_TIME, FirstError, NotEmpty, Speed, Time, Value
from desim.config.python_numbers import real
from desim.config.trust import resolve_path
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.portable_math import exp
from desim.kernel.core.seeds import stream
from desim.kernel.measured.latency_file import latencies_of
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
    """Shape k, the number of stages.

    If in doubt, 2; 1 is exponential, and from about 30 on the latency hardly varies.
    """
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
    """Coefficient of variation of the lognormal part: standard deviation / mean.

    If in doubt, 0.5; 0.1 on a quiet link, 1 or more where some messages take many times as long as most.
    """

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
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or data.get("file") is None:
            return data
        if "values" in data:
            raise ValueError("should have values or a file of values, not both")
        return data | {"file": None, "values": latencies_of(resolve_path(data["file"], info))}

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
        return self.fixed + np.minimum(context.distances, MAX_TIME * self.speed) / self.speed  # finite

    def mean_latency(self) -> float | None:
        """Return the fixed part, s, because distances are not known."""
        return self.fixed


TAKES = ("context", "rng")
"""The arguments of a latency."""
DISTRIBUTIONS = (Constant, Uniform, ShiftedExponential, Gamma, Lognormal, Empirical, Netem)
"""The models with quantiles: they may be the base latencies of `PerPair`, and jitters."""
BASES = OneOf(*DISTRIBUTIONS, number=("constant", "value"), traits=LinkTraits)  # only their quantiles are used
JITTERS = OneOf(*DISTRIBUTIONS, number=("constant", "value"), takes=TAKES, traits=LinkTraits)


def mean_latency(model: Latency) -> float | None:
    """Return the mean latency, s, of a model with a method `mean_latency`; None if it has none, or returns None.

    Raises:
        ValueError: if it returns anything else than a number.
    """
    mean = LinkTraits.of(model).mean_latency
    latency = None if mean is None else mean()
    try:
        return None if latency is None else real(latency, "a latency")
    except ValueError as error:
        raise wrong_answer("mean_latency() should return a number, s, or None", latency, model) from error


def mean_of(model: Latency, seed: int) -> float:
    """Return the mean latency, s, of a model that does not depend on links; if unknown, that of a thousand draws.

    It is limited to `MAX_TIME`, as each latency is.
    """
    if (mean := mean_latency(model)) is not None:
        return min(mean, MAX_TIME)
    rng, run_model = stream(seed, "typical processing"), model_of_run(model, 1)
    context = LinkContext(0, np.zeros(1, dtype=np.intp))
    draws = (as_seconds(run_model(context, rng), model).item() for _ in range(1000))
    return min(fsum(draws) / 1000, MAX_TIME)
