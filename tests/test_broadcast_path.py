"""A broadcast takes a path that a reader can follow: a few modules, which a page of the documentation walks."""

import re
from functools import cache
from pathlib import Path

import pytest

from tests.broadcast_path import PLAIN, SHARED, function_named, modules_of, path_of_a_broadcast

ROOT = Path(__file__).parent.parent
pytestmark = pytest.mark.own_trace
SOURCE = "https://github.com/desim-project/desim/blob/main/"
MOST_MODULES = {"plain": 12, "shared": 16}
"""Of the path on an ideal network, and over a shared channel, which adds the transmitter, its airtime and departure."""
_traced = cache(path_of_a_broadcast)


@cache
def walked() -> list[str]:
    """Return the functions that the page walks, in its order, as "module:Class.method"."""
    page = (ROOT / "docs/explanation/network.md").read_text(encoding="utf-8")
    section = page.partition("## The path of a broadcast\n")[2].partition("\n## ")[0]
    links = re.findall(rf"\[`([^`]+)`\]\({re.escape(SOURCE)}([^)]+)\.py\)", re.sub(r"\s+", " ", section))
    return [f"{path.replace('/', '.')}:{name}" for name, path in links]


@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "most"), [(PLAIN, MOST_MODULES["plain"]), (SHARED, MOST_MODULES["shared"])])
def test_a_broadcast_crosses_few_modules(scenario, most):
    modules = modules_of(_traced(scenario))
    assert len(modules) <= most, "\n".join([f"a broadcast crosses {len(modules)} modules:", *modules])


@pytest.mark.slow
def test_the_page_walks_the_path_of_a_broadcast_in_its_order():
    """First the path on an ideal network, then what a shared channel adds."""
    plain, shared = _traced(PLAIN), _traced(SHARED)
    assert walked() == [*plain, *(name for name in shared if name not in plain)]


def test_the_path_over_a_shared_channel_is_that_on_an_ideal_network_with_steps_added():
    plain, shared = _traced(PLAIN), _traced(SHARED)
    assert [name for name in shared if name in plain] == plain


@pytest.mark.parametrize("name", walked())
def test_every_function_that_the_page_names_exists_in_the_file_that_it_links_to(name):
    module = name.partition(":")[0]
    assert (ROOT / f"{module.replace('.', '/')}.py").is_file()
    function_named(name)
