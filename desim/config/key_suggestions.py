"""Suggestions for a wrong key or kind: a similar name, the name for a synonym, or the same key in another table."""

from collections.abc import Sequence
from types import MappingProxyType

from pydantic import BaseModel

from desim.config.choice import OneOf
from desim.config.errors import KeyPath
from desim.config.key_index import homes_of
from desim.config.suggestion import close_to

MAX_ELSEWHERE = 3
"""The largest number of keys of other tables that an error message suggests."""
WORDS_FOR_KEYS = {
    "at": "start",
    "delay": "latency",
    "deviation": "cv",
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
    "pursuer": "node",
    "q": "participation",
    "reach": "reception",
    "reaction": "reaction_delay",
    "robot": "node",
    "sight": "sensing_range",
    "sigma": "cv",
    "spread": "dissemination",
    "std": "cv",
    "stddev": "cv",
    "surprises": "reheat_on",
    "then": "during_handover",
    "together": "synchronous",
    "until": "end",
    "when_lost": "on_lost",
}
"""Words for keys in other programs, papers and older files, each with the key to suggest."""
WORDS_FOR_KINDS = MappingProxyType(
    {
        "auction": ("cbaa", "cbba"),
        "consensus": ("cbaa", "cbba"),
        "exponential": ("shifted_exponential",),
        "fixed": ("constant",),
        "gauss": ("lognormal",),
        "gaussian": ("lognormal",),
        "gilbert": ("gilbert_elliott",),
        "greedy": ("argmin", "local_min"),
        "hungarian": ("centralised",),
        "iid": ("bernoulli",),
        "normal": ("lognormal",),
        "random": ("uniform", "bernoulli"),
    }
)
"""Words of the field that are no kinds, each with the kinds to suggest."""


def suggestion(word: str, allowed: Sequence[str]) -> str:
    """Return the end of a message that suggests a kind, for example ", did you mean 'sap'?"; "" if none is similar."""
    close = _similar(word, allowed)
    return f", did you mean {' or '.join(map(repr, close))}?" if close else ""


def _similar(word: str, allowed: Sequence[str]) -> list[str]:
    """Return the allowed words to suggest for an invalid word, mostly a single one; empty if none is similar."""
    plain = spelled_as_key(word)
    initials = "".join(part[0] for part in plain.split("_") if part)  # spatial_adaptive_play is sap
    meant = [WORDS_FOR_KEYS.get(plain, plain), *WORDS_FOR_KINDS.get(plain, ()), initials]
    return [name for name in meant if name in allowed] or close_to(plain, allowed)


def spelled_as_key(word: str) -> str:
    """Return a word in the spelling of keys and kinds: packet_loss for Packet-Loss."""
    return word.lower().replace("-", "_").replace(" ", "_")


def _siblings_with(key: str, model: type[BaseModel]) -> list[str]:
    """Return the names of the models that have a key and that a table may hold in place of the given model."""
    families = [family for family in OneOf.families if "kind" in model.model_fields and family.has(model)]
    siblings = [sibling for family in families for sibling in family.choices().values()]
    return list(dict.fromkeys(sibling.__name__ for sibling in siblings if key in sibling.model_fields))


def other_key(place: KeyPath, allowed: Sequence[str], whole: type[BaseModel]) -> str:
    """Return a hint for an unknown key: a similar key of its table, or the same key in another table or kind."""
    word = str(place[-1]).split(".")[-1]
    close = _similar(word, allowed)
    word = spelled_as_key(word)
    elsewhere, meant_key = homes_of(word, whole), WORDS_FOR_KEYS.get(word)
    is_elsewhere = any(key.place[-1] == word for key in elsewhere)
    if meant_key and not is_elsewhere:
        elsewhere = homes_of(meant_key, whole) or elsewhere
    # A key of this table is suggested, unless another table has this very key and the key here is hardly similar,
    # or another table has the key for a synonym.
    is_hardly_similar = close == close_to(word, allowed) and not close_to(word, allowed, cutoff=0.8)
    if (is_hardly_similar and is_elsewhere) or (
        meant_key not in close and any(key.place[-1] == meant_key for key in elsewhere)
    ):
        close = []
    if close in ([word], [meant_key]):
        elsewhere = []
    elif close:
        elsewhere = [key for key in elsewhere if key.place[-1] == word]
    same_place = [part for part in place[:-1] if isinstance(part, str)] + [word]
    of_other_kinds = [key for key in elsewhere if [part for part in key.place if part != "0"] == same_place]
    if kinds := list(dict.fromkeys(key.owner for key in of_other_kinds if key.owner)):
        return f", it is one of the kind {' or '.join(kinds)}"
    if not elsewhere and (siblings := _siblings_with(word, whole)):
        return f", it is a key of {' and '.join(siblings)}"
    places = dict.fromkeys(key.dotted if len(key.place) > 1 else f"{key.dotted} at the top" for key in elsewhere)
    suggestions = [*map(repr, close), *list(places)[:MAX_ELSEWHERE]]
    return f", did you mean {' or '.join(suggestions)}?" if suggestions else ""
