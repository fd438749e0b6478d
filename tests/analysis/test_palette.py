"""The colours and marks of lines can be told apart, pairwise, on light and dark pages, also by colour-blind readers."""

from itertools import combinations
from math import dist

import pytest

from desim.analysis.drawing.palette import MARKERS, ON_DARK, SERIES

DICHROMATS = {
    "trichromat": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "protanope": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranope": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}
"""What such a reader sees, in linear RGB (Machado, Oliveira & Fernandes 2009, severity 1)."""
LEAST = {"trichromat": 0.12, "protanope": 0.07, "deuteranope": 0.07}
"""The least distance in OKLab. Colour-blind readers have the marks, too."""
PAGES = {"light": (SERIES, "#ffffff"), "dark": (tuple(ON_DARK.get(colour, colour) for colour in SERIES), "#181c20")}


def linear(colour):
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]


def times(matrix, vector):
    return [sum(a * b for a, b in zip(row, vector, strict=True)) for row in matrix]


def oklab(colour):
    """Return a linear colour in OKLab (Ottosson 2020), in which equal distances look equally large."""
    cones = times(
        [
            [0.4122214708, 0.5363325363, 0.0514459929],
            [0.2119034982, 0.6806995451, 0.1073969566],
            [0.0883024619, 0.2817188376, 0.6299787005],
        ],
        colour,
    )
    return times(
        [
            [0.2104542553, 0.7936177850, -0.0040720468],
            [1.9779984951, -2.4285922050, 0.4505937099],
            [0.0259040371, 0.7827717662, -0.8086757660],
        ],
        [max(cone, 0.0) ** (1 / 3) for cone in cones],
    )


def apart(one, other, reader="trichromat"):
    return dist(*(oklab(times(DICHROMATS[reader], linear(colour))) for colour in (one, other)))


def contrast(one, other):
    """Return the contrast of two colours (WCAG 2.2)."""
    low, high = sorted(
        sum(a * b for a, b in zip((0.2126, 0.7152, 0.0722), linear(each), strict=True)) for each in (one, other)
    )
    return (high + 0.05) / (low + 0.05)


def test_the_distance_is_that_of_oklab():
    assert oklab(linear("#ffffff")) == pytest.approx([1.0, 0.0, 0.0], abs=1e-3)
    assert oklab(linear("#ff0000")) == pytest.approx([0.628, 0.225, 0.126], abs=1e-3)
    assert apart("#4aa8e0", "#56b4e9") < 0.05, "two blues of an earlier dark page"


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("reader", DICHROMATS)
def test_all_pairs_of_colours_differ(page, reader):
    for one, other in combinations(PAGES[page][0], 2):
        assert apart(one, other, reader) >= LEAST[reader], (one, other)


def test_all_pairs_of_lines_differ_in_colour_or_mark_and_few_lines_in_both():
    lines = [(SERIES[k % len(SERIES)], MARKERS[k % len(MARKERS)]) for k in range(len(SERIES) * len(MARKERS))]
    assert len(set(lines)) == len(lines) == 42
    for few in (lines[k : k + len(SERIES)] for k in range(len(lines))):
        for (colour, marker), (other_colour, other_marker) in combinations(few, 2):
            assert (colour != other_colour, marker != other_marker) == (True, True)


@pytest.mark.parametrize("page", PAGES)
def test_lines_can_be_seen_on_their_page(page):
    colours, paper = PAGES[page]
    assert min(contrast(colour, paper) for colour in colours) >= {"light": 2.0, "dark": 4.0}[page]
