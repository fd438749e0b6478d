"""Traits: the optional attributes of models, and how a misspelt one is told."""

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from importlib import import_module
from math import nan
from string import ascii_lowercase
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from desim.config.choice import OneOf
from desim.config.model import Flag, Probability, Value
from desim.config.traits import Parameter, Traits, is_one_letter_off, is_ours
from desim.pursuit.core.traits import DisseminationTraits, ProtocolTraits
from desim.pursuit.evaders.recorded import RelayTraits
from desim.pursuit.motion.flow import FlowTraits


class Singing(Traits):
    """The optional attributes of a bird."""

    melodic: Flag = False
    """Whether it sings."""
    volume: Literal["low", "high"] = "low"
    """Loudness of its song."""
    answer: Callable[[str], str] | None = None
    """`answer(song)` returns its answer."""
    wingspan: Annotated[float | None, Parameter(float)] = None
    """m"""
    nest: Flag = False
    """Whether it has one; other words are a letter away."""


def test_what_is_missing_has_its_default():
    def crow():
        return "caw"

    assert Singing.of(crow) == Singing.of(None) == Singing()


def test_attributes_of_any_kind_count_own_or_inherited():
    class Bird:
        melodic = True

    class Lark(Bird):
        @property
        def volume(self):
            return "high"

        def answer(self, song):
            return song[::-1]

    def lark():
        pass

    lark.melodic = True
    found = Singing.of(Lark())
    assert (found.melodic, found.volume, found.answer("abc")) == (True, "high", "cba")
    assert Singing.of(lark).melodic


def test_attributes_of_models_and_dataclasses_count():
    class Model(Value):
        volume: str = "high"
        melodic: ClassVar[bool] = True

    @dataclass
    class Data:
        wingspan: float

    assert (Singing.of(Model()).volume, Singing.of(Model()).melodic) == ("high", True)
    assert Singing.of(Data(0.5)).wingspan == 0.5


@pytest.mark.parametrize("number", [np.float32(0.5), np.array(0.5), Fraction(1, 2), Decimal("0.5")])
def test_a_parameter_may_be_a_number_of_any_kind(number):
    class Bird:
        wingspan = number

    assert Singing.of(Bird()).wingspan == 0.5


def test_a_parameter_of_another_type_has_no_effect():
    class Bird:
        wingspan = "wide"

    Singing.check(Bird())
    assert Singing.of(Bird()).wingspan is None


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("melodic", "yes", r"melodic of Bird: should be true or false \(got 'yes'\)"),
        ("volume", "loud", r"volume of Bird: should be 'low' or 'high' \(got 'loud'\)"),
        ("answer", 3, r"answer of Bird: should be callable \(got 3\)"),
    ],
)
def test_a_value_that_a_trait_cannot_have_is_refused(name, value, says):
    with pytest.raises(ValueError, match=says):
        Singing.check(type("Bird", (), {name: value})())


def misspellings(word):
    """Return all words one letter off."""
    places = range(len(word))
    return {
        *(word[:k] + word[k + 1 :] for k in places),
        *(word[:k] + word[k + 1] + word[k] + word[k + 2 :] for k in places[:-1]),
        *(word[:k] + letter + word[k + 1 :] for k in places for letter in ascii_lowercase),
        *(word[:k] + letter + word[k:] for k in range(len(word) + 1) for letter in ascii_lowercase),
    } - {word}


@pytest.mark.slow
def test_each_word_one_letter_off_is_told_with_the_word_that_was_meant():
    for name in sorted(misspellings("melodic")):
        for bird in (type("Bird", (), {name: True})(), made_function(name)):
            with pytest.raises(ValueError, match=f"has an attribute '{name}', did you mean 'melodic'\\?"):
                Singing.check(bird)


def made_function(name):
    def bird():
        pass

    setattr(bird, name, True)
    return bird


@pytest.mark.slow
@given(st.text("abc", max_size=6), st.text("abc", max_size=6))
def test_one_letter_off_is_one_letter_off(word, other):
    near = other in {each for each in misspellings(word) if not set(each) - set("abc")}
    assert is_one_letter_off(word, other) == near


@pytest.mark.parametrize("home", ["a base class", "a field", "a dataclass", "a function"])
def test_a_misspelt_attribute_is_found_wherever_it_is(home):
    class Base:
        meldoic = True

    class Model(Value):
        meldoic: bool = True

    @dataclass
    class Data:
        meldoic: bool

    birds = {
        "a base class": type("Lark", (Base,), {})(),
        "a field": Model(),
        "a dataclass": Data(True),
        "a function": made_function("meldoic"),
    }
    says = r"did you mean 'melodic'\? Attributes with an effect: depends_on, .* To keep 'meldoic', set melodic = False "
    with pytest.raises(ValueError, match=says):
        Singing.check(birds[home])


UNRELATED = {
    "another word": {"colour": "red", "feathers": True, "age": 3, "rest": True, "melody": True, "melodies": True},
    "a short word": {"nests": True, "next": True, "best": True, "neat": True},
    "of another type": {"volumes": 3, "answers": ["one"], "melodic_": 0.5, "volumn": "loud"},
    "private": {"_melodic": True, "_answer": len},
    "besides the right one": {"melodic": True, "melodics": True},
    "like a parameter": {"wingspans": 1.0},
    "two letters off": {"meldoicc": True, "elodi": True, "volunes": "low"},
}


@pytest.mark.parametrize("names", UNRELATED.values(), ids=UNRELATED)
def test_there_is_no_false_alarm_about_other_attributes(names):
    Singing.check(type("Bird", (), dict(names))())


def test_what_an_object_remembers_is_no_attribute_of_its_class():
    class Bird:
        def __init__(self):
            self.melodica = True

    Singing.check(Bird())


def test_the_model_of_another_distribution_is_looked_at_too():
    class Finch(Value):
        kind: Literal["finch"] = "finch"
        melodik: ClassVar[bool] = True

    adapter = TypeAdapter(Annotated[Any, OneOf(Finch, traits=Singing)])
    with pytest.raises(ValueError, match="Finch has an attribute 'melodik', did you mean 'melodic'"):
        adapter.validate_python({"kind": "finch"})


def test_a_function_is_looked_at_each_time():
    def bird():
        pass

    Singing.check(bird)
    bird.melodik = True
    with pytest.raises(ValueError, match="melodik"):
        Singing.check(bird)


def test_fields_of_other_types_may_be_declared_only():
    class Bird:
        melodie: Probability

    Singing.check(Bird())


def families(base: type[Traits] = Traits) -> list[type[Traits]]:
    """Return the classes of traits of desim and of the protocols."""
    return [kind for each in base.__subclasses__() for kind in (each, *families(each)) if is_ours(kind)]


def numbers() -> list[tuple[type[Traits], str]]:
    """Return the traits that are numbers: those that may be 1.0, and no boolean."""
    for module in ("desim.view.formats.export", "desim.pursuit.byzantine.lies", "desim.pursuit.motion.guidance"):
        import_module(module)
    assert len(families()) > 15
    return [
        (family, name)
        for family in families()
        for name, field in family.model_fields.items()
        if any(part in (int, float, complex) for part in types_in(field.annotation))
    ]


def types_in(annotation: Any) -> list[Any]:
    return [kind for part in get_args(annotation) for kind in types_in(part)] or [annotation]


@pytest.mark.parametrize(("family", "trait"), numbers(), ids=lambda value: getattr(value, "__name__", value))
@pytest.mark.parametrize("value", ["1.0", "1", True, np.True_, b"1", nan, -1.0], ids=repr)
def test_a_trait_that_is_a_number_is_no_text_no_boolean_and_not_nan(family, trait, value):
    owner = type("Own", (), {trait: value})()
    if trait == "start" and value == -1.0:  # a position
        return
    field = family.model_fields[trait]
    is_parameter = any(isinstance(marker, Parameter) for marker in field.metadata)
    if is_parameter and not (isinstance(value, float) and float in types_in(field.annotation)):  # of another program
        assert getattr(family.of(owner), trait) is None
        return
    with pytest.raises(ValueError, match=f"^{trait} of Own: should be "):
        family.of(owner)


def test_numbers_of_any_kind_are_traits():
    class Own:
        top_speed = np.float32(0.5)
        start = np.complex64(1 + 2j)
        slot = Fraction(1, 2)
        host = np.int64(1)
        hops = np.int8(3)

    assert RelayTraits.of(Own()).top_speed == FlowTraits.of(Own()).top_speed == ProtocolTraits.of(Own()).slot == 0.5
    assert RelayTraits.of(Own()).start == 1 + 2j
    assert (ProtocolTraits.of(Own()).host, DisseminationTraits.of(Own()).hops) == (1, 3)
