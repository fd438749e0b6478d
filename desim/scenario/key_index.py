"""All keys of scenario files: the table and the allowed kinds of each key."""

from collections.abc import Iterator
from difflib import get_close_matches
from functools import cache
from typing import NamedTuple, get_origin

from pydantic import BaseModel

from desim.config.choice import choices_of
from desim.config.model import fields_of, models_in
from desim.scenario.scenario import Scenario


class Key(NamedTuple):
    """A key of scenario files."""

    place: tuple[str, ...]
    """The parts of the dotted key, without kinds; after the name of a list of tables, the index 0 stands for each."""
    kinds: tuple[str, ...] = ()
    """The kinds that its value may have."""
    owner: str | None = None
    """The kind of the table that contains the key; None if that table has no kind."""

    @property
    def dotted(self) -> str:
        """The key as in --set: network.latency.value."""
        return ".".join(self.place)


@cache
def all_keys() -> tuple[Key, ...]:
    """Return every key of scenario files, once for each kind of its table; keys of outer tables come first."""
    return tuple(sorted(_keys(Scenario, (), None, ()), key=lambda key: len(key.place)))


def _keys(
    model: type[BaseModel], above: tuple[str, ...], owner: str | None, outer: tuple[type[BaseModel], ...]
) -> Iterator[Key]:
    """Yield the keys of a model and of the models within it; the recursion stops at a model that contains itself."""
    for name, field in fields_of(model).items():
        if name == "kind":
            continue
        choices: list[tuple[str | None, type[BaseModel]]] = [
            each for choice in choices_of(field) for each in choice.choices().items()
        ]
        yield Key((*above, name), tuple(kind for kind, _ in choices if kind), owner)
        below = (*above, name, *(["0"] if get_origin(field.annotation) is tuple else []))
        for kind, inner in choices or [(None, each) for each in models_in(field.annotation)]:
            if inner not in outer:
                yield from _keys(inner, below, kind, (*outer, model))


def homes_of(name: str) -> list[Key]:
    """Return the outermost keys whose last part is a name; if there are none, those with the most similar name."""
    names = {key.place[-1] for key in all_keys()}
    wanted = name if name in names else next(iter(get_close_matches(name, names, n=1, cutoff=0.8)), None)
    found = [key for key in all_keys() if key.place[-1] == wanted]
    return [key for key in found if len(key.place) == len(found[0].place)]
