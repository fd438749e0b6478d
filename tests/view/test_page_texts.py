"""The variable parts of pages of runs made by hand: headers, metrics, controls, answers, and what is in the plane."""

import ast
import json
import re
from dataclasses import asdict, replace
from math import inf, isfinite
from pathlib import Path

import pytest
from jinja2 import Environment, meta

import desim
from desim import Scenario
from desim.analysis.metrics import METRICS, Metric, Summary
from desim.kernel.core.events import Trace
from desim.pursuit.core.events import Captured, Distrusted, Ended, Estimated
from desim.scenario.overrides import Source
from desim.view.pages import play_page as page_of_play
from desim.view.pages.controls import controls
from desim.view.pages.headline import about, conditions
from desim.view.pages.metric_rows import compared_metrics, differences_over_seeds
from desim.view.pages.play_page import play_page
from desim.view.pages.playground import Playground
from desim.view.pages.replay import missing_recordings, replay, size_warning
from desim.view.pages.replay_data import replay_data
from tests.golden import golden
from tests.view.by_hand import MS, history, pair
from tests.view.test_replay import column

MANY = {
    "network.latency": {"kind": "gamma", "offset": 0.01, "shape": 2.0, "scale": 0.02},
    "network.loss": {"kind": "gilbert_elliott", "share": 0.1, "burst": 3.0},
    "network.range": 8.0,
    "network.reception": {"kind": "log_distance"},
    "network.graph": "grid",
    "network.medium": {"kind": "bitrate", "bitrate": 20000.0, "access": "csma"},
    "network.link": [{"src": 0, "dst": 1, "loss": 0.5}, {"src": 1, "dst": 0, "loss": 0.25}],
    "announce.trigger": "revision",
    "evader.count": 2,
}
"""Values of keys, a model of each kind that a page describes."""


def ended_otherwise(result, reason):
    """Return a run that ends without its last capture."""
    *events, captured, counts, end = result.trace.events
    assert isinstance(captured, Captured)
    trace = Trace()
    trace.events += [*events, counts, Ended(end.t, reason, None)]
    return replace(result, trace=trace)


def under(changes, result=None):
    """Return a run by hand as if its scenario had other values of some keys."""
    result = history() if result is None else result
    return replace(result, scenario=result.scenario.with_(changes))


def headers():
    for result in (history(), pair()):
        yield about(result)
        yield from (about(ended_otherwise(result, reason)) for reason in ("horizon", "stopped"))
    for changes in (
        {},
        {"network.latency": 0.123456, "network.loss": 0.25, "network.range": 5.0, "announce.heartbeat": 0.5},
        MANY,
        MANY
        | {"network.medium.access": "aloha", "announce.trigger": "never", "network.link": MANY["network.link"][:1]},
        {"network.graph": "ring", "announce.trigger": "change", "network.medium": "lora"},
    ):
        yield conditions(Scenario().with_(changes))
    unrecorded = history(samples=(), messages=False)
    yield from missing_recordings(unrecorded, unrecorded)
    yield from missing_recordings(under({"network.range": 5.0, "network.reception": increasing}))
    yield from (str(size_warning(Scenario().with_({"team.count": count}))) for count in (999, 1000))
    shown = replay(history(samples=(0,)))
    yield repr(shown)
    yield re.sub('srcdoc="[^"]*"', 'srcdoc="..."', shown._repr_html_())


def increasing(distance, reach):
    """A reception that increases with the distance, as none should."""
    return distance / (4.0 * reach)


def metrics():
    named = {"heat": Metric(lambda _: 0.0, unit="J", more_is="better", note="Heat.")}
    times = {"captured": True, "capture_time": 1.0, "active_time": 0.75, "misassigned_time": None, "end_time": 1.0}
    counts = {"handovers": 3, "messages_sent": 1_000_000, "messages_lost": 4, "age_mean": inf, "belief_error": 0.5}
    one = Summary(times | counts | {"heat": 2.5}, {"heat": "J"})
    changes = {"captured": False, "capture_time": None, "active_time": 1234.5678, "belief_error": 0.5001}
    other = Summary({**one} | changes | {"messages_sent": 10, "heat": 4.0, "age_mean": 2.0}, {"heat": "J"})
    finite = [Summary({**each, "age_mean": None}, each.units) for each in (one, other)]
    yield from map(json.dumps, map(rounded, compared_metrics(one, None, named)))
    yield "compared"
    yield from map(json.dumps, map(rounded, compared_metrics(one, other, named)))
    yield "over seeds"
    rows = differences_over_seeds(
        [tuple(finite), tuple(finite), (finite[0], finite[0])], ["ValueError: no", "late"], 9, named
    )
    yield from (json.dumps(row) for row in rounded(rows.pop("metrics")))
    yield json.dumps(rows)
    yield json.dumps(differences_over_seeds([], [], 3, named))


def all_controls():
    scenario = Scenario().with_(MANY | {"wall": [{"line": [[0, 0], [1, 2]]}], "protocol": "cbba"})
    for control in controls(scenario):
        shown = asdict(control) | {"help": None}
        usual = dict.fromkeys(shown) | {"unit": "", "options": (), "needs_file": (), "example": ""}
        yield json.dumps({key: value for key, value in shown.items() if value != usual[key]})


def answers():
    ground = Playground(Source.of(Scenario(name="a b")), Path("in a/b.toml"), ("horizon=0.01",))
    wrong = ["horizon=1,5", "team.count= ", "network.los=1", "seed"]
    for changes in ([change] for change in wrong):
        yield json.dumps(ground.answer(changes, None)["errors"])
    yield from ground.texts(["horizon=0.01", "name=x y"]).values()
    made = Playground(replace(ground.base, allow_import=True), None)
    yield from made.texts(()).values()
    yield replace(made, file=Path("x.toml")).texts(())["command"]
    yield play_page(ground).partition("const play = ")[2].partition("\n")[0]
    yield page_of_play.style().partition(".play *")[0][:400]


def planes():
    """Yield what stands in the plane, with walls, flow, inertia, estimates, distrust and receptions of all kinds."""
    walls = [
        {"line": [[0, 1], [2, 1]], "loss": 3.0, "blocks": ["radio"]},
        {"polygon": [[1, 1], [2, 1], [2, 2]], "blocks": ["sight", "radio"], "offset": [20, 0]},
    ]
    seen = [Estimated(t * MS, 1, 1, 5.0, 5.5 + t, 0.04, 0.01, 0.09) for t in (0, 500)]
    trust = [Distrusted(500 * MS, 0, 2, distrusted=True), Distrusted(600 * MS, 0, 2, distrusted=False)]
    busy = under(
        {"wall": walls, "environment.flow": {"kind": "uniform", "velocity": [0.5, -0.25]}}, history(*seen, *trust)
    )
    data = replay_data(busy, pair())
    for part in ("speeds", "radius", "sensing_range", "arcs", "reception", "walls"):
        yield f"{part}: {json.dumps(rounded(data[part]))}"
    kinds = dict.fromkeys(("t", "end"), "<u4") | dict.fromkeys(("start", "shifts", "centres", "semi_axes"), "<i4")
    kinds |= dict.fromkeys(("pursuer", "evader", "who", "suspect"), "<u2") | {"velocities": "<f4", "count": "<u4"}
    tables = {"flow": data["flow"], "estimates": data["estimates"], "distrust": data["distrust"]}
    tables |= {"ghost": data["ghost"], "path of the ghost": data["ghost"]["path"], "active": data["ghost"]["active"]}
    for name, table in tables.items():
        for key, value in table.items():
            is_packed = isinstance(value, str) and key not in {"on", "name"}
            shown = column(value, kinds.get(key, "u1")).tolist() if is_packed else value
            yield f"{name} {key}: {json.dumps(rounded(shown[:8] if is_packed else shown))}"
    turning = under({"team.dynamics": {"kind": "turn_rate", "limit": 1.0}, "team.count": 3})
    headings = replay_data(turning)["headings"]
    yield json.dumps(headings | {"values": column(headings["values"], "u1").tolist()})
    for changes in (
        {"network.range": 5.0},
        {"network.range": 5.0, "network.reception": {"kind": "log_distance"}},
        {"network.range": 5.0, "network.reception": {"kind": "log_distance"}, "network.fading": "message"},
        {"network.range": 5.0, "network.reception": increasing},
    ):
        reception = replay_data(under(changes))["reception"]
        radii = reception["radii"] and column(reception["radii"], "<f8").tolist()
        yield json.dumps(rounded(reception | {"radii": radii}))
    yield str(column(replay_data(under({"network.graph": "star"}))["arcs"], "<u2").tolist())


def rounded(value):
    """Return JSON values with numbers of six digits."""
    if isinstance(value, dict):
        return {key: rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(entry) for entry in value]
    return float(f"{value:.6g}") if isinstance(value, float) and isfinite(value) else value


@pytest.mark.parametrize("part", [headers, metrics, all_controls, answers, planes], ids=lambda part: part.__name__)
def test_the_variable_parts_of_pages_are_golden(part):
    golden(f"pages/{part.__name__}.txt", "\n".join(part()) + "\n")


PAGES = Path(desim.__file__).parent / "view" / "pages"


@pytest.mark.parametrize("name", ["pair", "play", "replay", "report"])
def test_a_page_is_given_each_variable_of_its_template_and_no_other(name):
    """A variable that is not given is empty on the page, and no error."""
    module = PAGES / {"play": "play_page.py"}.get(name, f"{name}.py")
    calls = [node for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    (rendered,) = (call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "render")
    template = (PAGES / f"{name}.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True)
    environment.filters |= dict.fromkeys(("signs", "counted", "unit"), str)
    assert {keyword.arg for keyword in rendered.keywords} == meta.find_undeclared_variables(environment.parse(template))


def test_a_small_value_is_not_shown_as_none_and_a_rounding_error_is():
    one, other = ({"belief_error": 2e-4 * k, "age_mean": 0.1 * k + 0.2, "regret": 1e-16} for k in (1, 2))
    missing = dict.fromkeys(METRICS)
    now = Summary({**missing, **one, "age_mean": 0.1 + 0.2})
    rows = {row["name"]: row for row in compared_metrics(now, Summary({**missing, **other, "age_mean": 0.3}), {})}
    assert (rows["belief error"]["value"], rows["belief error"]["difference"]) == ("0.0002", "-0.0002")
    assert rows["regret"]["value"] == "0.000"
    assert "difference" not in rows["age mean"]


def test_a_row_has_what_its_digits_tell_apart_and_what_only_the_pinned_run_has():
    missing = dict.fromkeys(METRICS)
    now = Summary({**missing, "active_time": 200.012, "delivery_delay": 2e-6})
    pinned = Summary({**missing, "active_time": 200.01, "capture_time": 3.5})
    rows = {row["name"]: row for row in compared_metrics(now, pinned, {})}
    assert (rows["active time"]["value"], rows["active time"]["difference"]) == ("200.0", "+0.002")
    assert rows["delivery delay"]["value"] == "2e-06"
    assert "difference" not in rows["capture time"]
