"""The progress bar of many runs."""

import re
from io import StringIO

import pytest

from desim.study.workers import progress as progress_module
from desim.study.workers.progress import advance, progress


class Terminal(StringIO):
    """A terminal that keeps what is printed."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch):
    """Return a list whose item is the time, s, and let the bar read it."""
    now = [1000.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    monkeypatch.setattr(progress_module, "time", lambda: now[0])
    return now


def test_the_time_left_does_not_count_the_start_of_the_workers(clock, monkeypatch):
    """100 runs, 2 each second after workers that start for a minute: after 4 runs, 96 / 2 = 48 s are left.

    With the minute, 4 runs in 61 s would make it 24 minutes.
    """
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with progress(100, "relay", "run") as bar:
        clock[0] += 60.0
        advance(bar, 2)
        clock[0] += 1.0
        advance(bar, 2)
    left = re.findall(r"4/100 \[00:01<([\d:]+)", terminal.getvalue())
    assert left[0] == "00:48"


def test_a_pipe_gets_no_bar(monkeypatch):
    stream = StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    with progress(2, "relay", "run") as bar:
        advance(bar, 2)
    assert stream.getvalue() == ""
