"""`desim plot`: the same picture from a folder, from a file and from Python, and a clear message if there is none."""

import json
import shutil
import sys

import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from PIL import Image

import desim
from desim import load, run
from desim.analysis.drawing.plots import save, styled
from desim.cli.plot import plot
from desim.results.run_folder import write
from desim.study.results.tables import notes
from desim.view.formats.perfetto import perfetto
from desim.view.pictures.animation import animate
from desim.view.pictures.spacetime import spacetime
from tests.command import accepted, refused

TOML = """
name = "small"
seed = 2
horizon = 0.5
team = { count = 5 }
protocol = { kind = "sap", schedule = { kind = "poisson", rate = 5.0 } }
network = { latency = { kind = "lognormal", mean = 0.03, cv = 0.5 }, loss = { kind = "bernoulli", p = 0.2 } }
record = { messages = true }
[[fault]]
kind = "crash"
node = 1
start = 0.1
end = 0.3
"""


def call(kind, *words, code=0):
    done = CliRunner().invoke(plot, ["--kind", kind, *map(str, words)])
    assert done.exit_code == code, done.output
    assert not done.exception or isinstance(done.exception, SystemExit)
    return done.output


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(TOML)
    return tmp_path / "small.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the run of the file, and the folder that it is written to, once."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "small.toml").write_text(TOML)
    result = run(load(folder / "small.toml"))
    write(result, folder / "ran")
    return result, folder / "ran"


@pytest.fixture
def folder(file, made, tmp_path):
    return shutil.copytree(made[1], tmp_path / "ran")


@pytest.mark.whole
def test_a_space_time_diagram_of_a_folder_is_that_of_the_run(made, folder, tmp_path):
    said = call("spacetime", folder, "--from", 0.1, "--to", 0.3, "--pursuers", "4,1", "--size", "8.5cm")
    assert "spacetime.svg" in said
    assert "spacetime.png" in said
    expected = save(spacetime(made[0], 0.1, 0.3, (4, 1), "8.5cm"), tmp_path / "expected", dpi=200)
    for path in expected:
        assert (folder / f"spacetime{path.suffix}").read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_the_trajectory_is_drawn_by_default_and_as_in_python(made, folder, tmp_path):
    done = CliRunner().invoke(plot, [str(folder), "--size", "8.5cm", "-o", str(tmp_path / "own.svg")])
    assert done.exit_code == 0, done.output
    save(desim.plot(made[0], size="8.5cm"), tmp_path / "expected.svg")
    assert (tmp_path / "own.svg").read_bytes() == (tmp_path / "expected.svg").read_bytes()


@pytest.mark.slow
def test_a_timeline_of_a_folder_is_that_of_the_run(made, folder):
    call("perfetto", folder)
    assert (folder / "trace.perfetto.json").read_text() == perfetto(made[0])


@pytest.mark.whole
def test_a_film_of_a_folder_is_that_of_the_run(made, folder, tmp_path):
    call("film", folder, "--from", 0.1, "--to", 0.2, "--speed", 0.5, "--fps", 10)
    animate(made[0], tmp_path / "expected.gif", begin=0.1, end=0.2, speed=0.5, fps=10)
    assert (folder / "film.gif").read_bytes() == (tmp_path / "expected.gif").read_bytes()
    with Image.open(folder / "film.gif") as film:
        assert film.n_frames == 3


@pytest.mark.slow
def test_of_a_file_all_is_recorded_that_is_drawn(file, tmp_path):
    call("perfetto", file, "--set", "record.messages=false", "-s", 5, "-o", tmp_path / "own.json")
    made = json.loads((tmp_path / "own.json").read_text())
    assert made["otherData"] == {"scenario": "small", "seed": 5}
    assert {event.get("cat") for event in made["traceEvents"]} >= {"message", "fault", "chase"}
    call("perfetto", file)
    assert (tmp_path / "small.trace.perfetto.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("spacetime", "ran", "--from", "2"), "the run lasted 0.5 s"),
        (("spacetime", "ran", "--pursuers", "0,7"), "no pursuer 7"),
        (("spacetime", "ran", "--pursuers", "0;1"), "pursuer ids separated by commas"),
        (("film", "ran", "--speed", "0.0001"), "choose a higher speed"),
        (("film", "ran", "--speed", "0"), "--speed"),
        (("film", "nowhere"), "nowhere: cannot be read"),
        (("perfetto", "ran", "-s", "4"), "the results in a DIR are recorded"),
        (("perfetto", "ran", "-o", "ran/run.json/no.json"), "cannot be written"),
        (("spacetime", "ran", "-o", "ran/run.json/no.svg"), "cannot be written"),
        (("film", "ran", "-o", "ran/run.json/no.gif"), "cannot be written"),
        (("film", "ran", "-o", "x.png"), "--out x.png: should end in .gif or .mp4, or have no suffix, got .png"),
        (("perfetto", "ran", "-o", "x.html"), "--out x.html: should end in .json, "),
        (("spacetime", "ran", "-o", "x.jpg"), "--out x.jpg: should end in .svg or .png or .pdf, "),
        (("spacetime", "ran", "--size", "3"), "a width and perhaps a height in cm, mm or in"),
        (("trajectory", "ran", "--fps", "3"), "--fps is an option of film; this picture is of the kind trajectory"),
        (("means", "ran"), "--kind means draws a sweep, and ran is a run"),
        (("means", "small.toml"), "make one with `desim sweep small.toml -o DIR`"),
    ],
)
def test_a_run_that_cannot_be_drawn_is_reported_in_one_line(folder, words, says):
    assert says in call(*words, code=2)


@pytest.mark.slow
def test_a_picture_that_cannot_be_written_is_named_without_an_option_that_was_not_given(file, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.trajectory.svg").mkdir()
    assert call("trajectory", file, code=2).startswith("small.trajectory.svg: cannot be written: ")
    (tmp_path / "small.trajectory.svg").rmdir()
    (tmp_path / "small.trajectory.png").mkdir()
    assert call("trajectory", file, code=2).startswith("small.trajectory.png: cannot be written: ")


@pytest.mark.parametrize(("words", "says"), [(["--fps", 3], "--fps is an option of film"), (["-o", "x.gif"], "x.gif")])
def test_a_wrong_option_is_refused_before_the_scenario_is_run(file, words, says, monkeypatch):
    monkeypatch.setattr(sys.modules["desim.cli.plot"], "results_of", None)
    assert says in refused("plot", file, *words)


@pytest.mark.whole
def test_a_folder_without_messages_gives_an_error_that_explains_how_to_record_them(file, tmp_path):
    write(run(load(file, ["record.messages=false"])), tmp_path / "quiet")
    assert "record.messages = true" in call("spacetime", tmp_path / "quiet", code=2)
    call("film", tmp_path / "quiet", "--to", 0.1)
    call("perfetto", tmp_path / "quiet")


@pytest.mark.whole
def test_the_format_of_a_figure_follows_its_suffix(folder, tmp_path):
    """And of a name without one, nothing is lost."""
    window = ("--from", 0.1, "--to", 0.2)
    assert call("trajectory", folder, "-o", tmp_path / "a" / "x.pdf").count("\n") == 1
    assert [each.name for each in (tmp_path / "a").iterdir()] == ["x.pdf"]
    call("spacetime", folder, *window, "-o", tmp_path / "b" / "v1.2")
    call("perfetto", folder, "-o", tmp_path / "b" / "v1.2")
    call("film", folder, *window, "-o", tmp_path / "b" / "v1.2")
    assert sorted(each.name for each in (tmp_path / "b").iterdir()) == [
        f"v1.2.{x}" for x in ("gif", "json", "png", "svg")
    ]
    with Image.open(tmp_path / "b" / "v1.2.gif") as film:
        assert film.format == "GIF"


def test_a_wrong_name_is_refused_before_anything_runs(file, monkeypatch):
    monkeypatch.setattr("desim.simulation.run.run", lambda *_: pytest.fail("it ran"))
    assert "should end in .gif" in call("film", file, "-o", "x.png", code=2)


GRID = """
name = "swept"
horizon = 0.2
team = { count = 3 }
[sweep]
reps = 3
[sweep.grid]
"network.latency.value" = [0.0, 0.1]
protocol = [{ kind = "sap" }, { kind = "cbba" }]
"network.range" = [5.0, 10.0]
"""


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Return the folder of a sweep of 8 configurations."""
    folder = tmp_path_factory.mktemp("swept")
    (folder / "grid.toml").write_text(GRID)
    accepted("sweep", folder / "grid.toml", "-o", folder / "out")
    return folder / "out"


@pytest.mark.whole
def test_the_figure_of_a_metric_stays_when_that_of_another_is_drawn(swept, tmp_path):
    """The names of their files carry the metric."""
    folder = shutil.copytree(swept, tmp_path / "out")
    assert sorted(each.name for each in folder.glob("*.png")) == ["means-active_time.png"]
    before = (folder / "means-active_time.svg").read_bytes()
    accepted("plot", folder, "-y", "switches")
    accepted("plot", folder, "--kind", "phase", "-y", "switches")
    accepted("plot", folder, "--against", "protocol=sap")
    assert (folder / "means-active_time.svg").read_bytes() == before
    assert sorted(each.name for each in folder.glob("*.svg")) == [
        *("differences-active_time.svg", "means-active_time.svg", "means-switches.svg", "phase-switches.svg")
    ]


@pytest.mark.slow
def test_what_the_picture_of_a_sweep_cannot_show_is_told_beside_it(swept, tmp_path):
    """Such as means over those runs only that captured the evader, and runs that failed."""
    result = desim.open(swept)
    done = CliRunner().invoke(plot, [str(swept), "-y", "capture_time", "-o", str(tmp_path / "a.svg")])
    told = [note for note in notes(result, ["capture_time"]) if note != result.start_rule]
    assert told
    assert done.stderr.splitlines() == told
    assert "wrote" in done.stdout


@pytest.mark.slow
def test_the_figure_of_a_sweep_is_that_of_python(swept, tmp_path):
    words = "-y switches -x network.latency.value --by protocol --label sap=SAP=ours --ylabel s --size 8.5cmx6cm"
    accepted("plot", swept / "sweep.sqlite", *words.split(), "-o", tmp_path / "own.svg")
    options = {"x": "network.latency.value", "by": "protocol", "labels": {"sap": "SAP=ours"}, "ylabel": "s"}
    save(desim.open(swept).plot("switches", **options, size="8.5cmx6cm"), tmp_path / "expected.svg")
    assert (tmp_path / "own.svg").read_bytes() == (tmp_path / "expected.svg").read_bytes()
    assert "SAP=ours" in (tmp_path / "own.svg").read_text()


@pytest.mark.slow_but_one
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--against", "protocol=sapp"], "protocol does not take the value sapp: it takes sap, cbba"),
        (["--against", "protocl=sap"], "the grid has no key protocl, did you mean protocol?"),
        (["--against", "protocol"], "'protocol' should be KEY=VALUE, protocol.kind=sap for instance"),
        (["-y", "activetime"], "did you mean 'active_time'?"),
        (["-x", "protocl"], "did you mean protocol?"),
        (["-x", "protocol", "--by", "protocol"], "-x and --by should be different keys"),
        (["--label", "spa=SAP"], "no key takes the value spa"),
        (["--kind", "film"], "--kind film draws a run"),
        (["--kind", "phase", "--by", "protocol"], "--by is an option of"),
        (["--pursuers", "1"], "--pursuers is an option of spacetime; this picture is of the kind means"),
        (["--set", "horizon=1"], "--seed and --set apply to a scenario FILE only"),
    ],
)
def test_a_sweep_that_cannot_be_drawn_is_reported(swept, words, says):
    assert says in refused("plot", swept, *words)


def test_the_command_that_drew_names_the_one_that_plots():
    assert "No such command 'draw'. Did you mean 'desim plot'?" in refused("draw", "film", "x")


def test_the_title_above_equal_scales_and_a_high_legend_is_within_the_figure():
    """The first layout of such axes cuts the title; the ratio and the legend are those of `scenarios/many.toml`."""
    with styled((5.2, 5.2)) as figure:
        axes = figure.add_subplot()
        axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="title")
        for k in range(7):
            axes.plot([2.8, 20.0], [2.4, 16.7], label=f"line {k}")
        figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    assert axes.title.get_window_extent().y1 <= figure.bbox.y1


# Axes of a figure of several.


@pytest.mark.slow_but_one
@pytest.mark.parametrize("kind", ["trajectory", "spacetime"])
def test_a_run_is_drawn_on_given_axes_with_the_legend_outside(kind, made):
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    assert desim.plot(made[0], kind, ax=left, style={"axes.labelsize": 5.0}) is figure
    figure.draw_without_rendering()
    assert left.has_data()
    assert not right.has_data()
    assert left.xaxis.label.get_text() in {"x (m)", "time (s)"}
    box, inside = left.get_legend().get_window_extent(), left.get_window_extent()
    assert box.y0 >= inside.y1 or box.y1 <= inside.y0
    with pytest.raises(TypeError, match=r"got ndarray; give one of them, such as ax=axes\[0\]"):
        desim.plot(made[0], kind, ax=figure.subplots(1, 2))
    with pytest.raises(ValueError, match="size is that of a new figure"):
        desim.plot(made[0], kind, ax=right, size="9cm")
