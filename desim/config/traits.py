"""Traits, the optional attributes of models: a subclass of `Traits` lists them, with types, defaults and descriptions.

A protocol, a schedule or a link model is any callable: a frozen model, an object of a user's class, or a function. An
attribute, own or inherited, that has the name of a trait sets this trait; all other traits have their defaults. No
base class is needed.

If the name of an attribute is one letter off the name of a trait, it is probably misspelt, and the attribute would have
no effect. `Traits.check` therefore raises an error if the value of the attribute would be valid for the trait, unless
the function or class with the attribute also has the trait. Only attributes of functions and classes are checked.
Private attributes, and attributes set in `__init__` or on a `functools.partial`, are not.

A trait may follow from other methods of a model: a faster way to compute the same, for example, or a bound. If a class
overrides such a method but not the trait, the inherited trait would still follow from the overridden method. The trait
then does not count: see `Follows`. Nor does it count for an object that wraps a model and passes on its attributes by
`__getattr__`: see `is_passed_on`. Conversely, a class that overrides only a fast way is refused: see `Traits.twins`.
"""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import Annotated, Any, ClassVar, Self, TypeGuard, TypeVar

from pydantic import BaseModel, BeforeValidator, ValidationError

from desim.config.arguments import value_text
from desim.config.error_texts import text_of
from desim.config.field_docs import annotated, fields_of
from desim.config.model import Value
from desim.config.python_numbers import as_python

Model = TypeVar("Model")
SHORTEST = 5
"""Minimum length of a trait for which misspellings are looked for; shorter words are one letter off many others."""


class Parameter(BeforeValidator):
    """Marks a trait that is a parameter of some models; a value of a type not in `types` counts as absent (None).

    Misspellings of the trait are not looked for, because a model rejects unknown parameters itself.

    Args:
        types: the allowed types of the parameter.
    """

    def __init__(self, *types: type):

        def parameter(value: Any) -> Any:
            number = as_python(value)
            return number if isinstance(number, types) and not isinstance(number, bool) else None

        super().__init__(parameter)


class Follows:
    """Marks a trait that follows from other methods: if a user's class overrides one of these, the trait is outdated.

    The trait counts again if the class that overrides the method, or a class derived from it, defines the trait. A
    class overrides a method if it defines the method and a base class has it, too. A trait whose class and base classes
    lack the method is therefore never outdated: it calls what subclasses add, as the inherited `draw` of
    `desim.kernel.models.latency.Uniform` calls `quantile`.

    Args:
        methods: the names of the methods.
        not_above: the name of a method that outdates a trait of a base class even if no base class has the method.
    """

    def __init__(self, *methods: str, not_above: str | None = None):
        self.methods = methods
        self.not_above = not_above

    def is_outdated(self, trait: str, model: type) -> bool:
        """Return whether the trait that a class of models has or inherits does not follow from methods of the class."""
        trait_positions = positions(model, trait)
        if not trait_positions or is_ours(model):  # in a built-in class, traits and methods agree
            return False
        position = trait_positions[0]
        if self.not_above is not None and min(positions(model, self.not_above), default=position) < position:
            return True
        return any(overrides(model, method, position) for method in self.methods)


class Traits(Value):
    """Base of the classes of traits. Each field is a trait; its default holds for objects without this attribute."""

    twins: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({})
    """The fast methods of built-in models by name, each with the plain methods that compute the same. A user's class
    that overrides a fast method should also override a plain one, which is called where there is no fast way."""
    kind: Annotated[str | None, Parameter(str)] = None
    """The name that is shown; if absent, the name of the class or function is shown."""
    depends_on: tuple[str | Path, ...] | Callable[[], Any] = ()
    """Paths of the data files of the model, or a method that returns them; see `desim.open_data`."""

    @classmethod
    def of(cls, value: Any) -> Self:
        """Return the traits of a model or a function.

        Raises:
            ValueError: if an attribute has a value that its trait cannot have.
        """
        model: type = type(value)
        try:
            left_out = cls.outdated(model) | cls.passed_on(value)
            return cls.model_validate(attributes(value, [name for name in cls.model_fields if name not in left_out]))
        except ValidationError as error:
            first = error.errors()[0]
            raise ValueError(
                f"{first['loc'][0]} of {name_of(value)}: {text_of(first)} (got {value_text(first['input'])})"
            ) from error

    @classmethod
    def check(cls, value: Any) -> None:
        """Raise ValueError if a model has an invalid or probably misspelt trait, or overrides a fast way alone."""
        cls.of(value)
        model: type = type(value)
        if "__call__" in getattr(value, "__dict__", ()):
            raise ValueError(
                f"{name_of(value)} has __call__ as an attribute of the object, which Python does not call: define it in"
                " the class"
            )
        names = tuple(cls.names())
        if is_ours(model) and (name := _replaced(model, ("__call__", *names))):
            raise ValueError(
                f"{name} of {name_of(value)} has been replaced in the class, and a run need not call it: derive a class"
                f" from {name_of(value)} that has its own {name}"
            )
        for fast_method, plain_methods in () if is_ours(model) else cls.twins.items():
            plain_positions = [defined[0] for name in plain_methods if (defined := positions(model, name))]
            if plain_positions and overrides(model, fast_method, min(plain_positions)):
                raise ValueError(
                    f"{name_of(value)} has its own {fast_method}, which only computes faster what {plain_methods[0]}"
                    f" does: it should have its own {plain_methods[0]}, too"
                )
        is_function = isinstance(value, FunctionType)
        for name, trait in _misspelt(names, vars(value)) if is_function else _misspelt_in(names, value.__class__):
            if any(cls._takes(trait, attribute) for attribute in attributes(value, [name]).values()):
                default = cls.model_fields[trait].default
                raise ValueError(
                    f"{name_of(value)} has an attribute {name!r}, did you mean {trait!r}? Attributes with an effect:"
                    f" {', '.join(names)}. To keep {name!r}, set {trait} = {default!r} beside it"
                )

    @classmethod
    @lru_cache(maxsize=256)
    def outdated(cls, model: type) -> frozenset[str]:
        """Return the names of the traits of a class of models that do not count; see `Follows`."""
        return frozenset(name for name, marker in cls._followers() if marker.is_outdated(name, model))

    @classmethod
    def passed_on(cls, value: Any) -> frozenset[str]:
        """Return the names of the traits that an object passes on from a model and that follow from methods there.

        `kind` counts among these, because it names the class with the methods.
        """
        if isinstance(value, BaseModel) or not hasattr(type(value), "__getattr__"):
            return frozenset()
        return frozenset(name for name in ("kind", *dict(cls._followers())) if is_passed_on(value, name))

    @classmethod
    @lru_cache(maxsize=64)
    def _followers(cls) -> tuple[tuple[str, Follows], ...]:
        """Return the names of the traits that follow from methods, with their markers."""
        markers = ((name, marker) for name, field in cls.model_fields.items() for marker in field.metadata)
        return tuple((name, marker) for name, marker in markers if isinstance(marker, Follows))

    @classmethod
    @lru_cache(maxsize=64)
    def calls(cls) -> Mapping[str, Sequence[str]]:
        """Return the names of the arguments of each trait that is a method, from the call in its description."""
        matches = {
            name: re.match(rf"`{name}\(([\w, ]*)\)`", field.description or "") for name, field in fields_of(cls).items()
        }
        return {name: tuple(filter(None, match[1].split(", "))) for name, match in matches.items() if match}

    @classmethod
    def names(cls) -> Iterator[str]:
        """Yield the names of the traits that are not parameters."""
        for name, field in cls.model_fields.items():
            if not any(isinstance(marker, Parameter) for marker in field.metadata):
                yield name

    @classmethod
    def _takes(cls, trait: str, value: Any) -> bool:
        """Return whether a trait could have this value."""
        try:
            cls.model_validate({trait: value})
        except ValidationError:
            return False
        return True


def is_passed_on(value: Any, name: str) -> bool:
    """Return whether an object has an attribute only because its `__getattr__` returns that of another object.

    A class of a user that wraps a model in this way has methods of its own, such as `__call__`. A trait of the model
    that follows from the model's method does not follow from that of the wrapper.
    """
    kind: type = type(value)
    if not hasattr(kind, "__getattr__") or isinstance(value, BaseModel):
        return False
    namespace = object.__getattribute__(value, "__dict__") if kind.__dictoffset__ else {}  # none with __slots__
    return not positions(kind, name) and name not in namespace


def check_inherited_flag(value: Any, flag: str, methods: Iterable[str], effect: str) -> None:
    """Raise ValueError if methods of a user's class are never called, because the class inherits or passes on a flag.

    Args:
        value: the model.
        flag: the name of the flag.
        methods: the names of the methods.
        effect: what the flag says, as a clause of the message.
    """
    kind: type = type(value)
    passes_on = is_passed_on(value, flag)
    uncalled = [
        name for name in methods if (positions(kind, name) if passes_on else Follows(name).is_outdated(flag, kind))
    ]
    if uncalled and getattr(value, flag):
        raise ValueError(
            f"{name_of(value)} {'passes on' if passes_on else 'inherits'} {flag} = True, so that {effect}, and its own"
            f" {', '.join(uncalled)} would have no effect: it should have {flag}: ClassVar[bool] = False, too"
        )


OURS = frozenset({"desim", "protocols"})
"""The packages of the built-in models."""


def _replaced(model: type, names: tuple[str, ...]) -> str | None:
    """Return the first of some methods that a user has replaced in a built-in class; None if there is none."""
    for name in _methods_in(model, names):
        function = getattr(model, name)
        owner = function if isinstance(function, FunctionType) else type(function)
        if module_of(owner).partition(".")[0] not in OURS:
            return name
    return None


@lru_cache(maxsize=256)
def _methods_in(model: type, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of some names that are methods of a class."""
    namespace = {name: value for base in reversed(model.__mro__) for name, value in vars(base).items()}
    functions = (name for name in names if callable(namespace.get(name)))
    return tuple(name for name in functions if not isinstance(namespace[name], type | classmethod | staticmethod))


def is_ours(model: type) -> bool:
    """Return whether a class is a built-in model, or any other class of this distribution."""
    return module_of(model).partition(".")[0] in OURS


def module_of(definition: Any) -> str:
    """Return the module of a function or class; "" if it is no text, as for some classes of extensions in C."""
    module = definition.__module__
    return module if isinstance(module, str) else ""


@lru_cache(maxsize=1024)
def positions(model: type, name: str) -> tuple[int, ...]:
    """Return the positions, in the method resolution order of a class, of the classes that define an attribute.

    A method that only raises NotImplementedError does not count.
    """
    return tuple(k for k, base in enumerate(model.__mro__) if name in annotated(base) or _defines(base, name))


def _defines(base: type, name: str) -> bool:
    attribute = vars(base).get(name)
    code = getattr(getattr(attribute, "fget", attribute), "__code__", None)
    return name in vars(base) and not (code is not None and "NotImplementedError" in code.co_names)


def overrides(model: type, method: str, position: int) -> bool:
    """Return whether a class before `position` in the method resolution order overrides a method of a class after it.

    The class at the position counts as after it: an attribute that it defines follows from the overridden method.
    """
    method_positions = positions(model, method)
    return bool(method_positions) and method_positions[0] < position <= method_positions[-1]


def inherits(value: Any, base: type[Model], method: str = "__call__") -> TypeGuard[Model]:
    """Return whether a value is an instance of a class and does not override a method of it."""
    return isinstance(value, base) and getattr(type(value), method) is getattr(base, method)


def attributes(value: Any, names: Iterable[str]) -> dict[str, Any]:
    """Return the values of the named attributes by name; attributes that the object lacks are left out."""
    if isinstance(value, BaseModel):  # `hasattr` is slow for an attribute that a model lacks
        defined = _names_in(value.__class__)
        names = [name for name in names if name in defined or name in value.__dict__]
    return {name: getattr(value, name) for name in names if hasattr(value, name)}


@lru_cache(maxsize=256)
def _names_in(model: type) -> frozenset[str]:
    """Return the names of the attributes of a class."""
    return frozenset(dir(model))


def name_of(value: Any) -> str:
    """Return the name of a function, or of the class of an object."""
    return str(value.__name__ if isinstance(value, FunctionType) else type(value).__name__)


def kind_of(model: Any) -> str:
    """Return the kind of a model, or its name if it has no kind."""
    return Traits.of(model).kind or name_of(model)


def _misspelt(traits: tuple[str, ...], names: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield (attribute, trait) for each name of an attribute that is one letter off a trait.

    Private attributes are ignored, and so are traits that are among the names or shorter than `SHORTEST`.
    """
    for trait in traits:
        if len(trait) >= SHORTEST and trait not in names:
            yield from ((name, trait) for name in names if name[0] != "_" and is_one_letter_off(name, trait))


@lru_cache(maxsize=256)
def _misspelt_in(traits: tuple[str, ...], model: type) -> tuple[tuple[str, str], ...]:
    """Return the pairs that `_misspelt` yields for a class and each of its base classes."""
    return tuple(
        pair for base in model.__mro__ for pair in _misspelt(traits, dict.fromkeys([*annotated(base), *vars(base)]))
    )


def is_one_letter_off(word: str, other: str) -> bool:
    """Return whether two words differ by one inserted, deleted or replaced letter, or by two adjacent ones swapped."""
    common = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(word, other, strict=False)))
    shorter, longer = sorted((word[common:], other[common:]), key=len)
    if len(shorter) < len(longer):
        return shorter == longer[1:]
    is_replaced = shorter[1:] == longer[1:]
    are_swapped = shorter[1::-1] == longer[:2] and shorter[2:] == longer[2:]
    return bool(longer) and (is_replaced or are_swapped)
