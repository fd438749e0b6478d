"""Models as text: `desim keys` and `desim protocols`."""

from math import inf
from typing import Annotated, Any, Literal

from desim.cli.description import described
from desim.config.choice import OneOf
from desim.config.model import Extent, Positive, Value


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
    side: Positive
    """Length of a side,
    m."""


SHAPES = OneOf(Circle, Square)


class Frame(Value):
    """Around a drawing."""

    width: Positive = 0.1
    """Width, m."""


class Drawing(Value):
    """Shapes on paper."""

    shape: Annotated[Any, SHAPES] = Circle()
    """What is drawn."""
    behind: Annotated[Any, SHAPES] = None
    """What is behind it."""
    frame: Frame = Frame()
    """What is around it."""
    reach: Extent = inf
    """How far it is seen, m."""


def test_a_model_is_described_with_its_parameters_and_once_with_what_they_may_hold():
    assert list(described(Drawing, "drawing")) == [
        "drawing: Shapes on paper.",
        "    shape = { kind = 'circle' }: What is drawn.",
        "        circle: Round.",
        "            radius = 1.0: Radius, m.",
        "        square: Has four corners.",
        "            side: Length of a side, m.",
        "    behind = None: What is behind it.",
        "        circle, square: as above",
        "    frame: What is around it.",
        "        width = 0.1: Width, m.",
        "    reach = inf: How far it is seen, m.",
    ]


def test_a_model_described_before_is_only_named():
    known = set()
    assert len(list(described(Frame, "frame", described_models=known))) == 2
    assert list(described(Frame, "frame", described_models=known)) == ["frame: Around a drawing."]
