"""What pursuers say of a token that circulates, and what the token itself says; see `protocols.circulation`."""

from typing import Any, NamedTuple

Epoch = tuple[int, int, float]
"""Number, claimant and the time on its clock, s: no two claims have the same, not even after a loss of memory."""
Age = tuple[Epoch, int]
"""Epoch and hop: of two tokens, or two words of one, the newer is the greater."""
UNHEARD: Epoch = (0, -1, 0.0)


class Token(NamedTuple):
    """The right to revise, and all that is known."""

    epoch: Epoch
    hop: int
    """How many revisions there were."""
    visits: tuple[int, ...]
    """The hop at which each pursuer was last visited, or tried or greeted in vain; 0 if never."""
    absent: tuple[int, ...]
    """Who did not answer."""
    records: tuple[Any, ...]
    """The newest of each pursuer, as far as the sender knows."""


class Receipt(NamedTuple):
    """Answer to a token or a greeting; what was sent is of no use if the epoch is newer than its own."""

    epoch: Epoch
    hop: int


class Sign(NamedTuple):
    """Word that a token of this age is in use: a claim if the epoch is new."""

    epoch: Epoch
    hop: int
    asks: bool = False
    """Whether an answer is wanted: a greeting."""


def not_absent(token: Token, pursuers: list[int]) -> list[int]:
    """Return those of some pursuers that are not known to be absent."""
    return [j for j in pursuers if j not in token.absent] if token.absent else pursuers


def visited(token: Token, pursuer: int) -> tuple[int, ...]:
    """Return the visits, with one at this hop."""
    return (*token.visits[:pursuer], token.hop, *token.visits[pursuer + 1 :])


def neglects(token: Token) -> bool:
    """Return whether somebody who is present was not visited for N hops, and may come to think that it is lost."""
    return any(last < token.hop - len(token.visits) for j, last in enumerate(token.visits) if j not in token.absent)


def longest_absent(token: Token, pursuers: list[int]) -> int | None:
    """Return who of some pursuers is absent and was not tried or greeted for longest, if that is N hops or more."""
    long_ago = token.hop - len(token.visits)
    due = [j for j in pursuers if j in token.absent and token.visits[j] <= long_ago]
    return min(due, key=token.visits.__getitem__, default=None)
