"""Each fast way to a result names the test that keeps it equal to the plain way."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
KEPT = re.compile(r"Kept equal to ((?:(?!Kept equal).)+?) by `(tests/[\w/]+\.py)::(\w+)`")
CLAIM = re.compile(
    r"the same result|times as fast|faster for|in blocks|are drawn at once|draws at once"
    r"|\btype\([\w.]+\) is (?:not )?[A-Z]\w+"
)
"""By this the source shows that it has two ways: it says so, or asks for the exact type of a model (CONTRIBUTING)."""
NO_PAIR = {
    "desim/kernel/core/body_content.py": "the types of contents are no models",
    "desim/kernel/core/message_size.py": "as there",
    "desim/kernel/core/positions.py": "two interfaces for users, not two ways",
    "desim/kernel/models/traits.py": "says what a user's method `draw` is for; the network does it",
    "desim/kernel/tc/writer.py": "refuses what it cannot write",
    "desim/pursuit/motion/environment.py": "says that there is no flow, and nothing is computed in another way",
    "desim/pursuit/sensing/noise.py": "asks whether an answer of a user has to be checked",
    "desim/pursuit/team/observation.py": "saves questions that have one answer for that type",
    "protocols/schedules/periodic.py": "the block is a part of what a seed means, so there is no other way",
}
"""Modules with these words or questions that have no second way, and why."""
SEARCHED = ("desim/kernel/", "desim/pursuit/", "desim/simulation/", "protocols/")
"""The packages that take part in a run."""


NOT_IN_RUNS = ("desim/kernel/graph_files/", "desim/kernel/measured/", "desim/kernel/models/", "desim/pursuit/mobility/")
"""Parts of these packages that act before a run."""


@cache
def sources():
    """Return the text of each module, by its path."""
    files = [*(ROOT / "desim").rglob("*.py"), *(ROOT / "protocols").rglob("*.py")]
    return {file.relative_to(ROOT).as_posix(): file.read_text(encoding="utf-8") for file in files}


@cache
def functions_of(file):
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def references():
    """Return module, plain way, file and name of the test for each fast way that names one."""
    for module, text in sources().items():
        for plain, file, name in KEPT.findall(re.sub(r"\s*#\s+|\s+", " ", text)):
            yield module, plain, file, name


@pytest.mark.parametrize(("file", "name"), sorted({(file, name) for _, _, file, name in references()}))
def test_every_test_that_keeps_a_fast_way_equal_exists(file, name):
    assert name in functions_of(file)


@pytest.mark.slow
def test_every_fast_way_that_is_kept_equal_names_its_test_in_full():
    """A reference that the pattern does not match would not be tested."""
    named = list(references())
    assert len(named) == sum(len(re.findall(r"Kept equal", text)) for text in sources().values())
    assert len(named) >= 25


@pytest.mark.slow
def test_every_module_that_speaks_of_two_ways_names_a_test():
    with_tests = {module for module, *_ in references()}
    in_runs = {module: re.sub(r"\s+", " ", text) for module, text in sources().items() if module.startswith(SEARCHED)}
    claiming = {module for module, text in in_runs.items() if CLAIM.search(text)}
    assert claiming - with_tests == NO_PAIR.keys()


@pytest.mark.slow
def test_the_table_of_fast_paths_is_that_of_the_docstrings():
    page = (ROOT / "docs/explanation/packages.md").read_text(encoding="utf-8").partition("## Fast paths\n")[2]
    rows = re.findall(r"^\| `([\w/.]+)` \| [^|]+ \| ([^|]+) \| `(\w+)` \|$", page, re.MULTILINE)
    assert sorted(rows) == sorted((module, plain, name) for module, plain, _, name in references())


def test_no_collection_is_created_by_its_annotation_in_a_run():
    """`list[int]()` takes 0.5 us, twenty times as long as `[]`, because it also creates the type."""
    called = re.compile(r"\b(?:list|dict|set|deque|defaultdict|Counter)\[(?:[^][]|\[[^][]*\])*\]\(")
    assert called.search("x = dict[int, list[int]]()")
    in_runs = [module for module in sources() if module.startswith((*SEARCHED, "desim/learning/"))]
    in_runs = [module for module in in_runs if not module.startswith(NOT_IN_RUNS)]
    assert len(in_runs) > 100
    assert [module for module in in_runs if called.search(sources()[module])] == []
