"""What a notebook shows of results: text of which nothing is taken for HTML."""

import io
import json
import re
import sys
from base64 import b64decode
from html import unescape
from html.parser import HTMLParser
from math import isnan, nan

import pytest
from jupyter_client.manager import start_new_kernel

import desim
from desim import Scenario, run, summary
from desim.analysis.statistics import estimate
from desim.analysis.tables import as_json, from_json
from desim.pursuit.core.events import Ended
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Recording
from desim.study.ablation.explain import explain
from desim.study.results.explanation import Explanation
from desim.study.workers.progress import progress
from desim.view.pages.replay import replay_page

HOSTILE = "</td><script>window.hurt = 1</script> & <b>"
# One pursuer at the place of the evader, which is captured at once; or no capture possible within 0.1 s.
AT_ONCE = Scenario(name=HOSTILE, team=Team(positions=[(1.0, 1.0)]), evader=Evader(position=(1.0, 1.0)))
NEVER = Scenario(horizon=0.1, team=Team(positions=[(9.0, 1.0)]), evader=Evader(position=(1.0, 1.0)))


class Table(HTMLParser):
    """The rows of a table, and all tags."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.tags, self.texts = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_data(self, data):
        self.texts.append(data)
        if self.tags[-1] in {"td", "th"}:
            self.rows[-1][-1] += data


@pytest.mark.slow
def test_a_run_shows_what_it_was_and_how_it_ended():
    result = run(AT_ONCE, 5)
    table = Table(result._repr_html_())
    assert table.rows == [
        ["scenario", HOSTILE],
        ["seed", "5"],
        ["protocol", "sap"],
        ["ended", "captured by 0 after 0.00 s"],
        ["events", f"{len(result.trace):,}"],
    ]
    assert set(table.tags) == {"table", "tr", "th", "td", "img"}


def test_the_picture_of_a_run_is_below_its_table(monkeypatch):
    monkeypatch.setattr("desim.view.pictures.run_figure.html_picture", lambda result: f"<img alt='{result.seed}'>")
    assert run(NEVER, 5)._repr_html_().endswith("</table><img alt='5'>")


@pytest.mark.slow
def test_the_trajectories_are_shown_if_they_were_recorded():
    """A picture of PNG, which a page shows without a request."""
    (picture,) = re.findall(r'<img src="data:image/png;base64,([^"]*)"', run(NEVER)._repr_html_())
    assert b64decode(picture).startswith(b"\x89PNG")
    assert "<img" not in run(NEVER.model_copy(update={"record": Recording(trajectory=0.0)}))._repr_html_()


@pytest.mark.slow
def test_a_run_without_a_capture_is_shown_as_such():
    assert ["ended", "not captured within 0.1 s"] in Table(run(NEVER)._repr_html_()).rows


@pytest.mark.slow
def test_a_run_with_several_evaders_shows_their_number():
    """All of them stand where a pursuer does, or none of them is ever reached."""
    two = {"evader": (Evader(position=(0.0, 0.0), speed=0.0), Evader(position=(0.0, 0.0), speed=0.0))}
    team = Team(positions=((0.0, 0.0),), speeds=1.0)
    both = run(Scenario(team=team, **two))
    assert ["ended", "captured 2 of 2, the last by 0 after 0.00 s"] in Table(both._repr_html_()).rows
    none = run(NEVER.model_copy(update={"evader": Evader(count=2, speed=0.9)}))
    assert ["ended", "captured 0 of 2 within 0.1 s"] in Table(none._repr_html_()).rows


@pytest.mark.slow
def test_a_run_stopped_by_a_watcher_is_shown_as_such():
    result = run(NEVER, 1, lambda event: event.t > 0)
    assert result.trace.of(Ended)[0].reason == "stopped"
    ((_, ended),) = [row for row in Table(result._repr_html_()).rows if row[0] == "ended"]
    assert ended.startswith("stopped after 0.")


@pytest.mark.slow
def test_a_protocol_that_is_a_function_is_called_by_its_name():
    def mine(agent):
        yield agent.sleep(1.0)

    assert ["protocol", "mine"] in Table(run(NEVER.model_copy(update={"protocol": mine}))._repr_html_()).rows


@pytest.fixture(scope="module")
def found():
    base = Scenario(name=HOSTILE, horizon=0.3, team=Team(count=3))
    return explain(base.model_copy(update={"network": base.network.model_copy(update={"range": 5.0})}), runs=4)


@pytest.mark.slow
def test_an_explanation_shows_its_table(found):
    table = Table(found._repr_html_())
    assert table.rows == [[cell.replace("+-", "\N{PLUS-MINUS SIGN}") for cell in row] for row in found.rows()]
    assert any(HOSTILE in each for each in table.texts)
    assert set(table.tags) <= {"table", "caption", "tr", "th", "td", "p"}
    assert all(remark in table.texts for remark in found.remarks())
    assert found.remarks()


def test_an_explanation_can_be_restored_from_its_document(found):
    again = Explanation.of(json.loads(json.dumps(found.document())))
    assert again.table() == found.table()
    for metric, cost in found.costs.items():
        assert again.costs[metric].interacts == cost.interacts
        assert again.costs[metric].together.mean.standard_error == pytest.approx(
            cost.together.mean.standard_error, abs=1e-12
        )


@pytest.mark.parametrize("made", [[], {}, {"costs": {}}, {"costs": {"active_time": 1}}, "no"])
def test_a_document_that_is_not_of_an_explanation_is_refused(made):
    with pytest.raises(ValueError, match="is not an explanation"):
        Explanation.of(made)


@pytest.mark.parametrize("values", [[1.0, 2.0, 4.0], [3.0], [5.0, 5.0]])
def test_an_estimate_survives_json(values):
    one = estimate(values)
    again = from_json(json.loads(json.dumps(as_json(one))))
    assert (again.mean, again.count) == (one.mean, one.count)
    assert again.standard_error == pytest.approx(one.standard_error, nan_ok=True)
    assert isnan(from_json({"mean": None, "half_width": None, "runs": 0}).mean) is isnan(nan)


def test_a_short_text_stands_for_a_run_and_its_metrics():
    result = run(NEVER, 3)
    name = NEVER.name
    assert repr(result) == f"<Result of {name}, seed 3: not captured within 0.1 s>"
    assert re.fullmatch(
        r"<Summary of \d+ metrics: seed = 3, captured = False, active_time = .*>", repr(summary(result))
    )
    assert repr(desim.replay(result)) == f"<Replay of {name}, seed 3>"


def test_the_metrics_of_a_run_are_a_table_with_units():
    found = summary(run(NEVER, 3))
    rows = Table(found._repr_html_()).rows
    assert ["end time", "0.1 s"] in rows
    assert [": ".join(row) for row in rows] == str(found).splitlines()


def test_a_scenario_shows_what_differs_from_the_defaults():
    assert repr(Scenario()) == "Scenario()"
    assert repr(NEVER) == (
        "Scenario(horizon=0.1, team=Team(count=1, positions=((9.0, 1.0),)), evader=Evader(position=(1.0, 1.0)))"
    )
    table = Table(AT_ONCE._repr_html_())
    assert table.rows[0] == ["name", HOSTILE]
    assert ["evader.position", "(1.0, 1.0)"] in table.rows
    assert not [row for row in table.rows if row[0].startswith("network")]
    assert set(table.tags) == {"table", "tr", "th", "td"}


def test_a_replay_is_a_frame_that_cannot_reach_the_notebook(tmp_path):
    result = run(AT_ONCE, 5)
    shown = desim.replay(result)
    frame = shown._repr_html_()
    assert frame.count("<") == 2, "nothing of the page is taken for HTML of the notebook"
    (page,) = re.findall(r'srcdoc="([^"]*)" sandbox="allow-scripts allow-downloads"', frame)
    assert unescape(page) == shown.page == replay_page(result)
    assert shown.write(tmp_path / "r.html").read_text(encoding="utf-8") == replay_page(result)


@pytest.fixture(scope="module")
def cell():
    """Return a function that executes a cell in a kernel and returns the data of its outputs by their MIME types."""
    manager, client = start_new_kernel()

    def execute(code):
        outputs = []
        reply = client.execute_interactive(code, timeout=120, output_hook=outputs.append)
        assert reply["content"]["status"] == "ok", reply["content"]
        return {kind: data for output in outputs for kind, data in output["content"].get("data", {}).items()}

    execute(
        "import desim; from desim import *\n"
        "result = run(Scenario(horizon=1.0, team=Team(count=3), record=Recording(messages=True)))\n"
        "swept = sweep(result.scenario, {'network.latency.value': [0.0, 0.2]}, reps=2)"
    )
    yield execute
    client.stop_channels()
    manager.shutdown_kernel(now=True)


@pytest.mark.whole
@pytest.mark.parametrize("setup", ["0", "import matplotlib.pyplot", "%matplotlib inline"])
def test_a_kernel_shows_each_figure(cell, setup):
    cell(setup)
    for code in ("desim.plot(result)", "desim.plot(result, 'spacetime')", "swept.plot('active_time')"):
        assert b64decode(cell(code)["image/png"]).startswith(b"\x89PNG"), code
    assert "image/png" not in cell("swept"), "a table is no figure"


def test_a_notebook_shows_progress_and_a_pipe_does_not(monkeypatch):
    for in_notebook in (False, True):
        stream = io.StringIO()
        monkeypatch.setattr(sys, "stderr", stream)
        if in_notebook:
            monkeypatch.setitem(sys.modules, "ipykernel.zmqshell", None)
        with progress(2, "runs", "run") as bar:
            bar.update(2)
        assert ("2/2" in stream.getvalue()) == in_notebook
