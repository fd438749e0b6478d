"""The units of the keys of a scenario, as their descriptions have them."""

import re
from collections.abc import Iterator
from functools import cache

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from desim.value import choices_of, fields_of, models_in

UNIT = re.compile(r", (1/s|m/s|rad/s|rad/sqrt\(s\)|bit/s|Hz|kHz|dB|dBm|rad|s|m)(?=[;:,.]|$)")
"""In a description: "Mean one-way latency, s."."""


@cache
def unit_of(key: str) -> str | None:
    """Return the unit of a dotted key, whatever the kinds of the models above it; None if it has none, or several."""
    from desim.scenario import Scenario

    fields: list[FieldInfo] = []
    models: list[type[BaseModel]] = [Scenario]
    for part in (each for each in key.split(".") if not each.isdigit()):
        fields = [fields_of(model)[part] for model in models if part in model.model_fields]
        models = [model for field in fields for model in _models_of(field)]
    units = {found[1] if (found := UNIT.search(field.description or "")) else None for field in fields}
    return units.pop() if len(units) == 1 else None


def _models_of(field: FieldInfo) -> Iterator[type[BaseModel]]:
    """Yield the models that a field may hold."""
    for choice in choices_of(field):
        yield from choice.choices().values()
    yield from models_in(field.annotation)
