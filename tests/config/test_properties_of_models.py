"""The properties of each kind of model that are plain values, and the traits of objects that say nothing."""

from contextlib import suppress
from functools import cached_property
from typing import Any, get_type_hints

import pytest

from desim.config.field_docs import fields_of
from desim.config.traits import Traits
from tests.golden import golden
from tests.models import MODELS, classes, made

PLAIN = {bool, int, float, str, bool | None, int | None, float | None, str | None}
ALSO = {float: float | int, float | None: float | int | None}
"""A whole number is a float, too."""


def properties(model):
    """Yield the names and the types of the properties of a class that return a plain value."""
    for name in dir(model):
        member = next(vars(base)[name] for base in model.__mro__ if name in vars(base))
        if isinstance(member, property | cached_property):
            get = member.fget if isinstance(member, property) else member.func
            if get.__module__.startswith(("desim", "protocols")):
                returned: Any = get_type_hints(get)["return"]
                if returned in PLAIN:
                    yield name, returned


def test_plain_properties_of_each_kind_have_their_type_and_are_golden():
    lines = []
    for model in MODELS:
        for name, returned in properties(model):
            with suppress(NotImplementedError, AttributeError):  # of a base, which has no such value
                value = getattr(made(model), name)
                assert isinstance(value, ALSO.get(returned, returned)), (model, name)
                lines.append(f"{model.__name__}.{name} = {value!r}\n")
    golden("properties.txt", "".join(lines))


def test_what_the_traits_of_an_object_are_that_has_none_is_golden():
    """A user's model without an attribute is what the default of the trait says."""
    families = sorted(classes(Traits), key=lambda family: family.__name__)
    lines = [
        f"{family.__name__}.{name} = {field.default!r}\n"
        for family in families
        for name, field in fields_of(family).items()
        if name in family.__annotations__
    ]
    golden("traits.txt", "".join(lines))


@pytest.mark.parametrize("family", [*classes(Traits)], ids=lambda family: family.__name__)
def test_the_default_of_a_trait_is_one_that_an_object_may_have(family):
    values = {name: field.default for name, field in fields_of(family).items()}
    assert dict(family.model_validate(values)) == dict(family())
