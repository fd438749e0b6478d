"""The coverage of sequential studies, as the tables in `desim.analysis.statistics` and on the page on validation."""

from math import sqrt

import pytest

from desim.analysis.looks import FIRST_LOOK
from scenarios.coverage import table
from scenarios.studies.coverage_runs import LAWS, coverage

STUDIES = 500
PUBLISHED = {
    ("normal", 30): (0.951, 0.011),
    ("normal", 300): (0.953, 0.001),
    ("exponential", 30): (0.940, -0.001),
    ("exponential", 300): (0.935, -0.064),
    ("lognormal, sigma = 1", 30): (0.910, 0.006),
    ("lognormal, sigma = 1", 300): (0.898, -0.165),
    ("true with probability 0.1", 30): (0.942, -0.002),
    ("true with probability 0.1", 300): (0.950, -0.102),
}
"""Coverage and bias by distribution and size, with the first look that is the default."""


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(("law", "size"), PUBLISHED)
def test_intervals_cover_as_often_as_the_table_says(law, size):
    """Within 4 s.e. of the share, at most 0.055, and of the mean, whose deviation is about half a target."""
    covered, bias = PUBLISHED[law, size]
    found = coverage(LAWS[law], size, FIRST_LOOK, STUDIES)
    assert abs(found.share - covered) < 4.0 * sqrt(covered * (1.0 - covered) / STUDIES)
    assert abs(found.bias - bias) < 4.0 * 0.6 / sqrt(STUDIES)


@pytest.mark.slow
def test_a_first_look_at_three_values_covers_too_rarely():
    """The control: 80 % of exponential values, and a mean that is too low by a third of a half width."""
    found = coverage(LAWS["exponential"], 30, 3, 300)
    assert found.share < 0.943 - 4.0 * sqrt(0.06 / 300)
    assert found.bias < -0.2


def test_the_table_has_a_row_for_each_distribution_target_and_first_look():
    rows = table(2).splitlines()
    assert len(rows) == 1 + len(LAWS) * 2 * 3
    assert rows[0].split() == ["distribution", "target", "of", "first", "look", "covered,", "%", "bias", "values"]
