"""The figure of measured links, and the command that draws it."""

import pytest

from desim import LatencyTrace, Links, LossTrace, Scenario, SignalTrace
from desim.kernel.models.graphs import Link
from desim.view.pictures import link_traces as link_figures
from desim.view.pictures.link_traces import link_traces
from scenarios.studies.study import SCENARIOS
from tests.command import accepted, refused
from tests.drawn import described
from tests.golden import golden

ONE = "t,value\n0,0.1\n1,0.5\n3,\n4,0.2\n"
WAYS = [(src, dst) for src in range(3) for dst in range(4) if src != dst]
ROWS = [f"{t + 0.1 * src},{src},{dst},{'' if src == t else -80 - src}\n" for t in range(3) for src, dst in WAYS]
MANY = "".join(["t,src,dst,value\n", *ROWS])


@pytest.mark.slow
def test_measured_links_are_golden(monkeypatch):
    """A line is interrupted from a cross on; repetition leads a line that is interpolated back to its first row."""
    monkeypatch.setattr(link_figures, "GRID", 6)
    own = Link(src=0, dst=1, latency=LatencyTrace(table=ONE, between="linear", after="hold", read_from="$a$.csv"))
    told = {
        "all": Links(loss=LossTrace(table=ONE, between="linear", start=2.0), link=(own,)),
        "both ways": Links(latency=LatencyTrace(table="t,src,dst,value\n0,0,1,1\n1,0,1,2\n", both_ways=True)),
        "many": Links(loss=SignalTrace(table=MANY, threshold=-81.5)),
    }
    figures = {name: link_traces(Scenario.model_construct(network=network)) for name, network in told.items()}
    golden("link_traces.txt", {name: described(figure) for name, figure in figures.items()})


@pytest.mark.slow
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
