"""Errors about keys, models and metrics of users: what is wrong and where, as fields. Nobody has to parse a message."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from desim.config.arguments import without_addresses

KeyPath = tuple[str | int, ...]
"""A place: the keys and the indices of lists that lead to a key."""


class Problem(NamedTuple):
    """What is wrong with a key; as text "where: key: reason" in one line, without the parts that are empty."""

    reason: str
    key: str = ""
    """The dotted key, relative to the model that raises the error; "" if the problem belongs to no key."""
    where: str = ""
    """The file and the line, or a description of the override that set the key."""
    line: int = 0
    """The line in the file; 0 if there is none."""

    def __str__(self) -> str:
        text = ": ".join(part for part in (self.where, self.key, self.reason) if part)
        return without_addresses(text).replace("\n", "\\n")  # the name of a file may have a line end

    def below(self, above: str) -> "Problem":
        """Return the problem with its key relative to the table that contains the model at the key `above`."""
        return self._replace(key=f"{above}.{self.key}" if self.key else above)


WordingOf = Callable[[Any, type, Mapping[str, Any]], tuple[Problem, ...]]
WORDINGS: dict[str, WordingOf] = {}
"""Under "call", the function that returns the problems, given an error of pydantic, the class and the values of a call.

`desim` inserts it: the base of models calls it, and cannot import its module, which imports the base."""


class KeyedError(ValueError):
    """One or several problems with keys: its arguments, each a `Problem` or a text without a key."""

    @property
    def problems(self) -> tuple[Problem, ...]:
        """The problems, in order."""
        return tuple(problem if isinstance(problem, Problem) else Problem(str(problem)) for problem in self.args)

    @property
    def key(self) -> str:
        """The key of the first problem."""
        return self.problems[0].key

    @property
    def reason(self) -> str:
        """The reason of the first problem."""
        return self.problems[0].reason

    def __str__(self) -> str:
        return "\n".join(map(str, self.args))


def cause_in(error: Any) -> Exception | None:
    """Return the first exception in an error of pydantic that has a cause of its own; None if there is none.

    `raise ... from` it makes Python show the original failure, such as that of the import of a user's module.
    """
    parts = (part.get("ctx", {}).get("error") for part in error.errors(include_url=False, include_input=False))
    return next((part for part in parts if isinstance(part, Exception) and part.__cause__ is not None), None)


def problems_of(error: ValueError) -> tuple[Problem, ...]:
    """Return the problems of an error; the text of an error without fields is a problem without a key."""
    return error.problems if isinstance(error, KeyedError) else (Problem(str(error)),)


class ArgumentError(ValueError):
    """A wrong argument of a function: its name, and what is wrong, with the names of other arguments in backticks.

    As a text, the reason continues the name: "rate should be positive", or "style: ..." if it begins with a colon.
    """

    def __init__(self, name: str, reason: str):
        super().__init__(name, reason)
        self.name, self.reason = name, reason

    def __str__(self) -> str:
        return without_addresses(f"{self.name}{'' if self.reason.startswith(':') else ' '}{self.reason}")


class AnswerError(ValueError):
    """A model of a user cannot be called as one of its kind, or returned a wrong value; see `desim.config.answers`."""


class MetricError(RuntimeError):
    """Raised when a user's metric fails or returns a wrong type; the text names metric, scenario and seed."""


class NoMetricError(ValueError):
    """Raised if there is no numeric metric of a name."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(text)
        self.name = name

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.name, str(self))
