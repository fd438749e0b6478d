"""Values: what their types take and refuse, what is frozen, and how one of several models is chosen."""

import json
import pickle
import re
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import EntryPoint, EntryPoints
from math import inf, nan
from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, Field, PydanticUserError, TypeAdapter

import protocols
from desim import Lognormal, Scenario, Team, run
from desim.config import named_code
from desim.config.choice import OneOf, kind_of
from desim.config.errors import KeyedError
from desim.config.field_docs import fields_of
from desim.config.field_types import NotEmpty
from desim.config.json_numbers import to_json
from desim.config.model import (
    Box,
    Coordinate,
    Extent,
    Flag,
    Horizon,
    Length,
    Period,
    Positive,
    Probability,
    Rate,
    Speed,
    Time,
    Value,
)
from desim.config.model_parts import markers_of
from tests.models import MODELS, NEEDED, made


def test_a_box_is_a_lower_and_an_upper_bound_which_may_be_the_same():
    box = TypeAdapter(Box)
    assert box.validate_python((-1.0, 2.0)) == (-1.0, 2.0)
    assert box.validate_python((2.0, 2.0)) == (2.0, 2.0)
    with pytest.raises(ValueError, match=r"should be \[lower, upper\] \(got 2 and 1\.5\)"):
        box.validate_python((2.0, 1.5))


@pytest.mark.parametrize(
    ("number", "written"), [(1.5, 1.5), (inf, "Infinity"), (-inf, "-Infinity"), (nan, "NaN"), (0.0, 0.0)]
)
def test_a_number_is_written_such_that_it_is_read_again(number, written):
    assert to_json(number) == written
    assert float(to_json(number)) == pytest.approx(number, nan_ok=True)


class Circle(Value):
    """Round."""

    kind: Literal["circle"] = "circle"
    radius: Positive = 1.0
    """Radius, m."""


class Square(Value):
    """Has four corners.

    And four sides.
    """

    kind: Literal["square"] = "square"
    side: Speed = 2.0
    """Length of a side, m."""


class Drawing(Value):
    """A shape on paper."""

    kind: Literal["drawing"] = "drawing"
    shape: Annotated[Any, OneOf(Circle, Square)] = Circle()
    """What is drawn."""
    reach: Extent = inf
    """How far it is seen, m."""


NO_NUMBERS = ["1", True, None, [1.0], {}, "nan", 1j]
NO_TIMES = [inf, -inf, nan, *NO_NUMBERS]


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (Positive, [1, 0.5, 1e-300], [0, 0.0, -0.0, -1, inf, -inf, nan, *NO_NUMBERS]),
        (Coordinate, [-3, 0, 1e9], [-1.1e9, 1.1e9, *NO_TIMES]),
        (Length, [1e-300, 1e9], [0.0, -1, 1.1e9, *NO_TIMES]),
        (Speed, [0, 0.0, -0.0, 1e9], [-1e-300, 1.1e9, *NO_TIMES]),
        (Time, [0, 1e-12, 1e9], [-1e-12, 1.1e9, *NO_TIMES]),
        (Horizon, [1e-12, 1e9], [0, -1, 1.1e9, *NO_TIMES]),
        (Period, [1e-6, 1e9], [0, 0.9e-6, 1.1e9, *NO_TIMES]),
        (Rate, [1e-9, 1e6], [0, 0.9e-9, 1.1e6, *NO_TIMES]),
        (Probability, [0, 1, 0.5], [-1e-300, 1.0000001, inf, nan, *NO_NUMBERS]),
        (Extent, [1e-300, 3, inf], [0, -1, -inf, nan, *NO_NUMBERS]),
        (Flag, [True, False], [0, 1, 1.0, "true", "yes", None]),
    ],
    ids=[
        "Positive",
        "Coordinate",
        "Length",
        "Speed",
        "Time",
        "Horizon",
        "Period",
        "Rate",
        "Probability",
        "Extent",
        "Flag",
    ],
)
def test_a_type_takes_its_range_and_nothing_that_only_looks_like_it(kind, good, bad):
    adapter = TypeAdapter(kind)
    assert [adapter.validate_python(each) for each in good] == good
    for each in bad:
        with pytest.raises(ValueError):
            adapter.validate_python(each)


RANGES = [model for model in MODELS if {"low", "high"} <= model.model_fields.keys()]


@pytest.mark.parametrize("model", RANGES, ids=lambda model: model.__name__)
def test_a_lower_bound_may_be_the_upper_one_and_no_more(model):
    assert made(model, {"low": 2.0, "high": 2.0}) == model(low=2.0, high=2.0)
    with pytest.raises(ValueError, match="low should be at most high"):
        made(model, {"low": 2.5, "high": 2.0})


OTHER_TYPES = {bool: ("true",), int: (1.0, "1", True), float: ("1", True)}
"""Values that pydantic takes by default for a field of another type, by the type of the field."""


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_a_number_or_a_flag_of_another_type_is_refused(model):
    for name, value in made(model):
        for other in OTHER_TYPES.get(type(value), ()):
            with pytest.raises(KeyedError, match=name):
                made(model, {name: other})


def test_a_value_is_frozen():
    circle = Circle()
    with pytest.raises(ValueError, match="immutable"):
        circle.radius = 2.0
    assert circle == Circle()


def test_equal_values_are_one_in_a_set():
    assert len({Circle(radius=2), Circle(radius=2.0), Circle()}) == 2


def test_an_unknown_key_of_a_value_is_an_error():
    with pytest.raises(KeyedError, match="radios"):
        Circle(radios=2.0)


def test_the_string_below_a_field_describes_it():
    assert fields_of(Circle)["radius"].description == "Radius, m."


def test_plain_is_what_strict_json_has():
    plain = Drawing(shape=Square()).plain()
    assert plain == {"kind": "drawing", "shape": {"kind": "square", "side": 2.0}, "reach": "Infinity"}
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain


@dataclass
class Blob:
    area: float
    edges: int = field(init=False, default=0)

    def __call__(self):
        return self.area


def test_a_user_dataclass_is_written_with_its_fields_and_read_back():
    plain = Drawing(shape=Blob(area=2.0)).plain()["shape"]
    assert plain == {"kind": f"{__name__}:Blob", "area": 2.0}
    assert Drawing(shape=plain).shape == Blob(area=2.0)


def test_kind_of_a_model_is_its_default():
    assert (kind_of(Circle), kind_of(Square)) == ("circle", "square")


@pytest.mark.parametrize(
    ("given", "expected"),
    [({"kind": "square", "side": 3}, Square(side=3.0)), ({"kind": "circle"}, Circle()), (Square(), Square())],
)
def test_a_table_is_discriminated_by_its_kind(given, expected):
    assert Drawing(shape=given).shape == expected


def test_a_bare_string_is_a_kind_and_a_bare_number_that_of_which_it_is_the_one_key():
    adapter = TypeAdapter(Annotated[Any, OneOf(Circle, Square, number=("square", "side"))])
    assert adapter.validate_python("circle") == Circle()
    assert adapter.validate_python(3) == adapter.validate_python(3.0) == Square(side=3.0)
    for wrong in (True, -3.0, "triangle"):
        with pytest.raises(ValueError):
            adapter.validate_python(wrong)


@pytest.mark.parametrize("given", [{"kind": "triangle"}, {"kind": "square", "radius": 1.0}, "triangle", 3, None])
def test_a_value_that_is_neither_a_table_with_a_kind_nor_callable_is_refused(given):
    with pytest.raises(KeyedError):
        Drawing(shape=given)


@pytest.mark.parametrize("given", [abs, lambda: 1.0], ids=["function", "lambda"])
def test_a_callable_is_accepted_unchanged(given):
    assert Drawing(shape=given).shape is given


def test_a_class_is_refused_where_its_instance_is_wanted():
    with pytest.raises(KeyedError, match=r"should be an instance: Circle\(\) instead of Circle"):
        Drawing(shape=Circle)


def test_the_protocols_of_other_distributions_are_choices_too(monkeypatch):
    class Point:
        """An entry point that another distribution installs."""

        name, value = "square", "shapes:Square"

        def load(self) -> type[BaseModel]:
            return Square

    groups = []
    monkeypatch.setattr(named_code, "entry_points", lambda *, group: groups.append(group) or [Point()])
    shapes = OneOf(Circle, group="shapes")
    assert list(shapes.choices().items()) == [("circle", Circle), ("square", Square)]
    adapter = TypeAdapter(Annotated[Any, shapes])
    assert adapter.validate_python({"kind": "square"}) == Square()
    assert set(groups) == {"shapes"}


def test_what_the_table_of_the_repository_names_needs_no_installation(monkeypatch):
    """It comes before an entry point of the same kind, such as one of an older installation."""
    stale = EntryPoint("round", "protocols.gone:Circle", "desim.shapes")
    mine = {"desim.shapes": {"round": f"{__name__}:Circle", "square": f"{__name__}:Square"}}
    monkeypatch.setattr(protocols, "KINDS", mine)
    monkeypatch.setattr(named_code, "entry_points", lambda group=None: EntryPoints([stale] if group else []))
    assert OneOf(group="desim.shapes").choices() == {"round": Circle, "square": Square}
    named_code._named_by_entry_points.cache_clear()
    try:
        assert not named_code.is_unlisted_import(f"{__name__}:Circle")
        assert named_code.is_unlisted_import(f"{__name__}:Drawing")
    finally:
        named_code._named_by_entry_points.cache_clear()


@pytest.mark.parametrize("listed", ["protocols.gone:Circle", f"{__name__}:Gone"])
def test_a_listed_object_that_cannot_be_imported_is_refused_as_any_other(monkeypatch, tmp_path, listed):
    """Its module or its name is gone, as after an upgrade; the folder of the file is not searched for it."""
    monkeypatch.setattr(protocols, "KINDS", {"desim.shapes": {"round": listed}})
    named_code._named_by_entry_points.cache_clear()
    try:
        with pytest.raises(ValueError, match=f"{re.escape(repr(listed))} cannot be imported: .*one") as caught:
            TypeAdapter(Annotated[Any, OneOf(Circle)]).validate_python({"kind": listed}, context={"folder": tmp_path})
        assert "also searched" not in str(caught.value)
    finally:
        named_code._named_by_entry_points.cache_clear()


def test_only_the_models_named_in_a_table_are_loaded(monkeypatch):
    class Point:
        """An entry point that another distribution installs."""

        def __init__(self, name: str, model: type[BaseModel]):
            self.name, self.value, self.model = name, f"shapes:{name}", model

        def load(self) -> type[BaseModel]:
            loaded.append(self.name)
            return self.model

    loaded: list[str] = []
    points = [Point("square", Square), Point("drawing", Drawing)]
    monkeypatch.setattr(named_code, "entry_points", lambda **_: points)
    shapes = OneOf(Circle, group="shapes")
    adapter = TypeAdapter(Annotated[Any, shapes])
    assert adapter.validate_python({"kind": "circle"}) == Circle()
    assert adapter.dump_python(Circle()) == {"kind": "circle", "radius": 1.0}
    assert not loaded
    assert adapter.validate_python({"kind": "square"}) == Square()
    assert adapter.dump_json(Square()) == b'{"kind":"square","side":2.0}'
    assert set(loaded) == {"square"}
    with pytest.raises(ValueError, match="expected tags: 'circle', 'drawing', 'square'"):
        adapter.validate_python({"kind": "cube"})


def test_a_model_is_not_built_before_it_is_used():
    class Oval(Value):
        """Not quite round."""

        kind: Literal["oval"] = "oval"
        width: Positive = 1.0

    adapter = TypeAdapter(Annotated[Any, OneOf(Circle, Oval)])
    adapter.validate_python({"kind": "circle"})
    assert not Oval.__pydantic_complete__
    assert adapter.validate_python({"kind": "oval", "width": 2.0}) == Oval(width=2.0)
    with pytest.raises(ValueError, match=r"\nwidth\n  Input should be greater than 0"):
        adapter.validate_python({"kind": "oval", "width": 0.0})


def test_the_schema_lists_the_kinds_of_a_choice():
    found = TypeAdapter(Annotated[Any, OneOf(Circle, Square, number=("square", "side"))]).json_schema()
    tables, *bare = found["anyOf"]
    own = {"type": "string", "pattern": "^[^:]+:[^:]+$"}
    own_table = {"type": "object", "properties": {"kind": own}, "required": ["kind"]}
    assert bare == [{"type": "string", "enum": ["circle", "square"]}, own, own_table, {"type": "number"}]
    assert tables["discriminator"]["mapping"] == {"circle": "#/$defs/Circle", "square": "#/$defs/Square"}
    assert found["$defs"]["Square"]["properties"]["side"]["description"] == "Length of a side, m."
    assert "description" not in found["$defs"]["Square"]["properties"]["kind"]


class Ring(Circle):
    """A circle with a hole."""

    radius: Positive = 3.0
    hole: Annotated[Positive, Field(description="As it says itself.")] = 0.5
    """Not so."""

    class Bead(Value):
        """What it is strung on."""

        size: Positive = 0.1
        """Across,
        m."""


def test_a_field_is_described_by_the_string_below_it_where_it_was_last_declared():
    assert {name: field.description for name, field in fields_of(Ring).items()} == {
        "kind": None,
        "radius": None,
        "hole": "As it says itself.",
    }
    assert fields_of(Ring.Bead)["size"].description == "Across,\nm."


def test_a_model_without_source_has_no_descriptions():
    namespace = {"Value": Value, "__name__": "nowhere"}
    exec('class Blot(Value):\n    size: float = 1.0\n    """Across, m."""', namespace)
    assert fields_of(namespace["Blot"])["size"].description is None


def test_without_a_group_nothing_is_looked_up(monkeypatch):
    monkeypatch.setattr(named_code, "entry_points", lambda **_: pytest.fail("looked up"))
    assert OneOf(Circle, Square).choices() == {"circle": Circle, "square": Square}


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"protocol": {"kind": "sap", "tau": {"kind": "protocols.schedules.periodic:Poisson"}}}, "call with (eta)"),
        (
            {"protocol": {"kind": "sap", "schedule": {"kind": "protocols.schedules.periodic:owned_slots"}}},
            "should have mean_slot",
        ),
        ({"protocol": {"kind": "desim.pursuit.core.geometry:moved_towards"}}, "call with (me)"),
        (
            {"team": {"guidance": {"kind": "desim.pursuit.core.geometry:moved_towards"}}},
            "call with (gaps, aims, evader_velocity, speeds)",
        ),
        ({"evader": {"strategy": {"kind": "desim.pursuit.core.geometry:toward"}}}, None),
        ({"evader": {"strategy": {"kind": "desim.pursuit.core.geometry:first_contact"}}}, "call with (state, rng)"),
    ],
)
def test_a_part_that_cannot_be_called_as_it_will_be_is_refused(table, says):
    """`toward` takes two arguments, too: what it makes of them is its own affair."""
    if says is None:
        Scenario.model_validate(table)
    else:
        with pytest.raises(ValueError, match=re.escape(says)):
            Scenario.model_validate(table)


@pytest.mark.parametrize(
    "accessor",
    [property(lambda _: 3.0), cached_property(lambda _: 3.0), lambda _: 3.0, staticmethod(lambda: 3.0)],
    ids=type,
)
def test_a_property_or_method_in_the_place_of_a_key_is_refused_with_what_to_write(accessor):
    """pydantic would take it for the default of the key."""
    told = r"Theirs.mean is a (property|cached_property|function) in the place of a key: give the key another default"
    with pytest.raises(PydanticUserError, match=told):
        type(Lognormal)("Theirs", (Lognormal,), {"__module__": "theirs", "mean": accessor})

    class Named(Lognormal):
        mean: float = 3.0

    assert Named().mean_latency() == Lognormal(mean=3.0).mean_latency()


def test_a_box_of_no_size_at_zero_has_no_sign():
    """numpy refuses to draw between 0 and -0."""
    assert run(Scenario(horizon=0.01, team=Team(count=2, box=(0.0, -0.0)))).trace


@pytest.mark.parametrize(("model", "key"), [(Team, "count"), (Lognormal, "mean"), (Scenario, "horizon")])
def test_the_default_of_a_key_is_not_set_on_a_class(model, key):
    """pydantic has taken it into its schema, so that it would have no effect."""
    with pytest.raises(KeyedError, match=rf"{key}: the default of a key cannot be set: .* {model.__name__}\({key}="):
        setattr(model, key, 7)


def test_a_value_with_a_private_attribute_is_pickled():
    scenario = Scenario()
    scenario._note = "mine"
    assert pickle.loads(pickle.dumps(scenario)) == scenario


class Road(Value):
    """Has lanes."""

    surface: Literal["road"] = "road"
    lanes: int = 2
    """Number of lanes."""


class Track(Value):
    """Has rails."""

    surface: Literal["track"] = "track"


class Way(Value):
    """A user's model, with a union that pydantic tells apart by a key."""

    part: Annotated[Road | Track, Field(discriminator="surface")] = Road()
    """What it is made of."""


NO_PARTS = [
    (3, "part: should be a table; What it is made of (got 3)"),
    (None, "part: should be a table; What it is made of (got None)"),
    ([1], "part: should be a table; What it is made of (got [1])"),
    ({}, "part: should be a table with the key surface; What it is made of (got {})"),
    ({"surface": "sea"}, "part.surface: there is no 'sea'; allowed: road, track"),
]
"""Values that are no part of a way, and what is said."""


@pytest.mark.parametrize(("value", "told"), NO_PARTS, ids=str)
def test_the_union_of_a_users_model_is_refused_in_the_words_of_others(value, told):
    assert Way(part={"surface": "track"}).part == Track()
    with pytest.raises(KeyedError, match=f"^Way: {re.escape(told)}$"):
        Way(part=value)


class Plain(Value):
    """Models of a user with unions in all forms, which pydantic tells apart by trying each, or by a key."""

    tried: Road | Track = Road()
    chosen: Annotated[Road | Track, Field(discriminator="surface")] | None = None
    several: tuple[Annotated[Road | Track, Field(discriminator="surface")], ...] = ()
    tried_each: list[Road | Track] = Field(default_factory=list)
    named: Road | float = 1.0


ROAD = {"surface": "road", "lanes": 2}


@pytest.mark.parametrize(
    ("key", "inner"), [("tried", ""), ("chosen", ""), ("several", ".0"), ("tried_each", ".0"), ("named", "")]
)
def test_no_tag_of_a_union_is_in_a_place_and_only_the_member_in_question_is_judged(key, inner):
    def told(table):
        with pytest.raises(KeyedError) as refused:
            Plain(**{key: [table] if inner else table})
        return [line for line in str(refused.value).removeprefix("Plain: ").split("\nPlain: ") if "got {" not in line]

    place = f"{key}{inner}"
    assert told(ROAD | {"lane": 1}) == [f"{place}.lane: unknown key, did you mean 'lanes'?; allowed: lanes, surface"]
    assert told(ROAD | {"lanes": "x"})[0].startswith(f"{place}.lanes: should be an integer")
    assert len(told(ROAD | {"lanes": "x"})) == 1


def test_the_types_of_a_union_are_no_keys():
    class Mixed(Value):
        x: float | list[int] = 1.0

    with pytest.raises(KeyedError, match=r"^Mixed: x: should be a number.*\nMixed: x\.1: should be an integer"):
        Mixed(x=[1, "w"])


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_what_was_given_is_a_table_of_keys_of_the_model(model):
    given = made(model).given()
    assert given.keys() <= model.model_fields.keys()
    assert {name for name in NEEDED.get(model.__name__, ()) if name not in {"file", "nodes"}} <= given.keys()


LISTS = [
    (model, name)
    for model in MODELS
    for name, field in model.model_fields.items()
    if any(isinstance(marker, NotEmpty) for marker in markers_of(field))
]


@pytest.mark.parametrize(("model", "name"), LISTS, ids=lambda each: getattr(each, "__name__", each))
def test_a_list_without_items_is_refused_in_these_words(model, name):
    needed = {key: value for key, value in NEEDED.get(model.__name__, {}).items() if key != name}
    with pytest.raises(KeyedError, match=rf"{name}: should have at least 1 item, has none($|;)"):
        model(**needed | {name: []})
    assert len(LISTS) > 5
