"""The errors of a scenario file in words: where each is, what is allowed there, and what may have been meant."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from desim.config.choice import OneOf, choices_of
from desim.config.error_texts import OF_EXCEPTIONS, text_of
from desim.config.errors import Problem
from desim.config.model import Value, fields_of, markers_of
from desim.config.suggestion import close_to
from desim.scenario.key_index import homes_of
from desim.scenario.overrides import ScenarioError, Source, holds, model_of, value_at
from desim.scenario.toml_lines import KeyPath

Model = TypeVar("Model", bound=Value)
BASE = "base"
"""The key of a scenario file that names its base; it is no field of a scenario."""
MAX_HOMES = 3
"""The largest number of tables that an error message suggests for a key."""


def validated(source: Source, model: type[Model]) -> Model:
    """Return the scenario of a source; raise ScenarioError with all errors of the source, sorted by line."""
    folder = Path(source.name).parent if source.folder is None else source.folder
    try:
        return model.model_validate(source.tables, context={"folder": folder, "allow_import": source.allow_import})
    except ValidationError as error:
        problems = [problem for each in error.errors() for problem in explain(each, source, model, ())]
        raise ScenarioError(*sorted(problems, key=lambda each: (each.line, each.where, str(each)))) from error


def explain(error: ErrorDetails, source: Source, model: type[Any], above: KeyPath) -> Iterator[Problem]:
    """Yield the problems that a pydantic error describes.

    Args:
        error: an error in the table of a model.
        source: the source of the scenario.
        model: the model, possibly a user's class.
        above: the place of the table.
    """
    if error["type"] == "misfits":
        for place, why in error["ctx"]["misfits"]:
            yield _problem(source, place, why)
        return
    place, owner, info = _locate(error, value_at(source.tables, above), model, above)
    if error["type"] == "user_model":
        for each in error["ctx"]["errors"]:
            yield from explain(each, source, error["ctx"]["model"], place)
        return
    # The first paragraph says what the key is; the next ones advise what to choose, too much for an error message.
    description = " ".join((info.description or "").partition("\n\n")[0].split()).rstrip(".") if info else ""
    note = f"; {description}" if description and error["type"] not in SAYS_ENOUGH else ""
    more = [BASE] if owner is source.model and source.line(place) else []
    yield _problem(source, place, f"{_reason(error, place, owner, info, more, source.model)}{note}{_input_text(error)}")


def _problem(source: Source, place: KeyPath, what: str) -> Problem:
    reason = what if place else f"the file: {what}"
    return Problem(reason, ".".join(map(str, place)), source.where(place), source.line(place))


def _locate(
    error: ErrorDetails, node: Any, model: type[Any], above: KeyPath
) -> tuple[KeyPath, type[BaseModel] | None, FieldInfo | None]:
    """Return the place of the key with an error, the model of the table that contains it, and the field of the key.

    The path in a pydantic error also contains the kind of each table that has one; the place does not. `node` is the
    table at the place `above`, in which pydantic found the error; for the other arguments see `explain`.
    """
    place = above
    owner: type[BaseModel] | None = None
    inner: type[BaseModel] | None = model if issubclass(model, BaseModel) else None
    info: FieldInfo | None = None
    path = list(error["loc"])
    while path:
        part = path.pop(0)
        place += (part,)
        node = node[part] if holds(node, part) else None
        if isinstance(part, str):
            owner, info = inner, fields_of(inner).get(part) if inner else None
        inner = model_of(info, node) if info else None
        if info is not None and path and path[0] in _tags(info):
            path.pop(0)
    if error["type"] in {"union_tag_invalid", "import_refused"}:
        place += ("kind",)
    return place, owner, info


def _tags(info: FieldInfo) -> set[str]:
    """Return the kinds and the union tags of a field.

    In the path of an error, pydantic inserts them after the name of the field or the index of an item.
    """
    markers = markers_of(info)
    kinds = {kind for each in markers if isinstance(each, OneOf) for kind in each.choices()}
    return kinds | {each.tag for each in markers if isinstance(each, Tag)}


def _one_of(info: FieldInfo) -> OneOf | None:
    return next(iter(choices_of(info)), None)


def _reason(
    error: ErrorDetails,
    place: KeyPath,
    owner: type[BaseModel] | None,
    info: FieldInfo | None,
    more: Sequence[str],
    whole: type[BaseModel],
) -> str:
    """Return the text of an error, with the allowed values.

    `owner` is the model of the table that contains the key; `more` are keys that are allowed in addition to its fields.
    `whole` is the model of the whole file.
    """
    kind, context = error["type"], error.get("ctx", {})
    one_of = _one_of(info) if info else None
    kinds = list(one_of.choices()) if one_of else []
    if kind == "extra_forbidden":
        if place == (BASE,):
            return "is a key of scenario files only: it cannot be set, and a recorded scenario is complete without it"
        allowed = context.get("allowed") or (sorted([*owner.model_fields, *more]) if owner else [])
        replaced = owner._replaced.get(str(place[-1])) if owner and issubclass(owner, Value) else None
        return f"unknown key{replaced or _other_key(place, allowed, whole)}; allowed: {', '.join(allowed)}"
    if kind == "union_tag_invalid":
        return f"there is no {context['tag']!r}{_suggestion(context['tag'], kinds)}; allowed: {', '.join(kinds)}"
    if kind == "union_tag_not_found" or (kind in NOT_A_TABLE and kinds):
        return f'should be a table with a kind, {{ kind = "{kinds[0]}" }} for instance; allowed: {", ".join(kinds)}'
    if kind == "import_refused":
        return f"{error['msg']}; allowed without --allow-import: {', '.join(kinds)}"
    if kind == "literal_error":
        return f"should be {context['expected']}"
    if kind == "missing":
        return "is missing"
    if kind in NOT_A_TABLE:
        return "should be a table"
    if kind in {"too_long", "too_short"}:
        most = kind == "too_long"
        limit = context["max_length" if most else "min_length"]
        return f"should have at {'most' if most else 'least'} {limit} items, has {context['actual_length']}"
    return text_of(error)


NOT_A_TABLE = {"model_type", "model_attributes_type"}
SAYS_ENOUGH = OF_EXCEPTIONS | {"union_tag_invalid", "import_refused"}
"""Types of errors whose texts say what the key is for, or list what is allowed."""


RENAMED = {
    "at": "start",
    "delay": "latency",
    "floor": "min_timeout",
    "forget_after": "belief_timeout",
    "frozen": "static",
    "heeds": "flees_from",
    "hold": "holding_time",
    "lost_after": "track_timeout",
    "needed": "captures_to_end",
    "of": "schedule",
    "otherwise": "normally",
    "packet_loss": "loss",
    "packetloss": "loss",
    "pass_on": "relay",
    "patience": "winner_timeout",
    "q": "participation",
    "reach": "reception",
    "reaction": "reaction_delay",
    "sight": "sensing_range",
    "spread": "dissemination",
    "surprises": "reheat_on",
    "then": "during_handover",
    "together": "synchronous",
    "until": "end",
    "when_lost": "on_lost",
}
"""Keys and kinds that are not valid, and the valid ones to suggest."""


def _suggestion(word: str, allowed: Sequence[str]) -> str:
    close = _similar(word, allowed)
    return f", did you mean {close[0]!r}?" if close else ""


def _similar(word: str, allowed: Sequence[str]) -> list[str]:
    """Return a list with the allowed word to suggest for an invalid one; an empty list if none is similar."""
    return [RENAMED[word]] if RENAMED.get(word) in allowed else close_to(word, allowed)


def _other_key(place: KeyPath, allowed: Sequence[str], whole: type[BaseModel]) -> str:
    """Return a hint for an unknown key: a similar key of its table, or the same key in another table or kind."""
    word = str(place[-1]).split(".")[-1]
    close = _similar(word, allowed)
    homes = homes_of(word, whole) or homes_of(RENAMED.get(word, word), whole)
    if close:  # then suggest other tables only for a key of exactly this name, and none for a renamed key
        homes = [key for key in homes if key.place[-1] == word and close != [RENAMED.get(word)]]
    here = [each for each in place if isinstance(each, str)]
    same = [key for key in homes if [each for each in key.place if each != "0"] == here]
    if kinds := list(dict.fromkeys(key.owner for key in same if key.owner)):
        return f", it is one of the kind {' or '.join(kinds)}"
    places = dict.fromkeys(key.dotted if len(key.place) > 1 else f"{key.dotted} at the top" for key in homes)
    found = [*map(repr, close), *list(places)[:MAX_HOMES]]
    return f", did you mean {' or '.join(found)}?" if found else ""


def _input_text(error: ErrorDetails) -> str:
    if error["type"] in {"extra_forbidden", "union_tag_invalid", "import_refused", "missing", "value_error"}:
        return ""
    got = str(error["input"]).lower() if isinstance(error["input"], bool) else repr(error["input"])
    return f" (got {got if len(got) < 60 else got[:57] + '...'})"
