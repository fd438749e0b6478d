"""A message that names many things, or shows a long value, names and shows so many, and says that there are more."""

import re

import networkx as nx
import numpy as np
import pytest

from desim.cli.output import fail
from desim.config.answers import wrong_answer
from desim.config.arguments import abridged
from desim.config.arrays import array_text
from desim.kernel.graph_files.node_names import shortened
from desim.kernel.measured.models import LatencyTrace
from desim.kernel.models.graphs import node_names
from desim.pursuit.mobility.mobility_file import read_mobility
from desim.simulation.watchdog import _waiting_text

LETTERS = "abcdefghijklmnopqrstuvwxyz"


def lacking(count, folder):
    """Return what is said about a node that a file of so many nodes lacks."""
    file = folder / "m.csv"
    file.write_text("node,t,x,y\n" + "".join(f"{name},0,0,0\n{name},1,1,1\n" for name in LETTERS[:count]))
    with pytest.raises(ValueError, match="has no node") as refused:
        read_mobility(file).track("zebra")
    return str(refused.value).rpartition("it has node")[2].removeprefix("s")


def named(count, folder):
    """Return the nodes of a table of latencies among so many."""
    file = folder / "t.csv"
    rows = [f"{a},{b},0,0.5\n" for a, b in zip(LETTERS[:count], LETTERS[1:count] + "a", strict=True)]
    file.write_text("src,dst,t,value\n" + "".join(rows))
    return re.sub(r"\d+ is ", "", LatencyTrace(file=str(file)).named_nodes)


LISTS = {
    "nodes of a graph file": (lambda count, _: shortened(LETTERS[:count]), 5, 5),
    "nodes of a graph": (lambda count, _: node_names(nx.empty_graph([*LETTERS[:count]])), 10, 10),
    "nodes of a table of links": (named, 20, 20),
    "nodes of a mobility file": (lacking, 10, 10),
    "waiting pursuers": (lambda count, _: _waiting_text("a.py:1", range(count)).partition("pursuers")[2], 8, 8),
}
"""How many things a list names if there are no more, and how many of more."""


@pytest.mark.parametrize("name", LISTS)
def test_a_list_names_so_many_and_says_that_there_are_more(name, tmp_path):
    text, most, of_more = LISTS[name]
    for count, ends in ((2, False), (most, False), (most + 1, True), (most + 5, True)):
        found = text(count, tmp_path)
        assert ("..." in found) is ends, (count, found)
        shown = [part for part in re.split(r"[^\w.]+", found) if part]
        assert len([part for part in shown if part != "..."]) == (of_more if ends else count), (count, found)


CUT = {
    "a value": (lambda text: abridged(text), 59, 57),
    "an answer": (lambda text: str(wrong_answer("nothing", Named(text), len)), 300, 300),
    "an item": (lambda text: array_text(np.array([Named(text)], dtype=object)), 300, 300),
}
"""How many characters are shown of a text that is no longer, and how many of a longer one."""


class Named:
    """Has a text of any length."""

    def __init__(self, text):
        self.text = text

    def __repr__(self):
        return self.text


@pytest.mark.parametrize("name", CUT)
def test_a_long_value_is_cut_and_ends_in_dots(name):
    text, most, of_longer = CUT[name]
    for length, shown in ((most, most), (most + 1, of_longer), (most + 9, of_longer)):
        found = text("w" * length)
        assert max(map(len, re.findall("w+", found))) == shown, length
        assert ("w..." in found) is (length > most), length


@pytest.mark.parametrize(("length", "shown"), [(2000, "w" * 2000), (2001, f"{'w' * 1000} ... {'w' * 1000}")])
def test_the_middle_of_a_very_long_line_of_an_error_is_left_out(length, shown, capsys):
    with pytest.raises(SystemExit):
        fail(f"short\n{'w' * length}")
    assert capsys.readouterr().err == f"short\n{shown}\n"
