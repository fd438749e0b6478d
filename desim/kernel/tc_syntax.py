"""The words and options of commands `tc qdisc add ... netem`, as the manual page tc-netem(8) describes them."""

import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

from desim.kernel.graphs import Order
from desim.kernel.tc_units import rate_of, share_of, time_of

LINK = "link {src} -> {dst}"
"""The comment above the command of a link with models of its own."""
HEADERS = 42
"""Bytes of the headers of Ethernet, IPv4 and UDP, which netem counts as part of a packet."""
MAX_LIMIT = 2**32 - 1
"""Largest limit of a queue in tc, packets."""
NOT_MODELLED = {
    "corrupt": "desim corrupts no messages; a packet with a wrong checksum is lost, see loss",
    "slot": "desim has no slots of netem; see network.medium.access",
    "ecn": "desim has no congestion notification",
    "seed": "the seed is a key of the scenario",
}
"""The options of netem that desim does not have, and why."""
SYNONYMS = {"latency": "delay", "drop": "loss"}
LOSSES = {"random": 2, "state": 5, "gemodel": 4}
"""The loss models of netem, with the largest number of their values."""
Way = tuple[int, int]
"""Sender and receiver of a link."""
_COMMENT = re.compile(r"#\s*" + LINK.format(src=r"(\d+)", dst=r"(\d+)"))
_Value = TypeVar("_Value")


class TcError(ValueError):
    """Raised when a command of tc is invalid or not modelled; the message has the line and the column."""


class Command(NamedTuple):
    """A command that adds netem."""

    where: str
    """Source, line and column of its end."""
    way: Way | None
    """The link that the comment above it names; None: no link."""
    options: dict[str, Any]
    """The values of each option, see `OPTIONS`."""


class _Words:
    """The words of a command, each with its source, line and column; they are taken one after the other."""

    def __init__(self, words: list[tuple[str, str]]):
        self._words, self._next = words, 0

    @property
    def where(self) -> str:
        """Source, line and column of the word that was taken last, or of the first word."""
        return self._words[max(self._next - 1, 0)][1]

    def peek(self) -> str:
        """Return the next word; "" at the end."""
        return self._words[self._next][0] if self._next < len(self._words) else ""

    def take(self, allowed: str) -> str:
        """Take the next word; `allowed` says what it may be.

        Raises:
            TcError: if there is none.
        """
        if self._next == len(self._words):
            raise TcError(f"{self.where}: {self._words[-1][0]!r} should be followed by {allowed}")
        self._next += 1
        return self._words[self._next - 1][0]

    def value(self, convert: Callable[[str], _Value]) -> _Value:
        """Take the next word as a value.

        Raises:
            TcError: if there is none, or it is invalid.
        """
        word = self.take("a value")
        try:
            return convert(word)
        except ValueError as error:
            raise self.wrong(str(error)) from error

    def values(self, convert: Callable[[str], _Value], most: int) -> list[_Value]:
        """Take a value, and further ones up to `most` while the next word begins with a digit, as in tc."""
        found = [self.value(convert)]
        while len(found) < most and self.has_number:
            found.append(self.value(convert))
        return found

    @property
    def has_number(self) -> bool:
        """Whether the next word begins with a digit."""
        return self.peek()[:1].isdecimal()

    def wrong(self, why: str) -> TcError:
        """Return the error about the word that was taken last."""
        return TcError(f"{self.where}: {self._words[self._next - 1][0]!r} {why}")


def order_of(*, reorders: bool, has_rate: bool) -> Order:
    """Return the order in which netem delivers packets whose delays vary.

    With a rate, each packet waits for the one before, unless it is reordered.
    """
    return "fifo" if has_rate and not reorders else "overtaking"


def commands(text: str, source: str) -> Iterator[Command]:
    """Yield the commands of a text that add netem; other comments and commands `tc qdisc del` are skipped.

    Args:
        text: the commands, one in a line; a line may be continued after a backslash.
        source: a name of the text, for messages.

    Raises:
        TcError: if a line is no command of `tc qdisc`, or has an option that is invalid or not modelled.
    """
    way: Way | None = None
    words: list[tuple[str, str]] = []
    for number, line in enumerate([*text.splitlines(), ""], 1):
        if line.lstrip().startswith("#"):
            match = _COMMENT.fullmatch(line.strip())
            way = (int(match[1]), int(match[2])) if match else way
            continue
        continues = line.rstrip().endswith("\\")
        here = line.rstrip()[:-1] if continues else line
        words += [(each[0], f"{source}:{number}:{each.start() + 1}") for each in re.finditer(r"\S+", here)]
        if words and not continues:
            command = _Words(words)
            if _adds_netem(command):
                yield Command(words[0][1], way, _options(command))
            way, words = None, []


def _adds_netem(words: _Words) -> bool:
    """Take the words of a command up to `netem`; return False for `tc qdisc del`.

    Raises:
        TcError: if it is no command of `tc qdisc`.
    """
    form = "is not allowed here; a command is: tc qdisc add|change|replace dev DEVICE root netem OPTIONS"
    while words.peek() == "sudo" or "=" in words.peek():  # a variable of the environment
        words.take(form)
    if words.peek() == "ip":
        for each in ("ip", "netns", "exec"):
            if words.take(each) != each:
                raise words.wrong(form)
        words.take("a namespace")
    for allowed in (["tc"], ["qdisc"], ["add", "change", "replace", "del"]):
        word = words.take("|".join(allowed))
        if word not in allowed:
            raise words.wrong(form)
    if word == "del":
        return False
    while (word := words.take("netem")) != "netem":
        if word in {"dev", "parent", "handle"}:
            words.take("a value")
        elif word != "root":
            raise words.wrong("is not allowed here; allowed: dev, parent, handle, root, netem")
    return True


def _options(words: _Words) -> dict[str, Any]:
    """Take the options of netem; return their values.

    Raises:
        TcError: if an option is unknown, not modelled, given twice or without another that it needs, or has a wrong
            value.
    """
    found: dict[str, Any] = {}
    while words.peek():
        word = words.take("an option")
        name = SYNONYMS.get(word, word)
        if name in NOT_MODELLED:
            raise words.wrong(f"is not modelled: {NOT_MODELLED[name]}")
        if name not in OPTIONS:
            raise words.wrong(f"is not allowed here; allowed: {', '.join(OPTIONS)}")
        if name in found:
            raise words.wrong("is given twice")
        found[name] = OPTIONS[name](words)
    for name, needed in (("gap", "reorder"), ("distribution", "delay"), ("reorder", "delay")):
        if name in found and needed not in found:
            raise TcError(f"{words.where}: {name} needs {needed}")
    return found


def _delay(words: _Words) -> tuple[float, float, float]:
    delay, *more = words.values(time_of, 2)
    correlation = words.value(share_of) if more and words.has_number else 0.0
    return delay, more[0] if more else 0.0, correlation


def _event(words: _Words) -> tuple[float, float]:
    probability, *more = words.values(share_of, 2)
    return probability, more[0] if more else 0.0


def _loss(words: _Words) -> tuple[str, list[float]]:
    model = "random" if words.has_number else words.take("a percentage, random, state or gemodel")
    if model not in LOSSES:
        raise words.wrong(f"is not allowed here; allowed: a percentage, {', '.join(LOSSES)}")
    return model, words.values(share_of, LOSSES[model])


def _rate(words: _Words) -> tuple[float, int]:
    rate = words.value(rate_of)
    overhead = words.value(int) if re.fullmatch(r"-?\d+", words.peek()) else 0
    if words.has_number:
        words.take("an option")
        raise words.wrong("is not modelled: desim has no cells")
    return rate, overhead


def _table_name(word: str) -> str:
    if not re.fullmatch(r"[\w.+-]+", word):
        raise ValueError("should be the name of a table, without folder and suffix")
    return word


def _packets(words: _Words) -> int:
    def convert(word: str) -> int:
        if not re.fullmatch(r"[0-9]+", word) or not 1 <= int(word) <= MAX_LIMIT:
            raise ValueError(f"should be a whole number in 1 .. {MAX_LIMIT}")
        return int(word)

    return words.value(convert)


OPTIONS: dict[str, Callable[[_Words], Any]] = {
    "delay": _delay,
    "distribution": lambda words: words.value(_table_name),
    "reorder": _event,
    "gap": _packets,
    "loss": _loss,
    "duplicate": _event,
    "rate": _rate,
    "limit": _packets,
}
"""The options of netem that desim models, with the functions that take and return their values: delay, jitter (s) and
correlation; the name of a table; probability and correlation; packets; a loss model and its values; bit rate and
overhead (bytes)."""
