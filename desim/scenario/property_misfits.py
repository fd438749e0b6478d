"""Errors of the properties of a scenario, which depend on other tables, too: evaders, protocols, recordings."""

from collections.abc import Iterator

from desim.config.choice import choices_of
from desim.config.suggestion import did_you_mean
from desim.scenario.conditions import AnyScenario
from desim.scenario.named_metrics import PropertyMargin
from desim.scenario.properties import Property, recording


def property_misfits(scenario: AnyScenario) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield the key and the text of each error of the properties of a scenario, and of metrics that are margins."""
    index_of: dict[str, int] = {}  # by label
    for k, prop in enumerate(scenario.properties):
        if (first := index_of.setdefault(prop.label, k)) != k:
            yield (
                ("properties", k, "name"),
                f"properties.{first} has the name {prop.label!r}, too: give one of them another",
            )
        yield from ((("properties", k, *place), why) for place, why in misfits_of(prop, scenario))
    for k, metric in enumerate(scenario.record.metrics):
        if not isinstance(metric.of, PropertyMargin):
            continue
        if (name := metric.of.name) not in index_of:
            hint, names = did_you_mean(name, index_of), ", ".join(index_of) or "none"
            yield ("record", "metrics", k), f"the scenario has no property {name!r}{hint}; it has {names}"
        elif recording(scenario, [scenario.properties[index_of[name]]]) is not scenario:
            yield (
                ("record", "metrics", k),
                "the property needs positions or messages: set record.trajectory or .messages",
            )


def misfits_of(prop: Property, scenario: AnyScenario) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield the key and the text of each error of one property in a scenario."""
    evaders = len(scenario.evaders)
    for key, condition in zip(("condition", "then"), prop.conditions, strict=False):
        for comparison in condition.comparisons:
            if comparison.evader is not None and not 1 <= comparison.evader <= evaders:
                yield (key,), f"there is no evader {comparison.evader}: they are 1 .. {evaders}"
    (protocols,) = choices_of(type(scenario).model_fields["protocol"])
    if prop.against is not None and protocols.choice(prop.against) is None:
        kinds = protocols.choices()
        hint = did_you_mean(prop.against, kinds)
        yield ("against",), f"there is no protocol {prop.against!r}{hint}; there are {', '.join(kinds)}"
