"""Errors about wrong arguments of functions and missing attributes of objects, which say what to write instead."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import wraps
from inspect import Parameter, signature
from os import PathLike
from types import MappingProxyType, NoneType
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar, get_args, get_origin

from desim.config.suggestion import did_you_mean

Taken = ParamSpec("Taken")
Returned = TypeVar("Returned")


class Argument(NamedTuple):
    """An argument of a function: its type, and the code to write for objects of other types that users give."""

    noun: str
    """What the argument is, for example "a scenario"."""
    kind: type | tuple[type, ...]
    """The class of the accepted objects, or several."""
    instead: Mapping[str, str]
    """The code to write, by name of the class of a wrong object; "path" stands for a path or a text. In the code,
    `{function}` and `{value}` stand for the name of the function and for the object."""

    def check(self, value: Any, function: str) -> None:
        """Raise TypeError if a value is not what a function takes; the message says what to write instead."""
        if not isinstance(value, self.kind):
            raise TypeError(f"{function} takes {self.noun}, {self._advice(value, function)}")

    def _advice(self, value: Any, function: str) -> str:
        """Return the end of the message: what a wrong value is, and what to write instead."""
        if isinstance(value, type):
            call = f": {function}({value.__name__}(...))" if issubclass(value, self.kind) else ""
            return f"not the class {value.__name__}{call}"
        is_path = isinstance(value, str | PathLike)
        name, shown = type(value).__name__, value_text(str(value) if is_path else value)
        code = self.instead.get("path" if is_path else name)
        if code is None:
            return f"not {with_article(name)} (got {abridged(shown)})"
        what = "a path" if is_path else with_article(name)
        return f"not {what}: {code.format(function=function, value=shown)}"


RESULTS = Argument("the path of a folder with results", (str, PathLike), MappingProxyType({}))
_ADDRESS = re.compile(
    r"<(?:(?:function|generator|coroutine|async_generator) )?(?:object )?(?:(?:[^<>]|<\w+>)*\.)?(\w+|<\w+>)"
    r"(?: object)? at 0x[0-9a-fA-F]+>"
)
"""Matches the default representation of an object, a function or a generator; its name is the group."""
_OTHER_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]{6,}")
"""Matches the address in other representations, for example those of a future and of a generator of numpy."""
MAX_SHOWN = 60
"""The largest number of characters of a value that a message shows."""


def value_text(value: object) -> str:
    """Return the representation of a value as one line, in which objects and functions have no addresses."""
    return without_addresses(" ".join(repr(value).split()))


def without_addresses(text: str) -> str:
    """Return a text in which objects and functions have no addresses, which differ from process to process."""
    return _OTHER_ADDRESS.sub("", _ADDRESS.sub(r"\1", text))


def abridged(text: str) -> str:
    """Return a value as text, cut to what a message shows, and without addresses."""
    text = without_addresses(text)
    return text if len(text) < MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."


def scenario_argument(kind: type) -> Argument:
    """Return the argument of functions that take a scenario, given its class."""
    instead = {
        "path": "{function}(load({value}))",
        "dict": "{function}(Scenario(**keys))",
        "Result": "{function}(result.scenario)",
        "list": "[{function}(scenario) for scenario in scenarios]",
    }
    return Argument("a scenario", kind, MappingProxyType(instead))


def run_argument(*kinds: type) -> Argument:
    """Return the argument of functions that take the result of a run, given its classes."""
    instead = {
        "path": "{function}(desim.open({value})) for a folder, {function}(run(load({value}))) for a scenario file",
        "Scenario": "{function}(run(scenario))",
        "SweepResult": "result.table() and result.plot() show a sweep, and result.write('runs.csv') writes its runs",
        "list": "[{function}(result) for result in results]",
    }
    return Argument("the result of a run", kinds, MappingProxyType(instead))


def with_article(noun: str) -> str:
    """Return a noun with its indefinite article, for example "an Evader"."""
    return f"an {noun}" if noun[:1] in "AEIOUaeiou" else f"a {noun}"


NUMBER_OF_RUNS = ("reps", "runs", "most")
"""The names that the number of runs has in the functions of desim."""
SYNONYMS = MappingProxyType(
    {
        "cores": ("executor", "jobs"),
        "filename": ("path",),
        "jobs": ("executor",),
        "latency": ("links",),
        "loss": ("links",),
        "n": NUMBER_OF_RUNS,
        "n_jobs": ("executor", "jobs"),
        "n_runs": NUMBER_OF_RUNS,
        "network": ("links",),
        "num_runs": NUMBER_OF_RUNS,
        "overrides": ("changes",),
        "processes": ("executor", "jobs"),
        "range": ("links",),
        "repeats": NUMBER_OF_RUNS,
        "repetitions": NUMBER_OF_RUNS,
        "reps": NUMBER_OF_RUNS,
        "runs": NUMBER_OF_RUNS,
        "samples": ("points",),
        "window": ("begin",),
        "workers": ("executor", "jobs"),
    }
)
"""By name of an argument in other packages: its names in desim. A message suggests the first that the function has."""
EXAMPLES = MappingProxyType(
    {
        "Scenario.with_": ", for instance scenario.with_({'network.latency.value': 0.5})",
        "SweepResult.crossover": ", for instance"
        " result.crossover('active_time', 'network.latency.value', {'protocol': 'sap'}, {'protocol': 'cbba'})",
        "find_violation": "; another protocol is one of the scenario: scenario.with_({'protocol.kind': 'cbba'})",
        "run": "; for several seeds write [run(scenario, seed) for seed in range(5)], or use sweep",
    }
)
"""By qualified name of a function: the end of a message, with the call that users look for."""


def naming_arguments(function: Callable[Taken, Returned]) -> Callable[Taken, Returned]:
    """Decorate a function, so that the error about a wrong argument lists the arguments that the function takes.

    Python's message names only the wrong argument. The decorated function also checks the types of flags, functions,
    tables and lists of texts: as a flag, the text "no" would count as true.
    """
    kinds = _kinds_of_arguments(function)
    names = list(signature(function).parameters)

    @wraps(function)
    def checked(*args: Taken.args, **named: Taken.kwargs) -> Returned:
        for name, value in (*zip(names, args, strict=False), *named.items()):
            if name in kinds and not kinds[name].accepts(value):
                raise ValueError(f"{name} should be {kinds[name].text} (got {abridged(repr(value))})")
        try:
            return function(*args, **named)
        except TypeError as error:
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:  # raised inside of the function
                raise
            name = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]
            message = f"{error}{_suggested_name(function, named)}; it is {name}{arguments_of(function)}"
            message += EXAMPLES.get(function.__qualname__, "")
        raise TypeError(message)

    return checked


class _Kind(NamedTuple):
    """A kind of argument: its name in messages, and the test of a value."""

    text: str
    accepts: Callable[[Any], bool]


def _is_of_texts(value: Any) -> bool:
    """Return whether a value is a collection of texts; an iterator is accepted, because it can be read only once."""
    return isinstance(value, Iterable) and (isinstance(value, Iterator) or all(isinstance(text, str) for text in value))


_A_DICT = "a dict, {'network.latency.value': 0.5} for instance"
# The booleans of numpy are recognised by the names of their types, without an import of numpy.
FLAG = _Kind("True or False", lambda value: isinstance(value, bool) or type(value).__name__ in {"bool", "bool_"})
FUNCTION = _Kind("a function", callable)
TABLE = _Kind(_A_DICT, lambda value: isinstance(value, Mapping))
TABLE_OR_NONE = _Kind(_A_DICT, lambda value: value is None or isinstance(value, Mapping))
TEXTS = _Kind("a list of texts", _is_of_texts)
CHECKED_BY_FUNCTION = frozenset({"changes", "grid", "links", "metrics", "vary"})
"""The arguments that each function checks itself, with an example of its own in the error."""


def _kinds_of_arguments(function: Callable[..., object]) -> Mapping[str, _Kind]:
    """Return the kind of each argument of a function that is a flag, a function, a table or texts, by name."""
    kinds = {}
    for name, parameter in signature(function).parameters.items():
        origins = {get_origin(kind) for kind in (parameter.annotation, *get_args(parameter.annotation))}
        if parameter.annotation is bool:
            kinds[name] = FLAG
        elif Mapping in origins and name not in CHECKED_BY_FUNCTION:
            kinds[name] = TABLE_OR_NONE if NoneType in get_args(parameter.annotation) else TABLE
        elif parameter.annotation == Sequence[str] and name not in CHECKED_BY_FUNCTION:
            kinds[name] = TEXTS
        elif get_origin(parameter.annotation) is Callable and parameter.kind is not Parameter.VAR_POSITIONAL:
            kinds[name] = FUNCTION
    return MappingProxyType(kinds)


def _suggested_name(function: Callable[..., object], named: Mapping[str, object]) -> str:
    """Return the end of a message that suggests the name of an argument; "" if no name is wrong, or none is similar."""
    names = [name for name in signature(function).parameters if name != "self"]
    wrong = next((name for name in named if name not in names), None)
    if wrong is None:
        return ""
    synonym = next((name for name in SYNONYMS.get(wrong.lower(), ()) if name in names), None)
    return did_you_mean(wrong, names) if synonym is None else f", did you mean {synonym!r}?"


def arguments_of(function: Callable[..., object]) -> str:
    """Return the arguments of a function as in its definition, without annotations and without `self`.

    A default that is a function is shown as "...".
    """
    complete = signature(function)
    plain = [
        item.replace(annotation=Parameter.empty, default=_Ellipsis() if callable(item.default) else item.default)
        if item.default is not Parameter.empty
        else item.replace(annotation=Parameter.empty)
        for name, item in complete.parameters.items()
        if name != "self"
    ]
    return str(complete.replace(parameters=plain, return_annotation=complete.empty))


class _Ellipsis:
    """A default that is shown as "..."."""

    def __repr__(self) -> str:
        return "..."


class HintedItems:
    """Base of classes without items: the error about an index says what to write instead."""

    def _instead_of(self, name: str) -> str:
        """Return what to write instead of an attribute or an index, as the end of a message."""
        raise NotImplementedError

    if not TYPE_CHECKING:  # a type checker reports missing attributes itself

        def __getitem__(self, key: object) -> object:
            """Raise TypeError with what to write, because the object is no table."""
            raise TypeError(f"{with_article(type(self).__name__)} is no table: {self._instead_of(str(key))}")


class HintedAttributes(HintedItems):
    """Base of classes without items: the error about an index or a missing attribute says what to write instead.

    Each look-up of an attribute takes several times as long as without `__getattr__`.
    """

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> object:
            """Raise AttributeError with what to write; called only if there is no such attribute."""
            if hasattr(type(self), name):  # a property has raised an AttributeError
                return object.__getattribute__(self, name)
            raise missing_attribute(self, name)


def missing_attribute(owner: object, name: str) -> AttributeError:
    """Return the error for an attribute that an object does not have; the message says what to write instead."""
    return AttributeError(_Missing(owner, name), name=name, obj=owner)


class _Missing:
    """The message about a missing attribute, made when it is read: programs often only ask whether there is one."""

    def __init__(self, owner: object, name: str):
        self._owner, self._name = owner, name

    def __str__(self) -> str:
        text = f"{with_article(type(self._owner).__name__)} has no {self._name!r}"
        instead_of = getattr(type(self._owner), "_instead_of", None)
        if self._name.startswith("_") or instead_of is None:
            return text
        return f"{text}: {instead_of(self._owner, self._name)}"

    __repr__ = __str__

    def __reduce__(self) -> tuple[Any, ...]:
        return str, (str(self),)
