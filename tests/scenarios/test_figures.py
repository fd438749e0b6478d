"""The figures of the paper: what is in them, that they can be read, and that they are the same bytes every time."""

import os
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.transforms import Bbox

from desim import run, summary
from desim.analysis.activity import active_time, relays
from desim.analysis.drawing.plots import COLUMN
from desim.analysis.timeline import timeline
from desim.analysis.trace_index import started, trace_index
from desim.kernel.core.units import SECOND
from desim.pursuit.game.game import wonderful_life_utility
from scenarios import figures, table1


@pytest.fixture(scope="module")
def results():
    """Return the run of each panel for N = 20 and seed 0."""
    return {name: trace_index(run(scenario, 0)) for name, scenario in figures.panels(20).items()}


@pytest.fixture(scope="module")
def drawn(results):
    decentralised = {name: each for name, each in results.items() if name != "centralised"}
    return {
        "configuration": figures.draw_initial(results["centralised"]),
        "trajectories": figures.draw_trajectories(results),
        "utilities": figures.draw_utilities(decentralised),
    }


@pytest.mark.whole
def test_the_panels_are_the_runs_of_table_1(results):
    """Positions that are sampled change nothing."""
    base = table1.configuration(20)
    assert list(results) == ["centralised", "delta = 0.1 s", "delta = 0.01 s", "delta = 0.001 s"]
    assert active_time(results["delta = 0.01 s"]) == active_time(run(table1.decentralised(base, 0.01), 0))
    assert active_time(results["centralised"]) == active_time(run(table1.centralised(base, 0.001), 0))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["delta = 0.1 s", "delta = 0.01 s"])
def test_utilities_are_marginal_contributions_at_the_actions_that_are_played(results, name):
    times, active, found = figures.individual_utilities(results[name])
    parts = list(timeline(results[name]))
    phi, left = np.concatenate([part.phi for part in parts]), np.concatenate([part.left for part in parts])
    assert len(times) == len(found) + 1
    rows = range(0, len(found), 7)
    expected = [
        [wonderful_life_utility(phi[k].tolist(), active[k].tolist(), float(left[k]), i) for i in range(20)]
        for k in rows
    ]
    np.testing.assert_allclose(found[rows], expected, atol=1e-9)
    assert len({tuple(row) for row in active.tolist()}) > 5


@pytest.mark.whole
def test_the_line_of_every_pursuer_is_its_utility_while_it_is_active(drawn, results):
    """Bold while it is active alone; together the lines are active as long as the sum of active times."""
    for axes, (name, result) in zip(drawn["utilities"].axes[:3], list(results.items())[1:], strict=True):
        lines = [line for line in axes.lines if len(line.get_xdata()) > 2]
        shown = 0.0
        for line in lines:
            x, y = line.get_xydata().T
            shown += np.diff(x)[~np.isnan(y[:-1]) & ~np.isnan(y[1:])].sum()
        assert shown == pytest.approx(active_time(result), rel=1e-9), name
        thin = {line.get_linewidth() for line in lines}
        assert len(lines) >= 20
        assert max(thin) == (2.0 if name != "delta = 0.1 s" else 0.7)


@pytest.mark.whole
def test_the_utilities_of_a_run_are_computed_once(monkeypatch):
    """Also if its beginning is drawn enlarged, and handovers are labelled."""
    computed, utilities = [], figures.individual_utilities
    monkeypatch.setattr(figures, "individual_utilities", lambda result: computed.append(result) or utilities(result))
    monkeypatch.setattr(figures, "SHORT_SHARE", 1.0)
    result = trace_index(run(figures.panels(20)["delta = 0.01 s"], 0))
    figure = figures.draw_utilities({"one": result, "two": result})
    assert len(computed) == 2
    assert len(figure.axes[0].child_axes) == 1
    assert figure.axes[0].texts


@pytest.mark.slow
def test_a_short_beginning_is_drawn_larger(drawn):
    (inset,) = drawn["utilities"].axes[2].child_axes
    assert inset.get_xlim() == (0.0, pytest.approx(1.1 * 0.171))
    assert not drawn["utilities"].axes[1].child_axes


@pytest.mark.slow
def test_the_initial_configuration_shows_every_player_at_its_place_with_its_number(drawn, results):
    start = started(results["centralised"])
    (axes,) = drawn["configuration"].axes
    slow, fast, evader = (line.get_xydata().tolist() for line in axes.lines)
    assert slow == [list(place) for place in start.pursuers[:-1]]
    assert fast == [list(start.pursuers[-1])]
    assert evader == [list(start.evaders[0])]
    assert [(text.get_text(), tuple(text.xy)) for text in axes.texts] == [
        (str(k), place) for k, place in enumerate(start.pursuers)
    ]


@pytest.mark.slow
def test_there_are_three_figures_of_a_column_of_a_paper(drawn):
    assert [len(figure.axes) for figure in drawn.values()] == [1, 4, 3]
    assert all(figure.get_size_inches()[0] == pytest.approx(COLUMN) for figure in drawn.values())


@pytest.mark.slow
def test_axes_have_units_and_type_is_at_least_six_points(drawn):
    for name, figure in drawn.items():
        said = {axes.get_xlabel() for axes in figure.axes if axes.xaxis.label.get_visible()}
        assert said - {""} == ({"time (s)"} if name.startswith("utilities") else {"x (m)"})
        ordinate = figure.get_supylabel() or figure.axes[0].get_ylabel()
        assert ordinate == ("individual utility (s)" if name.startswith("utilities") else "y (m)")
        assert min(text.get_fontsize() for text in texts(figure)) >= 6.0


def texts(figure):
    """Return all text that is seen."""
    every = [*figure.axes, *(inset for axes in figure.axes for inset in axes.child_axes)]
    found = [figure._supylabel] if figure._supylabel else []
    for axes in every:
        found += [*axes.texts, axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            found += [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return [text for text in found if text.get_visible() and text.get_text()]


def ink(text):
    """Return the box of a text, without the room below the line, which digits do not use."""
    box = text.get_window_extent()
    descent = 0.2 * text.get_fontsize() * text.figure.dpi / 72 if text.get_text().isdigit() else 0.0
    return Bbox.from_extents(box.x0, box.y0 + descent, box.x1, box.y1)


@pytest.mark.slow
def test_no_text_lies_over_another_or_outside_of_the_picture(drawn):
    for name, figure in drawn.items():
        figure.draw_without_rendering()
        boxes = [(text.get_text(), ink(text)) for text in texts(figure)]
        boxes.append(("legend", figure.legends[0].get_window_extent()))
        assert len(boxes) > 8
        for k, (word, one) in enumerate(boxes):
            assert figure.bbox.x0 - 1 <= one.x0 < one.x1 <= figure.bbox.x1 + 1, (name, word)
            assert figure.bbox.y0 - 1 <= one.y0 < one.y1 <= figure.bbox.y1 + 1, (name, word)
            assert not [(name, word, other) for other, box in boxes[k + 1 :] if one.overlaps(box)]


DELTAS = (0.2, 0.1, 0.05)
"""Slots in which not much happens, s."""
PROGRAM = f"""
import sys
from pathlib import Path
from desim.analysis.drawing.plots import save
from scenarios import figures
figures.DELTAS = {DELTAS}
for name, figure in figures.pictures(20, 0):
    save(figure, Path(sys.argv[1]) / f"figures_{{name}}.svg")
"""


@pytest.mark.whole
def test_the_study_writes_its_figures_and_its_numbers_and_another_process_the_same_bytes(tmp_path, study, monkeypatch):
    monkeypatch.setattr(figures, "COUNTS", (20,))
    monkeypatch.setattr(figures, "DELTAS", DELTAS)
    monkeypatch.setattr(figures, "PRINT_DPI", 50)
    document, text, _ = study(figures.main)
    assert [cell["panel"] for cell in document["cells"]] == ["centralised", *(f"delta = {each:g} s" for each in DELTAS)]
    for cell, scenario in [*zip(document["cells"], figures.panels(20).values(), strict=True)][1:2]:
        result = run(scenario, 0)
        numbers = summary(result)
        chain = relays(result)
        assert cell["N"] == 20
        assert cell["runs"] == [
            {
                "active_time": numbers.active_time,
                "end": numbers.end_time,
                "captured": numbers.captured,
                "alone_from": chain[0][0] / SECOND if chain else None,
                "handovers": numbers.handovers,
            }
        ]
        assert f"{numbers.active_time:.2f}" in text
    assert "captured" in text
    (tmp_path / "again").mkdir()
    environment = os.environ | {"PYTHONHASHSEED": "1"}
    subprocess.run([sys.executable, "-c", PROGRAM, str(tmp_path / "again")], env=environment, check=True)
    for path in (tmp_path / "again").iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), path.name
        assert b"<dc:date" not in path.read_bytes()
        assert (tmp_path / path.name).with_suffix(".png").exists()
    assert len([*(tmp_path / "again").iterdir()]) == 3


@pytest.mark.slow
def test_a_run_of_the_paper_has_the_numbers_that_are_quoted(results):
    assert figures.run_metrics(results["delta = 0.01 s"]) == figures.RunMetrics(
        pytest.approx(12.19), 4.45, True, 1.71, 0
    )
