"""The check of the numbers on pages."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from scenarios import check_pages
from scenarios.check_pages import Remembering, compared
from scenarios.studies.claims import CLAIMS, COMMANDS, Claim, words_of
from scenarios.studies.study import SCENARIOS

ROOT = SCENARIOS.parent
NEEDS_MORE = {"docs/howto/learning_libraries.md": "its studies need torch, which desim does not install"}
"""Pages with numbers that `check_pages` cannot make, and why; each names its commands."""
RESULTS = {
    "What a rule learns": "docs/explanation/findings.md",
    "What version 1 shows": "docs/howto/bench.md",
    "What breaks them": "docs/howto/breaking.md",
}
"""Headings of sections in which each number with a decimal point or in percent needs a claim, and their pages."""
PAGES = ["README.md", *sorted({str(path.relative_to(ROOT)) for path in ROOT.glob("docs/*/*.md")} - NEEDS_MORE.keys())]
INTERVAL = re.compile(r"\d(?: %)? \+- [\d.]|\(\d+ to \d+\)|standard error of (?:[\d.]+ is )?\d|\d\.\d+\(\d+\)")
"""A number with its uncertainty, an interval in brackets, or a standard error in words or as last digits."""
BARE = re.compile(r"\d*\.\d+|\d+ %")
"""A number with a decimal point, or in percent."""
LINK = re.compile(r"\]\([^)]*\)|<a [^>]*>")
"""The address of a link, which may have a number."""
NOT_MEASURED = {
    "| 0 | 1.74(4) | 1.785(23) |": "of prototypes outside desim",
    "| 1 | 2.26(4) | 2.328(24) |": "of prototypes outside desim",
    "| 4 | 4.00(6) | 4.130(32) |": "of prototypes outside desim",
    "three hidden nodes deliver 0.3 % less if it does, with a standard error of 1.1 %": "of a simulation outside desim",
    "(the standard error of 0.95 is 0.013)": "the root of 0.95 x 0.05 / 300",
}
"""Texts with such numbers that are not measured by runs, and why they are on a page."""
SETTINGS = {
    "trained for ten generations at a latency of 0.1 s": "LATENCY of the study",
    "equally fast (2.5 m/s), a latency of 0.1 s and heartbeats each 0.1 s": "BASE of the study",
    "each 0.34 s and a latency of 0.1 s, lose their chaser at 0.6 s": "of the claim beside it",
    "with a loss of 0.2 and no crash": "of the claim beside it",
    "a random latency of 0.8 s in the mean": "of the claim beside it",
}
"""Texts with settings, and where these are set."""
OPTIONS = Remembering("check_pages", 4, 1, 2, Path("out"), as_json=False)


def unclaimed(page, claims):
    """Return the text around each number with an interval on a page that is in no claim."""
    return around(INTERVAL, without(words_of(page), [*texts_of(page, claims), *NOT_MEASURED]))


def bare(heading, claims):
    """Return the text around each number in a section with results that is in no claim and is no setting."""
    page = RESULTS[heading]
    (section,) = re.findall(rf"## {heading} (.*?)(?: ## |$)", words_of(page))
    text = without(section, [*texts_of(page, claims), *NOT_MEASURED, *SETTINGS])
    return around(BARE, LINK.sub("", text))


def texts_of(page, claims):
    """Return the texts of the claims on a page."""
    return [claim.text for claim in claims if claim.page == page]


def without(text, parts):
    """Return a text without some of its parts."""
    for part in parts:
        text = text.replace(part, " ")
    return text


def around(numbers, text):
    """Return the text around each match."""
    return [text[max(found.start() - 40, 0) : found.end() + 20] for found in numbers.finditer(text)]


@pytest.mark.parametrize("page", PAGES)
def test_each_number_with_an_interval_has_a_claim(page):
    assert unclaimed(page, CLAIMS) == []


@pytest.mark.parametrize("heading", RESULTS)
def test_each_number_in_a_section_with_results_has_a_claim(heading):
    assert bare(heading, CLAIMS) == []


@pytest.mark.parametrize("heading", RESULTS)
def test_a_number_without_a_claim_in_a_section_with_results_is_noticed(heading):
    assert bare(heading, [])


@pytest.mark.parametrize(
    "text",
    [
        "5.0 +- 0.2",
        "5 % +- 2 %",
        "69 % (58 to 79)",
        "5.8 s with a standard error of 0.4 s",
        "(the standard error of 0.95 is 0.013)",
        "1.74(4)",
    ],
)
def test_a_number_with_its_uncertainty_is_noticed_in_each_form(text):
    assert INTERVAL.search(text)


@pytest.mark.parametrize("part", [*NOT_MEASURED, *SETTINGS])
def test_each_text_that_needs_no_claim_is_on_a_page(part):
    assert any(part in words_of(page) for page in PAGES)


def test_a_number_without_a_claim_is_noticed():
    (first, *others) = (claim for claim in CLAIMS if claim.page == "README.md")
    assert len(unclaimed("README.md", others)) == len(list(first.published()))


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.text[:40])
def test_a_claim_is_on_its_page_with_its_command_and_has_all_its_numbers(claim):
    assert claim.is_on_page()
    assert COMMANDS.get(claim.study, f"python -m scenarios.{claim.study}") in words_of(claim.page)
    assert len(claim.numbers) == len(list(claim.published()))
    assert not INTERVAL.search(re.sub(r"\{[^}]*\}|\(\d+ to \d+\)", "", claim.sentence))


def test_no_claim_is_made_twice():
    assert len({(claim.page, claim.text) for claim in CLAIMS}) == len(CLAIMS)


@pytest.mark.parametrize(
    ("sentence", "number"),
    [
        ("takes {7.5 +- 0.7} s", (7.5, 0.7, 0.05)),
        ("takes {1,200} s", (1200.0, None, 0.5)),
        ("in {36 % +- 2 %} of", (0.36, 0.02, 0.005)),
        ("in {58 %} of", (0.58, None, 0.005)),
        ("{+.25 +- .5}", (0.25, 0.5, 0.005)),
    ],
)
def test_a_number_is_read_with_its_interval_and_its_last_digit(sentence, number):
    (found,) = Claim("x", "README.md", sentence, ()).published()
    assert found[1:] == pytest.approx(number)


@pytest.mark.parametrize(("mean", "holds"), [(7.5, True), (5.5, True), (5.4, False), (9.6, False)])
def test_a_number_that_has_moved_by_more_than_the_margin_does_not_hold(mean, holds):
    """Twice the root of the sum of the squares of 0.7 and 0.7 is 1.98, and half of the last digit 0.05."""
    claim = Claim("x", "README.md", "takes {7.5 +- 0.7} s", [lambda _: (mean, 0.7)])
    (row,) = compared(claim, OPTIONS)
    assert row.holds is holds


def test_a_standard_error_is_not_taken_for_half_an_interval():
    claim = Claim("x", "README.md", "{7.5 +- 0.7}", [lambda _: (9.9, 0.7)])
    assert [row.holds for row in compared(claim, OPTIONS)] == [False]
    assert [row.holds for row in compared(replace(claim, sigmas=1.96), OPTIONS)] == [True]


def test_each_run_is_made_once(monkeypatch):
    made = []

    def measure(self, scenarios, label, metric):
        made.extend(scenarios)
        return [[scenario] for scenario in scenarios]

    monkeypatch.setattr(check_pages.Options, "measure", measure)
    options = replace(OPTIONS, values={})
    assert options.measure(["a", "b", "a"], "", len) == [["a"], ["b"], ["a"]]
    assert options.measure(["b", "c"], "", len) == [["b"], ["c"]]
    assert replace(options, runs=5).measure(["a"], "", len) == [["a"]]
    assert made == ["a", "b", "c", "a"]


def test_a_sentence_that_is_not_on_its_page_is_noticed():
    assert not Claim("x", "README.md", "{7.5 +- 0.7} s, and {1,200 +- 12} s", ()).is_on_page()
