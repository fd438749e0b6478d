"""The default of every field of every model, in one golden file."""

from collections.abc import Iterator

from pydantic import BaseModel

from desim import Scenario
from desim.value import choices_of, fields_of, models_in
from tests.golden import golden


def models(model: type[BaseModel], found: set[type[BaseModel]]) -> set[type[BaseModel]]:
    """Return a model and all that may be in it, without those of other distributions."""
    if model not in found and model.__module__.partition(".")[0] in {"desim", "protocols"}:
        found.add(model)
        for field in fields_of(model).values():
            for inner in (*models_in(field.annotation), *(m for c in choices_of(field) for m in c.choices().values())):
                models(inner, found)
    return found


def defaults() -> str:
    by_name = sorted(models(Scenario, set()), key=lambda model: model.__name__)
    return "\n".join(line for model in by_name for line in (model.__name__, *lines(model), ""))


def lines(model: type[BaseModel]) -> Iterator[str]:
    for name, field in fields_of(model).items():
        given = "required" if field.is_required() else repr(field.get_default(call_default_factory=True))
        yield f"    {name} = {given}"


def test_every_default_is_that_of_the_golden_file():
    """A default is part of what a scenario file means."""
    golden("defaults.txt", defaults())
