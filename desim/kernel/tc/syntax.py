"""The words and options of commands `tc qdisc add ... netem`, as the manual page tc-netem(8) describes them.

The text is a script of a shell: commands end with a line, `;`, `&&` or `||`; a backslash continues a line; `#` begins a
comment; the output of a command may be redirected. A command may be run by `sudo`, `env`, `ip netns exec` or
`docker exec`. Variables have the values that lines `NAME=value` above give them. Commands that set up addresses and
modules have no effect; others are refused, because what they do to links is not known.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

from desim.kernel.models.graphs import Order
from desim.kernel.models.own_links import Way
from desim.kernel.tc.units import duration_of, rate_of, share_of

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
_COMMENT = re.compile(r"#\s*" + LINK.format(src=r"(\d+)", dst=r"(\d+)"))
_Value = TypeVar("_Value")


class TcError(ValueError):
    """Raised when a command of tc is invalid or not modelled; the message has the line and the column."""


Device = tuple[str, ...]
"""Where a discipline is: the words that name a namespace or container, the device, and the parent; "" at the root."""


class Command(NamedTuple):
    """A command about the queueing discipline of a device."""

    where: str
    """Source, line and column of its start."""
    way: Way | None
    """The link that a comment above it, or at its end, names; None: no link."""
    action: str
    """One of `ACTIONS`."""
    device: Device
    handle: str
    """The handle of the queueing discipline; "" if it is not given."""
    options: dict[str, Any]
    """The values of each option of netem, see `OPTIONS`."""


ACTIONS = ("add", "change", "replace", "delete", "show", "list", "lst")
"""The actions of `tc qdisc`. As in tc, an abbreviation stands for the first action that begins with it."""
FORM = "is not allowed here; a command is: tc qdisc add|change|replace dev DEVICE root netem OPTIONS"
NOTHING = frozenset({"true", ":", "set", "echo"})
"""The commands that do nothing to links."""
SET_UP = frozenset({"ip", "ifconfig", "modprobe", "sysctl"})
"""The commands that set up addresses and modules, unless they have one of the words in `ENDING`."""
ENDING = frozenset({"down", "del", "delete", "flush"})
"""Words with which a command in `SET_UP` may end a link."""
IP_OBJECTS = frozenset({"link", "addr", "address", "route", "neigh", "rule", "netns", "tuntap"})
"""What `ip` may set up by `add` or `set`."""
_ASSIGNMENT = re.compile(r"(\w+)=(.*)", re.ASCII)
_VARIABLE = re.compile(r"\$(?:(\w+)|\{(\w+)(?:(:?-)([^$}]*))?\})", re.ASCII)
"""Matches the use of a variable, perhaps with a default."""
WITH_VALUE = {
    "sudo": {"-u", "-g", "--user", "--group"},
    "env": {"-u"},
    "docker": {"-e", "-u", "-w", "--env", "--user", "--workdir"},
    "tc": {"-n", "-netns"},
}
"""The options of programs that are followed by a value."""
_TOKEN = re.compile(
    r"""(?P<space>[ \t\r\f\v]+|\\\r?\n)|(?P<comment>\#[^\n]*)|(?P<redirection>(?:\d*|&)>>?[ ]*(?:&\d|[^\s;&|<>()]+))"""
    r"""|(?P<end>\n|;|&&|\|\|)|(?P<word>(?:[^\s;&|<>()'"\\]|\\\S|'[^'\n]*'|"[^"\n]*")+)|(?P<other>.)"""
)
"""Matches a token of a shell; `#` begins a comment only at the start of a word."""
_QUOTES = re.compile(r"""'([^']*)'|"([^"]*)"|\\(.)""")


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

    def values(self, convert: Callable[[str], _Value], max_count: int) -> list[_Value]:
        """Take a value, and further ones while the next word begins with a digit, as in tc; at most `max_count`."""
        numbers = [self.value(convert)]
        while len(numbers) < max_count and self.has_number:
            numbers.append(self.value(convert))
        return numbers

    @property
    def has_number(self) -> bool:
        """Whether the next word begins with a digit."""
        return self.peek()[:1].isdecimal()

    @property
    def all(self) -> list[str]:
        """All words of the command."""
        return [word for word, _ in self._words]

    def wrong(self, problem: str) -> TcError:
        """Return the error about the word that was taken last."""
        word = self._words[self._next - 1][0]
        hint = "; no line above gives this variable a value" if "$" in word else ""
        return TcError(f"{self.where}: {word!r} {problem}{hint}")


def order_of(*, reorders: bool, has_rate: bool) -> Order:
    """Return the order in which netem delivers packets whose delays vary.

    With a rate, each packet waits for the one before, unless it is reordered.
    """
    return "fifo" if has_rate and not reorders else "overtaking"


def commands(text: str, source: str) -> Iterator[Command]:
    """Yield the commands of a text that add, change or delete queueing disciplines.

    Args:
        text: a script of a shell with no other commands.
        source: a name of the text, for messages.

    Raises:
        TcError: if a command is none of `tc qdisc`, or has an option that is invalid or not modelled.
    """
    way: Way | None = None
    words: list[tuple[str, str]] = []
    values: dict[str, str] = {}  # of variables
    previous: Command | None = None  # the command before `||`
    line, line_begin = 1, 0
    for token in _TOKEN.finditer(text.removeprefix("\ufeff") + "\n"):
        where = f"{source}:{line}:{token.start() - line_begin + 1}"
        match token.lastgroup:
            case "word":
                word = _QUOTES.sub(lambda part: part[1] or part[2] or part[3] or "", token[0])
                expanded = word if "'" in token[0] else _with_values(word, values)
                # As a shell does, a value without quotes is split into words.
                parts = expanded.split() if expanded != word and '"' not in token[0] else [expanded]
                words += ((part, where) for part in parts)
            case "comment" if match := _COMMENT.fullmatch(token[0].strip()):
                way = int(match[1]), int(match[2])
            case "other":
                raise TcError(f"{where}: {token[0]!r} {FORM}")
            case "end" if words:
                is_assignment = _assign(_Words(words).all, values)
                command = None if is_assignment else _command(_Words(words), way)
                words = []
                if command is not None and not _repeats(command, previous):
                    yield command
                    way = way if command.action == "delete" else None  # the comment is for the command after a deletion
                previous = command if token[0] == "||" else None
        if "\n" in token[0]:
            line, line_begin = line + 1, token.end()


def _with_values(word: str, values: dict[str, str]) -> str:
    """Return a word with the values of variables; one without a value stays, unless it has a default."""

    def expansion(use: re.Match[str]) -> str:
        value = values.get(use[1] or use[2])
        if value is None or (not value and use[3] == ":-"):
            return use[0] if use[3] is None else use[4]
        return value

    return _VARIABLE.sub(expansion, word)


def _assign(words: list[str], values: dict[str, str]) -> bool:
    """Return whether a command gives values to variables; keep the values, but forget those that a shell computes."""
    pairs = [_ASSIGNMENT.fullmatch(word) for word in (words[1:] if words[0] == "export" else words)]
    if not pairs or None in pairs:
        return False
    for pair in pairs:
        if pair is not None:
            values.pop(pair[1], None)
            values |= {} if set(pair[2]) & {"$", "`"} else {pair[1]: pair[2]}
    return True


def _does_nothing(words: list[str]) -> bool:
    """Return whether a command has no effect on links."""
    while words[:1] == ["sudo"]:
        words = words[1:]
    if words[:3] == ["ip", "netns", "exec"]:
        words = words[4:]
    name = words[0].rpartition("/")[2] if words else ""
    if name == "ip" and not (len(words) > 2 and words[1] in IP_OBJECTS and words[2] in {"add", "set"}):
        return False
    return name in NOTHING or (name in SET_UP and ENDING.isdisjoint(words))


def _repeats(command: Command, previous: Command | None) -> bool:
    """Return whether a command is the same as the one before `||`, as in `tc ... change ... || tc ... add ...`.

    Raises:
        TcError: if it is another command, because it is not known which of the two has an effect.
    """
    if previous is None or "delete" in {previous.action, command.action}:
        return False
    if (previous.device, previous.options) != (command.device, command.options):
        raise TcError(f"{command.where}: differs from the command before ||; which of them has an effect is not known")
    return True


def _command(words: _Words, way: Way | None) -> Command | None:
    """Return the command that the words make; None if it changes nothing.

    Raises:
        TcError: if it is no command of `tc qdisc`.
    """
    where = words.where
    if _does_nothing(words.all):
        return None
    runner = _runner(words)
    namespace = _flags(words, "tc")
    if not "qdisc".startswith(words.take("qdisc")):
        raise words.wrong(FORM)
    if not words.peek():  # `tc qdisc` alone shows the disciplines
        return None
    word = words.take("|".join(ACTIONS))
    action = next((action for action in ACTIONS if action.startswith(word)), None)
    if action is None:
        raise words.wrong(FORM)
    if action in {"show", "list", "lst"}:
        return None
    place = {"dev": "", "parent": "", "handle": ""}
    while words.peek() and (word := words.take("netem")) != "netem":
        if word in place:
            place[word] = words.take("a value")
        elif word != "root" and action != "delete":
            raise words.wrong("is not allowed here; allowed: dev, parent, handle, root, netem")
    if action != "delete" and word != "netem":
        words.take("netem")
    options = {} if action == "delete" else _options(words)
    return Command(where, way, action, (*runner, *namespace, place["dev"], place["parent"]), place["handle"], options)


def _runner(words: _Words) -> list[str]:
    """Take the words before the options of tc; return those that name where it runs."""
    place: list[str] = []
    while (word := words.take("tc")).rpartition("/")[2] != "tc":
        if "=" in word:  # a variable of the environment
            continue
        word = word.rpartition("/")[2]
        if word in {"sudo", "env"}:
            _flags(words, word)
        elif word == "ip":
            for expected in ("netns", "exec"):
                if words.take(expected) != expected:
                    raise words.wrong(FORM)
            place += "netns", words.take("a namespace")
        elif word in {"docker", "podman"}:
            if words.take("exec") != "exec":
                raise words.wrong(FORM)
            _flags(words, "docker")
            place += word, words.take("a container")
        else:
            raise words.wrong(FORM)
    return place


def _flags(words: _Words, program: str) -> list[str]:
    """Take the options of a program; return the namespace that they name."""
    place: list[str] = []
    while words.peek().startswith("-"):
        flag = words.take("an option")
        if program == "tc" and flag in {"-b", "-batch"}:
            raise words.wrong("is not allowed here: read the batch file itself, with `tc` before each line")
        if flag in WITH_VALUE[program]:
            value = words.take("a value")
            place += ("netns", value) if program == "tc" else ()
    return place


def _options(words: _Words) -> dict[str, Any]:
    """Take the options of netem; return their values.

    Raises:
        TcError: if an option is unknown, not modelled, given twice or without another that it needs, or has a wrong
            value.
    """
    options: dict[str, Any] = {}
    while words.peek():
        word = words.take("an option")
        name = SYNONYMS.get(word, word)
        if name in NOT_MODELLED:
            raise words.wrong(f"is not modelled: {NOT_MODELLED[name]}")
        if name not in OPTIONS:
            raise words.wrong(f"is not allowed here; allowed: {', '.join(OPTIONS)}")
        if name in options:
            raise words.wrong("is given twice")
        options[name] = OPTIONS[name](words)
    for name, needed in (("gap", "reorder"), ("distribution", "delay"), ("reorder", "delay")):
        if name in options and needed not in options:
            raise TcError(f"{words.where}: {name} needs {needed}")
    return options


def _delay(words: _Words) -> tuple[float, float, float]:
    delay, *more = words.values(duration_of, 2)
    correlation = words.value(share_of) if more and words.has_number else 0.0
    return delay, more[0] if more else 0.0, correlation


def _probability(words: _Words) -> tuple[float, float]:
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
    "reorder": _probability,
    "gap": _packets,
    "loss": _loss,
    "duplicate": _probability,
    "rate": _rate,
    "limit": _packets,
}
"""The options of netem that desim models, with the functions that take and return their values: delay, jitter (s) and
correlation; the name of a table; probability and correlation; packets; a loss model and its values; bit rate and
overhead (bytes)."""
