"""The default of every field of every model, in one file: `python -m tests.test_defaults` renews it."""

from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from desim import Scenario
from desim.value import choices_of, fields_of, models_in

GOLDEN = Path(__file__).parent / "golden" / "defaults.txt"


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


def test_every_default_is_as_it_was():
    """A default is part of what a scenario file means."""
    assert defaults() == GOLDEN.read_text(encoding="utf-8"), "on purpose? renew it: python -m tests.test_defaults"


if __name__ == "__main__":
    GOLDEN.write_text(defaults(), encoding="utf-8")
