"""What a wrong key or kind may have meant: similar words, renamed keys, the same key in another table."""

from collections.abc import Sequence
from types import MappingProxyType

from pydantic import BaseModel

from desim.config.choice import OneOf
from desim.config.errors import KeyPath
from desim.config.key_index import homes_of
from desim.config.suggestion import close_to

MAX_HOMES = 3
"""The largest number of tables that an error message suggests for a key."""
RENAMED = {
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
"""Keys and kinds that are not valid, and the valid ones to suggest."""
MEANT = MappingProxyType(
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
"""Words of the field that are no kinds, and the kinds that they may mean."""


def suggestion(word: str, allowed: Sequence[str]) -> str:
    """Return the end of a message that suggests a kind, for example ", did you mean 'sap'?"; "" if none is similar."""
    close = _similar(word, allowed)
    return f", did you mean {' or '.join(map(repr, close))}?" if close else ""


def _similar(word: str, allowed: Sequence[str]) -> list[str]:
    """Return the allowed words to suggest for an invalid one, mostly one; an empty list if none is similar."""
    plain = word.lower().replace("-", "_").replace(" ", "_")
    initials = "".join(part[0] for part in plain.split("_") if part)  # spatial_adaptive_play is sap
    meant = [RENAMED.get(plain, plain), *MEANT.get(plain, ()), *([initials] if len(initials) > 1 else [])]
    return [name for name in meant if name in allowed] or close_to(plain, allowed)


def _siblings_with(key: str, model: type[BaseModel]) -> list[str]:
    """Return the names of the models that a field may hold in place of a model, and that have a key."""
    families = [family for family in OneOf.families if "kind" in model.model_fields and family.has(model)]
    siblings = [sibling for family in families for sibling in family.choices().values()]
    return list(dict.fromkeys(sibling.__name__ for sibling in siblings if key in sibling.model_fields))


def other_key(place: KeyPath, allowed: Sequence[str], whole: type[BaseModel]) -> str:
    """Return a hint for an unknown key: a similar key of its table, or the same key in another table or kind."""
    word = str(place[-1]).split(".")[-1]
    close = _similar(word, allowed)
    homes, renamed = homes_of(word, whole), RENAMED.get(word)
    is_elsewhere = any(key.place[-1] == word for key in homes)
    if renamed and not is_elsewhere:
        homes = homes_of(renamed, whole) or homes
    is_loose = close == close_to(word, allowed) and not close_to(word, allowed, cutoff=0.8)
    if is_loose and is_elsewhere:
        close = []  # the same name in another table is surer than one that is hardly similar in this
    if renamed not in close and any(key.place[-1] == renamed for key in homes):
        close = []  # so is the new name
    if close:  # then suggest other tables only for a key of exactly this name, and none for a renamed key
        homes = [key for key in homes if key.place[-1] == word and close != [renamed]]
    here = [part for part in place if isinstance(part, str)]
    same = [key for key in homes if [part for part in key.place if part != "0"] == here]
    if kinds := list(dict.fromkeys(key.owner for key in same if key.owner)):
        return f", it is one of the kind {' or '.join(kinds)}"
    if not homes and (siblings := _siblings_with(word, whole)):
        return f", it is a key of {' and '.join(siblings)}"
    places = dict.fromkeys(key.dotted if len(key.place) > 1 else f"{key.dotted} at the top" for key in homes)
    meant = [*map(repr, close), *list(places)[:MAX_HOMES]]
    return f", did you mean {' or '.join(meant)}?" if meant else ""
