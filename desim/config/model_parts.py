"""What is inside a model: the models and markers in the annotation of a field, and the models in its values."""

from collections.abc import Callable, Iterable, Iterator
from operator import attrgetter
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.config.errors import KeyPath


def markers_of(field: FieldInfo) -> list[Any]:
    """Return the metadata of a field and of all types inside its annotation, including the bounds in a `Field(...)`."""
    return [*field.metadata, *_metadata(field.annotation)]


def _metadata(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) is Annotated:
        for part in annotation.__metadata__:
            yield part
            yield from part.metadata if isinstance(part, FieldInfo) else ()
    for inner in get_args(annotation):
        yield from _metadata(inner)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from models_in(inner)


def models_within(
    model: BaseModel,
    place: KeyPath = (),
    fields: Callable[[type[BaseModel]], Iterable[str]] = attrgetter("model_fields"),
) -> Iterator[tuple[KeyPath, BaseModel]]:
    """Yield a model and all models within it, each after its place.

    Args:
        model: the outer model.
        place: its place.
        fields: returns the names of the fields of a class that are searched; by default, all.
    """
    yield place, model
    for name in fields(type(model)):
        for inner, part in indexed_parts(getattr(model, name)):
            if isinstance(part, BaseModel):
                yield from models_within(part, (*place, name, *inner), fields)


def indexed_parts(value: Any) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the value of a field or, if it is a list, each item with its index."""
    if isinstance(value, tuple):
        yield from (((index,), item) for index, item in enumerate(value))
    else:
        yield (), value
