"""One-way latencies that differ from link to link, drawn per pair of nodes or from a matrix.

Each model adds a jitter, itself a model of `desim.kernel.models.latency`, to the base latency of the link. The module
also has the list of all models of latency, `LATENCIES`.
"""

from collections.abc import Iterable
from dataclasses import replace
from math import fsum, inf
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, Field, ModelWrapValidatorHandler, ValidationInfo, model_validator

from desim.config.answers import name_and_place, wrong_answer
from desim.config.arrays import Floats, array_of
from desim.config.choice import OneOf
from desim.config.model import MAX_TIME, FirstError, Flag, Limit, Value
from desim.config.number_texts import counted
from desim.config.python_numbers import as_python, names_in_matrix
from desim.config.trust import resolve_path
from desim.kernel.core.body_content import is_missing
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.seeds import ROOM
from desim.kernel.measured.base import Name, NamedTable
from desim.kernel.measured.latency_file import matrix_of
from desim.kernel.measured.measurements import PER_SECOND, Unit
from desim.kernel.measured.models import LatencyTrace
from desim.kernel.models.latency import (
    BASES,
    DISTRIBUTIONS,
    JITTERS,
    TAKES,
    Constant,
    Latency,
    Lognormal,
    Propagation,
    mean_latency,
)
from desim.kernel.models.link_draws import as_seconds
from desim.kernel.models.traits import LinkTraits, model_of_run


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
        # `model_copy` of pydantic does not validate: the model of a run need not be valid in a scenario.
        return _Pairs(BaseModel.model_copy(self, update={"base": base, "jitter": jitter}), size)

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        latencies: Floats = context.of_run(self, PerPair.start_run, rng)(context, rng)
        return latencies

    def base_latencies(self, context: LinkContext) -> Floats:
        """Return the (k,) base latencies, s, of the links."""
        u = context.uniform("pair latency", symmetric=self.symmetric)
        answer = self.base.quantile(u)
        latencies = array_of(answer)
        if latencies.shape != u.shape or latencies.dtype.kind not in "iuf":
            raise wrong_answer(f"quantile(u) should return a latency for each of {len(u)} u", answer, self.base)
        return latencies

    def mean_latency(self) -> float | None:
        """Return the sum of the means of base and jitter, s; None if one of them is not known."""
        base, jitter = mean_latency(self.base), mean_latency(self.jitter)
        return None if base is None or jitter is None else base + jitter


def _check_quantiles(base: Any) -> None:
    if LinkTraits.of(base).quantile is None:
        addition = " of its own, because the inherited one does not fit it" if "quantile" in dir(base) else ""
        raise ValueError(f"base should have a method quantile(u){addition}, {name_and_place(base)} has none")


class _Pairs:
    """`PerPair` in one run; it caches the base latencies of each sender, at most `ROOM` numbers in all.

    Kept equal to base latencies computed at each use by
    `tests/kernel/test_latency.py::test_a_run_caches_the_latency_of_each_pair`.
    """

    def __init__(self, model: PerPair, size: int):
        self._model, self._nodes = model, np.arange(size)
        self._base: dict[int, Floats] = {}

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        if context.src not in self._base and (len(self._base) + 1) * len(self._nodes) <= ROOM:
            self._base[context.src] = self._model.base_latencies(replace(context, dst=self._nodes))
        base_to_all = self._base.get(context.src)
        base = self._model.base_latencies(context) if base_to_all is None else base_to_all[context.dst]
        return base + as_seconds(self._model.jitter(context, rng), self._model.jitter)


MATRIX = "the matrix of latencies"
"""What a matrix is called in error messages."""


def _is_absent(number: Any) -> bool:
    """Return whether an entry of a matrix, such as None, nan or pandas.NA, stands for a link that does not exist."""
    try:
        return number is None or is_missing(number) or bool(number != number)
    except (ArithmeticError, TypeError, ValueError):  # it has no truth value: an array, or a signalling nan of decimal
        return False


class LatencyMatrix(NamedTable):
    """Each link has a base latency from a matrix, for instance of measurements; each message adds a jitter."""

    kind: Literal["matrix"] = "matrix"
    values: Annotated[tuple[Annotated[tuple[Limit, ...], FirstError()], ...], FirstError()] = ()
    """(N, N) latencies, a row per sender; inf or nan where a link does not exist. In Python, it may be an array, or
    a table; the names of its rows and columns become `nodes`."""
    file: str | None = None
    """Instead of values: path of a text file with a line of N numbers per sender, separated by commas, semicolons, tabs
    or spaces, relative to the scenario file. Names in the first line and in the first column become `nodes`. The file
    is read once, when the model is created."""
    nodes: Annotated[tuple[Name, ...], Field(min_length=2)] | None = None
    """Names of the nodes, in the order of the rows; the graph, or else the file of the positions, numbers them.

    If in doubt, leave it out: without names, row k is of node k."""
    unit: Unit = "s"
    """Unit of the values: s, ms, us or ns; if in doubt, see which of them makes the greatest value plausible."""
    rtt: Flag = False
    """Whether the values are round-trip times, which are divided by 2."""
    jitter: Annotated[Latency, JITTERS] = Constant()
    """Additional latency, drawn for each message."""

    @model_validator(mode="wrap")  # outside of the conversion to Python's numbers, which drops names
    @classmethod
    def _with_names(cls, data: Any, make: ModelWrapValidatorHandler[Self]) -> Self:
        """Set `nodes` to the names in a table."""
        if isinstance(data, dict) and (names := names_in_matrix(data.get("values"))):
            nodes = as_python(data.get("nodes"))
            if isinstance(nodes, list | tuple) and [*nodes] != [*names]:
                raise ValueError(f"nodes should be left out: the values have the names {', '.join(names)}")
            data = data | {"nodes": names if nodes is None else nodes}
        return make(data)

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict):
            return data
        values, file = data.get("values"), data.get("file")
        if file is not None:
            if values is not None:
                raise ValueError("should have values or a file of values, not both")
            names, values = matrix_of(resolve_path(file, info), unit_is_given="unit" in data)
            if names and data.get("nodes") is not None:
                raise ValueError("nodes should be left out: the file has names")
            data = data | ({"nodes": names} if names else {})
        if isinstance(values, list | tuple) and all(isinstance(row, list | tuple) for row in values):
            values = [[inf if _is_absent(number) else number for number in row] for row in values]
        return data | {"file": None} | ({} if values is None else {"values": values})

    @model_validator(mode="after")
    def _is_square(self) -> Self:
        if not self.values:
            raise ValueError("should have values, or a file of values")
        if len(self.values) < 2:
            raise ValueError("values should be a matrix of two or more nodes")
        for k, row in enumerate(self.values):
            if len(row) != len(self.values):
                raise ValueError(f"values should be a square: row {k} has {len(row)} of {len(self.values)} numbers")
        if self.nodes is not None and (len(self.nodes) != len(self.values) or len({*self.nodes}) < len(self.nodes)):
            raise ValueError(f"nodes should have a name for each of {len(self.values)} rows, and each name once")
        base = self.base_latencies
        has_upper, has_lower = np.triu(base).any(), np.tril(base).any()
        if len(base) > 2 and has_upper != has_lower:
            side = "below" if has_upper else "above"
            advice = "give the latencies of both ways, and nan where a link does not exist"
            raise ValueError(f"all values {side} the diagonal are 0: {advice}")
        for src, dst in np.argwhere((base > MAX_TIME) & (base < inf))[:1].tolist():
            latency = f"{base[src, dst]:g} s from {src} to {dst}"
            raise ValueError(f"a latency should be at most {MAX_TIME:g} s (got {latency})")
        return self

    def given(self) -> dict[str, Any]:
        """Return the fields that differ from their defaults, see `Value.given`; instead of the matrix, its size."""
        return super().given() | {"values": f"{len(self.values)} x {len(self.values)}"}

    @property
    def base_latencies(self) -> Floats:
        """The (N, N) one-way latencies, s; inf where a link does not exist, and 0 from a node to itself."""
        base = np.array(self.values, dtype=float) / (PER_SECOND[self.unit] * (2 if self.rtt else 1))
        np.fill_diagonal(base, 0.0)
        return base

    @property
    def name(self) -> str:
        """What the matrix is called in error messages."""
        return MATRIX

    @property
    def node_order(self) -> tuple[str, ...] | None:
        """The names of the nodes in the order of their numbers; None if they have no names."""
        return self.nodes

    def numbered(self, names: tuple[str, ...]) -> Self:
        """Return the matrix with its rows in the order of `names`, the names of the nodes of a network by number.

        A matrix without names, or with these names in this order, is returned unchanged.

        Raises:
            ValueError: if the matrix has other names.
        """
        if not names or self.nodes is None or self.nodes == names:
            return self
        if unknown := {*self.nodes} - {*names}:
            raise ValueError(f"{MATRIX} has a node {min(unknown)!r}, which the network does not have")
        if missing := {*names} - {*self.nodes}:
            raise ValueError(f"{MATRIX} has no node {min(missing)!r}")
        order = [self.nodes.index(name) for name in names]
        values = [[self.values[src][dst] for dst in order] for src in order]
        return self.model_copy(update={"values": values, "nodes": names})

    def check_links(self, size: int, links: Iterable[tuple[int, int]]) -> None:
        """Raise ValueError if the matrix is not one of `size` nodes, or has no latency for one of the links."""
        base = self.base_latencies
        if len(base) != size:
            raise ValueError(f"{MATRIX} should have a row for each of {counted(size, 'node')}, it has {len(base)}")
        for src, dst in links:
            if base[src, dst] == inf:
                raise ValueError(f"{MATRIX} has none from {src} to {dst}")

    def start_run(self, size: int) -> "_PlayedMatrix":
        """Return the model of one run."""
        return _PlayedMatrix(self.base_latencies, model_of_run(self.jitter, size))

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        latencies: Floats = context.of_run(self, LatencyMatrix.start_run, rng)(context, rng)
        return latencies

    def mean_latency(self) -> float | None:
        """Return the mean latency over all links, s; None if the mean of the jitter is not known."""
        base, jitter = self.base_latencies, mean_latency(self.jitter)
        finite = base[(base < inf) & ~np.eye(len(base), dtype=bool)]
        return None if jitter is None or not len(finite) else fsum(finite) / len(finite) + jitter


class _PlayedMatrix:
    """`LatencyMatrix` in one run."""

    def __init__(self, base: Floats, jitter: Latency):
        self._base, self._jitter = base, jitter

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> Floats:
        """Return (k,) latencies, s: the base latencies plus a drawn jitter."""
        base: Floats = self._base[context.src, context.dst]
        return base + as_seconds(self._jitter(context, rng), self._jitter)


LATENCIES = OneOf(
    *(*DISTRIBUTIONS, Propagation, PerPair, LatencyMatrix, LatencyTrace),
    number=("constant", "value"),
    takes=TAKES,
    traits=LinkTraits,
)
