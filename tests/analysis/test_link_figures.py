"""The figure of measured links, and the command that draws it."""

from math import nan

import numpy as np
import pytest
from matplotlib.figure import Figure

from desim import LatencyTrace, LossTrace, SignalTrace
from desim.view.pictures import link_traces as link_figures
from scenarios.studies.study import SCENARIOS
from tests.command import accepted, refused

ONE = "t,value\n0,0.1\n1,0.5\n3,\n4,0.2\n"
WAYS = [(src, dst) for src in range(3) for dst in range(4) if src != dst]
ROWS = [f"{t + 0.1 * src},{src},{dst},{'' if src == t else -80 - src}\n" for t in range(3) for src, dst in WAYS]
MANY = "".join(["t,src,dst,value\n", *ROWS])


def axes_of(trace):
    """Return the axes on which a trace is drawn, and its lines by label."""
    axes = Figure().subplots()
    link_figures._draw(axes, trace)
    return axes, {line.get_label(): line for line in axes.lines}


def test_a_line_has_the_values_of_its_rows_and_a_cross_where_one_is_missing():
    """Latencies in ms; repetition leads an interpolated line back to its first value, at the end of the trace."""
    times = np.repeat([0.0, 1.0, 3.0, 4.0, 16 / 3], 2)
    for between, last, style in (("hold", 200.0, "steps-post"), ("linear", 100.0, "default")):
        axes, lines = axes_of(LatencyTrace(table=ONE, between=between))
        line, cross = lines["all links"], lines["lost"]
        assert line.get_xdata() == pytest.approx(times)
        values = [100.0, 100.0, 500.0, 500.0, 500.0, nan, 200.0, 200.0, last, last]
        assert line.get_ydata() == pytest.approx(values, nan_ok=True)
        assert line.get_drawstyle() == style
        assert (cross.get_xdata().tolist(), cross.get_ydata().tolist()) == ([3.0], [500.0])
        assert axes.get_xlim() == pytest.approx((0.0, 16 / 3))
    _, lines = axes_of(LossTrace(table=ONE, start=2.0))
    assert list(lines) == ["all links", "lost", "start of the simulation"]
    assert list(lines["start of the simulation"].get_xdata()) == [2.0, 2.0]
    assert lines["all links"].get_ydata()[0] == 0.1
    _, lines = axes_of(LatencyTrace(table="t,src,dst,value\n0,0,1,1\n1,0,1,2\n", both_ways=True))
    assert list(lines) == ["0 ↔ 1"]


def test_of_many_links_the_median_and_the_share_without_a_value_are_drawn(monkeypatch):
    """Three senders begin 0.1 s one after the other; sender k has no value at k s, and before its start its last."""
    monkeypatch.setattr(link_figures, "GRID", 6)
    axes, lines = axes_of(SignalTrace(table=MANY, threshold=-81.5))
    grid = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert lines["median"].get_xdata() == pytest.approx(grid)
    assert lines["median"].get_ydata() == pytest.approx([-81.0, -81.5, -81.0, -81.0, -81.0, -80.5])
    assert list(lines["threshold"].get_ydata()) == [-81.5, -81.5]
    (share,) = axes.figure.axes[1:]
    assert share.lines[0].get_ydata() == pytest.approx([2 / 3, 1 / 3, 0.0, 1 / 3, 1 / 3, 1 / 3])
    assert (share.get_ylim(), share.get_ylabel()) == ((0.0, 1.0), "share without a value")
    assert share.spines["right"].get_visible()
    (area,) = axes.collections
    assert area.get_label() == "middle 90 % of 9 links"
    low, high = area.get_paths()[0].get_extents().intervaly
    assert (low, high) == pytest.approx((-82.0, -80.0))


@pytest.mark.whole
def test_a_check_draws_the_measured_links_beside_what_it_prints(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = SCENARIOS / "measured.toml"
    plain = accepted("check", file)
    drawn = accepted("check", file, "--plot")
    assert drawn.stdout == plain.stdout
    written = [f"wrote measured.links.{kind}" for kind in ("svg", "png")]
    assert [line.split(": ")[0] for line in drawn.stderr.splitlines()] == [*written, f"{file} is valid"]
    accepted("check", file, "--plot", "-o", "here/links.pdf")
    names = {"measured.links.svg", "measured.links.png", "here", "here/links.pdf"}
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")} == names


def test_links_that_were_not_measured_are_not_drawn(tmp_path):
    (tmp_path / "f.toml").write_text("horizon = 1.0\n")
    assert "--out is an option of --plot" in refused("check", tmp_path / "f.toml", "-o", "x.svg")
    assert "--out x.gif: should end in .svg" in refused("check", tmp_path / "f.toml", "--plot", "-o", "x.gif")
    said = refused("check", tmp_path / "f.toml", "--plot", "-o", tmp_path / "x.svg")
    assert said == 'no link follows measurements: a latency or loss of the kind "trace" or "signal_trace"\n'
