"""A model as text, for `desim keys` and `desim protocols`: its parameters, defaults, and the models in parameters.

If a parameter can hold one of several models, the `kind` of a model is the name that selects it in a scenario file.
"""

from collections.abc import Iterator, Sequence
from types import MethodType
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.config.arguments import value_text
from desim.config.choice import choices_of, kind_of
from desim.config.field_docs import fields_of
from desim.config.model_parts import models_in
from desim.config.traits import Traits


class KindMissingError(ValueError):
    """Raised if only some kinds of a model have a key, and the kind is missing."""


def described(
    model: type[BaseModel], title: str, indent: str = "", described_models: set[type[BaseModel]] | None = None
) -> Iterator[str]:
    """Yield lines that describe a model, its parameters and, recursively, the models that these may hold.

    Each model is described once: `described_models` collects them, and a model in it yields only its first line.
    """
    described_models = set() if described_models is None else described_models
    yield f"{indent}{title}: {summary(model)}"
    if model in described_models:
        return
    described_models.add(model)
    for name, field in fields_of(model).items():
        if name == "kind":
            continue
        yield from _described_field(name, field, indent + "    ", described_models)


def described_traits(traits: Traits) -> Iterator[str]:
    """Yield a line for each trait of a model that is no parameter, with its value and description.

    A trait is an optional attribute of a model (`desim.config.traits`); a parameter can be set in a scenario file.
    """
    yield "    traits:"
    fields = fields_of(type(traits))
    for name in traits.names():
        value = dict(traits)[name]
        shown = value.__qualname__ if isinstance(value, MethodType) else value_text(value)
        yield f"        {name} = {shown}: {' '.join((fields[name].description or '').split())}"


def described_at(place: Sequence[str], model: type[BaseModel]) -> Iterator[str]:
    """Yield lines that describe one key or kind below a model, as `described` does.

    Args:
        place: the path from the outermost key to the innermost, without indices of lists. A kind may follow the key of
            its model: in ("network", "latency", "gamma", "scale"), "gamma" is a kind of "latency".
        model: the outermost model.

    Raises:
        KindMissingError: if the key depends on a kind that `place` lacks.
        ValueError: if there is no such key or kind.
    """
    (name, *rest), fields = place, fields_of(model)
    if name == "kind" or name not in fields:
        allowed = ", ".join(key for key in fields if key != "kind") or "nothing"
        raise ValueError(f"there is no {name!r}; allowed: {allowed}")
    models_by_kind = {kind: chosen for choice in choices_of(fields[name]) for kind, chosen in choice.choices().items()}
    without_kind = next(models_in(fields[name].annotation), None)
    if not rest:
        yield from _described_field(name, fields[name], "", set())
    elif rest[0] in models_by_kind:
        chosen = models_by_kind[rest[0]]
        yield from described_at(rest[1:], chosen) if rest[1:] else described(chosen, rest[0])
    elif rest[0] != "kind" and (
        kinds := [kind for kind, chosen_model in models_by_kind.items() if rest[0] in chosen_model.model_fields]
    ):
        keys = ", ".join(f"{name}.{kind}.{rest[0]}" for kind in kinds)
        raise KindMissingError(f"{rest[0]!r} in {name!r} depends on the kind: {keys}")
    elif models_by_kind or without_kind is None:
        raise ValueError(f"there is no {rest[0]!r} in {name!r}; allowed: {', '.join(models_by_kind) or 'nothing'}")
    else:
        yield from described_at(rest, without_kind)


def _described_field(name: str, field: FieldInfo, indent: str, described_models: set[type[BaseModel]]) -> Iterator[str]:
    without_kind = next(models_in(field.annotation), None)
    text = field.description or (summary(without_kind) if without_kind is not None else "")
    yield f"{indent}{name}{default_of(field)}: {' '.join(text.split())}"
    for choice in choices_of(field):
        choices = choice.choices()
        if described_models.issuperset(choices.values()):
            yield f"{indent}    {', '.join(choices)}: as above"
            continue
        for kind, chosen in choices.items():
            yield from described(chosen, kind, indent + "    ", described_models)
    for model in models_in(field.annotation):
        yield from list(described(model, name, indent, described_models))[1:]  # without its title: `text` has that role


def summary(model: Any) -> str:
    """Return the first line of the docstring of a class or function; "" without a docstring."""
    return (model.__doc__ or "").strip().partition("\n")[0]


def default_of(field: FieldInfo) -> str:
    """Return " = " and the default of a field; "" if it has none.

    If the default is a model, it is shown by its kind; the text is "" if the model has no kind.
    """
    if field.is_required():
        return ""
    default = field.get_default(call_default_factory=True)
    if isinstance(default, BaseModel):
        return f" = {{ kind = {kind_of(type(default))!r} }}" if "kind" in type(default).model_fields else ""
    return f" = {default!r}"
