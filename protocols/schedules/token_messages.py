"""The token, and the messages about it that the pursuers send each other; see `protocols.schedules.token_passing`."""

from typing import Any, NamedTuple

from desim.kernel.core.ports import ReservedPort

PORT = ReservedPort("token", __name__)
"""The port at which tokens, receipts and notices arrive."""
Epoch = tuple[int, int, float]
"""Serial number, pursuer that started the epoch, and its local time then, s: unique even after a loss of memory."""
Age = tuple[Epoch, int]
"""Epoch and hop of a token, or of a message about it. The greater age is the newer one."""
UNHEARD: Epoch = (0, -1, 0.0)
"""The epoch that a node knows before it has heard of any token; older than all others."""


class Token(NamedTuple):
    """The right to revise, with the known records of all pursuers."""

    epoch: Epoch
    hop: int
    """Number of revisions so far."""
    visits: tuple[int, ...]
    """(N,) hop of the last visit to each pursuer, or of the last failed delivery or probe; 0 if none."""
    absent: tuple[int, ...]
    """The pursuers that did not answer."""
    records: tuple[Any, ...]
    """The newest record of each pursuer known to the sender."""


class TokenReceipt(NamedTuple):
    """Answers a token, a probe or an outdated message; a receipt whose epoch is newer than the message rejects it."""

    epoch: Epoch
    hop: int


class TokenNotice(NamedTuple):
    """Announces that a token of this age is in use; a new epoch announces a new token."""

    epoch: Epoch
    hop: int
    asks: bool = False
    """Whether the notice is a probe, to be answered by a receipt."""


TokenMessage = Token | TokenReceipt | TokenNotice


def age_of(message: TokenMessage) -> Age:
    """Return the age of a token, or of the token that a message is about."""
    return message.epoch, message.hop


def not_absent(token: Token, pursuers: list[int]) -> list[int]:
    """Return those of the pursuers that are not known to be absent."""
    return [j for j in pursuers if j not in token.absent] if token.absent else pursuers


def visited(token: Token, pursuer: int) -> tuple[int, ...]:
    """Return the visits of the token after a visit to a pursuer at the present hop."""
    return (*token.visits[:pursuer], token.hop, *token.visits[pursuer + 1 :])


def neglects(token: Token) -> bool:
    """Return whether a pursuer that is not absent was last visited over N hops ago, and may take the token for lost."""
    return any(last < token.hop - len(token.visits) for j, last in enumerate(token.visits) if j not in token.absent)


def longest_absent(token: Token, pursuers: list[int]) -> int | None:
    """Return the pursuer, among the given ones, to probe next; None if no probe is due.

    It is the absent pursuer whose last visit, failed delivery or probe was the longest ago, at least N hops.
    """
    long_ago = token.hop - len(token.visits)
    due = [j for j in pursuers if j in token.absent and token.visits[j] <= long_ago]
    return min(due, key=token.visits.__getitem__, default=None)
