"""The check of the numbers on pages."""

import pytest

from scenarios.check_pages import CLAIMS, Claim, number, unchecked

PAIR = Claim("README.md", "7.5 +- 0.7 s, and 1,200 +- 12 s", ("scenarios.x",), (number("a", "n"), number("a", "n", 1)))


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.sentence[:40])
def test_a_claim_is_on_its_page_with_its_command_and_has_all_its_numbers(claim):
    assert claim.is_on_page()
    assert len(claim.numbers) == len(claim.published())


def test_no_claim_is_made_twice():
    assert len({(claim.page, claim.sentence) for claim in CLAIMS}) == len(CLAIMS)
    assert all(unchecked(claim.page) >= 0 for claim in CLAIMS)


@pytest.mark.parametrize(("mean", "is_true"), [(7.5, True), (6.02, True), (6.01, False), (9.1, False)])
def test_a_number_that_has_moved_by_more_than_the_margin_is_reported(mean, is_true):
    """The root of the sum of the squares of 0.7 and 0.7 is 0.99, of which 1.5 is 1.48."""
    claim = Claim("README.md", "takes 7.5 +- 0.7 s", ("scenarios.x",), (number("rows", "time", rule="a"),))
    rows = [{"rule": "a", "time": {"mean": mean, "half_width": 0.7}}, {"rule": "b", "time": {"mean": 0.0}}]
    assert [*claim.misfits({"rows": rows})] == (
        [] if is_true else [f"README.md: 7.5 +- 0.7, measured {mean:.3g} +- 0.7: takes 7.5 +- 0.7 s"]
    )


def test_a_sentence_that_is_not_on_its_page_is_noticed():
    assert PAIR.published() == [(7.5, 0.7), (1200.0, 12.0)]
    assert not PAIR.is_on_page()
