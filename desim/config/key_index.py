"""All keys of scenario files: the table, the allowed kinds and the unit of each key.

The kind of a table is the value of its key `kind`, which selects one of several models.
"""

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.config.choice import choices_of
from desim.config.field_docs import fields_of, unit_in
from desim.config.model_parts import models_in
from desim.config.suggestion import close_to


class Key(NamedTuple):
    """A key of scenario files."""

    place: tuple[str, ...]
    """The parts of the dotted key; kinds are not parts. After the name of a list of tables comes the index "0", which
    stands for the index of any table in the list."""
    kinds: tuple[str, ...] = ()
    """The kinds that its value may have."""
    owner: str | None = None
    """The kind of the table that contains the key; None if that table has no kind."""

    @property
    def dotted(self) -> str:
        """The key as in --set: network.latency.value."""
        return ".".join(self.place)


@cache
def all_keys(whole: type[BaseModel]) -> tuple[Key, ...]:
    """Return every key of the files of a model, of scenario files for `Scenario`; keys of outer tables come first.

    A key occurs several times if the table that contains it may have several kinds, or be one of several models
    without a kind.
    """
    return tuple(sorted(_keys(whole, (), None, ()), key=lambda key: len(key.place)))


def _keys(
    model: type[BaseModel], above: tuple[str, ...], owner: str | None, outer: tuple[type[BaseModel], ...]
) -> Iterator[Key]:
    """Yield the keys of a model and of the models within it.

    The recursion ends, because it does not enter a model that already encloses the present one. `outer` contains the
    enclosing models.
    """
    for name, field in fields_of(model).items():
        if name == "kind":
            continue
        models = _models_of(field)
        yield Key((*above, name), tuple(kind for kind, _ in models if kind), owner)
        below = (*above, name, *(["0"] if get_origin(field.annotation) is tuple else []))
        for kind, inner in models:
            if inner not in outer:
                yield from _keys(inner, below, kind, (*outer, model))


def homes_of(name: str, whole: type[BaseModel]) -> list[Key]:
    """Return the outermost keys of the files of a model whose last part is `name`.

    If there are none, return the outermost keys with the most similar last part; [] if no last part is similar.
    """
    names = {key.place[-1] for key in all_keys(whole)}
    wanted = name if name in names else next(iter(close_to(name, names, cutoff=0.8)), None)
    return outermost(wanted, whole)


def outermost(name: str | None, whole: type[BaseModel]) -> list[Key]:
    """Return the outermost keys of the files of a model whose last part is `name`."""
    matches = [key for key in all_keys(whole) if key.place[-1] == name]
    return [key for key in matches if len(key.place) == len(matches[0].place)]


@cache
def unit_of_key(key: str, whole: type[BaseModel]) -> str | None:
    """Return the unit of a dotted key of the files of a model.

    Return None if the key has no unit, or if its unit depends on the kind of its table. A kind of the table for which
    the key is a text does not count.
    """
    fields: list[FieldInfo] = []
    models: list[type[BaseModel]] = [whole]
    for part in (part for part in key.split(".") if not part.isdigit()):
        fields = [fields_of(model)[part] for model in models if part in model.model_fields]
        models = [model for field in fields for _, model in _models_of(field)]
    units = {unit_in(field) for field in fields if field.annotation is not str}
    return units.pop() if len(units) == 1 else None


def _models_of(field: FieldInfo) -> list[tuple[str | None, type[BaseModel]]]:
    """Return the models that a field may hold, each with its kind; a model without a kind has None."""
    choices = [item for choice in choices_of(field) for item in choice.choices().items()]
    return [*choices] or [(None, model) for model in models_in(field.annotation)]
