"""A model as text: its parameters, what each is by default, and what it may hold."""

from collections.abc import Iterator

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.value import choices_of, fields_of, kind_of, models_in


def described(
    model: type[BaseModel], title: str, indent: str = "", known: set[type[BaseModel]] | None = None
) -> Iterator[str]:
    """Yield lines of text that describe a model and its parameters, and the models they may hold in turn, once each."""
    known = set() if known is None else known
    yield f"{indent}{title}: {(model.__doc__ or '').strip().splitlines()[0]}"
    if model in known:
        return
    known.add(model)
    for name, field in fields_of(model).items():
        if name == "kind":
            continue
        inner = indent + "    "
        yield f"{inner}{name}{_default_of(field)}: {' '.join((field.description or '').split())}"
        for choice in choices_of(field):
            choices = choice.choices()
            if known.issuperset(choices.values()):
                yield f"{inner}    {', '.join(choices)}: as above"
                continue
            for kind, chosen in choices.items():
                yield from described(chosen, kind, inner + "    ", known)
        for plain in models_in(field.annotation):
            yield from list(described(plain, name, inner, known))[1:]


def _default_of(field: FieldInfo) -> str:
    if field.is_required():
        return ""
    default = field.get_default(call_default_factory=True)
    if isinstance(default, BaseModel):
        return f" = {{ kind = {kind_of(type(default))!r} }}" if "kind" in type(default).model_fields else ""
    return f" = {default!r}"
