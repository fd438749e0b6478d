"""The table `sweep` of a scenario: a grid over keys of the scenario, and the number and the seeds of the runs."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    SerializationInfo,
    ValidationInfo,
    field_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from desim.config.model import Value
from desim.config.named_code import is_unlisted_import, refusal
from desim.config.parameters import table_of
from desim.config.tables import nested
from desim.config.traits import is_ours
from desim.config.trust import is_trusted
from desim.scenario.value_ranges import KeyRange, interval_of, is_range, range_of


def _flat(grid: Any, above: str = "") -> Any:
    """Return a grid with dotted keys, flattening the nested tables that TOML makes of unquoted dotted keys.

    Raises:
        ValueError: if a key is given twice.
    """
    if not isinstance(grid, Mapping):
        return grid
    flat: dict[str, Any] = {}
    for key, value in grid.items():
        name = f"{above}{key}"
        entries = _flat(value, f"{name}.") if isinstance(value, dict) and value else {name: value}
        if twice := flat.keys() & entries.keys():
            raise ValueError(f"{min(twice)} is given twice")
        flat |= entries
    return flat


def _values_of(values: Any) -> Any:
    """Return the values that the text of a range, or a `KeyRange`, stands for; return other values unchanged."""
    if isinstance(values, str) and ":" in values:
        interval = interval_of(values)
        return (interval,) if interval is not None else range_of(values) or values
    return (values,) if isinstance(values, KeyRange) else values


class _OrText:
    """Annotation of a field that a file may also give as a text, for the JSON schema."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [handler(schema), {"type": "string"}]}


Values = Annotated[tuple[Any, ...], Field(min_length=1), BeforeValidator(_values_of), _OrText()]
"""The values of one key of a grid; of a range without steps, one `KeyRange`."""


def design_of(value: Any) -> Any:
    """Return the design that a text such as "sobol:64" stands for; any other value unchanged.

    Raises:
        ValueError: if the size in the text is no number.
    """
    if not isinstance(value, str):
        return value
    method, colon, size = value.partition(":")
    if colon and not size.strip().isdecimal():
        raise ValueError(f"should be METHOD:SIZE, sobol:64 for instance (got {value!r})")
    return {"method": method.strip()} | ({"size": int(size)} if colon else {})


class Design(Value):
    """Points at which the ranges of a grid are tried, in place of all combinations; "sobol:64" is a short form."""

    method: Literal["sobol", "latin_hypercube", "random"] = "sobol"
    """How points are chosen. sobol: a scrambled Sobol sequence, the most even; latin_hypercube: as many equal parts of
    each range as points, one point in each; random: independent points.

    A greater `size` continues a Sobol sequence and random points, so that stored runs remain part of the sweep; a Latin
    hypercube of another size has other points.

    If in doubt, use sobol with a power of two.
    """
    size: Annotated[int, Field(ge=2, le=100_000, strict=True)] = 64
    """Number of points.

    If in doubt, use 64 for two or three keys, and twice as many for each further one that matters.
    """
    seed: Annotated[int, Field(ge=0, strict=True)] = 0
    """Seed of the points; the seeds of runs do not depend on it."""
    drawn: tuple[str, ...] = ()
    """Keys of the grid whose listed values are drawn, too, with equal probabilities; every point is combined with all
    values of the other lists."""

    @property
    def is_balanced(self) -> bool:
        """Whether the number of points suits the method: that of a Sobol sequence should be a power of 2."""
        return self.method != "sobol" or not self.size & (self.size - 1)


def _grid_in_tables(grid: dict[str, tuple[Any, ...]], info: SerializationInfo) -> dict[str, Any]:
    """Return a grid as it is written, with ranges as texts.

    This is no `field_serializer`, for which pydantic converts the name of the field to a text: a signal that arrives
    during this conversion is lost with a message on stderr.
    """
    tables = partial(_with_tables, exclude_none=bool(info.exclude_none))
    return {key: str(values[0]) if is_range(values) else tables(values) for key, values in grid.items()}


def _with_tables(value: Any, *, exclude_none: bool) -> Any:
    """Return a value of a key with tables in place of models and functions, also inside of tables and lists."""
    if isinstance(value, Value) and is_ours(type(value)):
        return value.model_dump(exclude_none=exclude_none)
    if isinstance(value, BaseModel) or callable(value):
        return table_of(value, exclude_none=exclude_none)
    inner = partial(_with_tables, exclude_none=exclude_none)
    if isinstance(value, dict):
        return {key: inner(entry) for key, entry in value.items()}
    return [*map(inner, value)] if isinstance(value, list | tuple) else value


class Sweep(Value):
    """A sweep of a scenario over a grid of its keys and over seeds (`desim sweep`)."""

    reps: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = 30
    """Number of runs of each configuration.

    The width of a confidence interval falls with the square root of this number: half the width takes four times the
    runs.

    If in doubt, use 30 to explore, and 100 or more for a figure to be published.
    """
    seeds: Literal["common", "independent"] = "common"
    """common: run k of every configuration has the seed 1,000,000 `seed` + k (common random numbers), so that
    configurations are compared on equal seeds; independent: every run has its own seed."""
    grid: Annotated[dict[str, Values], BeforeValidator(_flat), PlainSerializer(_grid_in_tables)] = Field(
        default_factory=dict
    )
    """Dotted keys of the scenario as in --set, each with a list of values or a range of numbers; every combination is a
    configuration. The range "FIRST:LAST:STEP", such as "0:1:0.1", includes the last number; "log:FIRST:LAST:COUNT" has
    equal ratios; "LOW:HIGH" and "log:LOW:HIGH" are ranges from which `design` chooses."""
    design: Annotated[Design, BeforeValidator(design_of), _OrText()] | None = None
    """How points in the ranges of the grid are chosen, such as "sobol:64"; absent if the grid has no ranges."""

    @field_validator("grid")
    @classmethod
    def _names_no_code(cls, grid: dict[str, tuple[Any, ...]], info: ValidationInfo) -> dict[str, tuple[Any, ...]]:
        """Raise an error if the grid of an untrusted file names code; the values of the grid are validated later."""
        named = [] if is_trusted(info) else [(key, kind) for key, kind in _kinds_in(grid) if is_unlisted_import(kind)]
        if named:
            text = "; ".join(f"{key}: {refusal(kind)}" for key, kind in named)
            misfits = [(("sweep", "grid", key), refusal(kind)) for key, kind in named]
            raise PydanticCustomError("misfits", "{text}", {"text": text, "misfits": misfits})
        return grid

    def __hash__(self) -> int:  # the values of a key may be tables, which have no hash
        return hash((self.reps, self.seeds, tuple(self.grid), self.design))


def _kinds_in(grid: dict[str, tuple[Any, ...]]) -> Iterator[tuple[str, Any]]:
    """Yield each kind in the values of a grid, also in nested tables, as a pair (key of the grid, kind)."""
    for key, values in grid.items():
        yield from ((key, value) for (*_, name), value in nested(values) if name == "kind")
        yield from ((key, kind) for kind in (values if key.split(".")[-1].strip("\"'") == "kind" else ()))
