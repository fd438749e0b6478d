"""What every model is: a frozen, validated value that a script constructs and a file validates into.

`Value` is the base of them all. `OneOf` lets a field hold any of several models: a table is told by its `kind`, and
from Python any callable will do.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

# Numbers and truths are taken strictly: a file's "60" is not 60, and true is not 1.
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Probability = Annotated[float, Field(ge=0, le=1, strict=True)]
Extent = Annotated[float, Field(gt=0, strict=True)]
"""Positive, and possibly infinite."""
Truth = Annotated[bool, Field(strict=True)]


class Value(BaseModel):
    """A frozen value whose unknown keys are errors and whose fields are described by the string below them."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


def kind_of(model: type[BaseModel]) -> str:
    """Return the `kind` by which a table in a file asks for this model."""
    return str(model.model_fields["kind"].default)


class OneOf:
    """Annotation of a field that holds one of several models, told apart by their `kind`.

    Models that other distributions install under the entry point group `group` are accepted too; they are loaded
    when the schema is built. An object that can be called is taken as it is, so that a script may pass a class or
    a function of its own.
    """

    def __init__(self, *models: type[BaseModel], group: str | None = None):
        self.models = models
        self.group = group

    def choices(self) -> dict[str, type[BaseModel]]:
        """Return the models by kind, those of this distribution first."""
        installed = sorted(entry_points(group=self.group), key=lambda point: point.name) if self.group else []
        return {kind_of(model): model for model in self.models} | {point.name: point.load() for point in installed}

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        choices = {kind: handler.generate_schema(model) for kind, model in self.choices().items()}
        by_kind = core_schema.tagged_union_schema(choices, discriminator="kind")
        return core_schema.no_info_wrap_validator_function(_callable_or, by_kind)


def _callable_or(value: Any, validate: Callable[[Any], Any]) -> Any:
    return value if callable(value) else validate(value)
