"""`desim.play(scenario)` in a notebook: the kernel's answers, and the page that asks."""

import json
import time
from types import SimpleNamespace

import pytest

import desim
from desim import Scenario, Team
from desim.study.workers.workers import InProcess
from desim.view.pages.playground import Playground
from desim.view.pages.widget import PlayWidget
from tests.view.browser import in_chromium

SMALL = Scenario(name="small", team=Team(count=5, speeds=1.2), horizon=1.0)


@pytest.fixture
def widget(monkeypatch):
    """Return a widget and the messages that it sends."""
    made, sent = PlayWidget(SMALL, workers=InProcess()), []
    monkeypatch.setattr(made, "send", sent.append)
    return made, sent


def asked(widget, number, what, **body):
    widget._hear(widget, {"number": number, "what": what, "body": body}, [])


def until(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.slow
def test_a_scenario_makes_its_widget():
    made = desim.play(SMALL)
    assert isinstance(made, PlayWidget)
    assert made.name == "small"
    assert desim.play(SMALL)._session.workers is made._session.workers, "one set of processes for all"


@pytest.mark.slow
def test_a_request_is_answered_with_its_number(widget):
    made, sent = widget
    asked(made, 7, "run", now=["team.count=4"], pinned=[])
    until(lambda: sent)
    (told,) = sent
    assert (told["number"], told["isLast"]) == (7, True)
    assert told["answer"] == Playground(made._session.playground.base, None).answer(["team.count=4"], [])
    assert "page" in told["answer"]


def test_a_message_of_the_page_is_heard(widget):
    made, sent = widget
    made._handle_custom_msg({"number": 7, "what": "cancel", "body": 3}, [])
    assert sent == [{"number": 7, "error": "the request is malformed"}]


def test_each_request_asks_the_session_for_what_it_says(widget, monkeypatch):
    made, sent = widget
    asked_for = []

    def answering(kind, answer):
        return lambda *arguments: asked_for.append((kind, *arguments)) or answer

    answers = {"run": {"page": "p"}, "save": {"folder": "f"}, "cancel": None, "compare": iter([{"done": 1}])}
    session = SimpleNamespace(**{kind: answering(kind, answer) for kind, answer in answers.items()})
    monkeypatch.setattr(made, "_session", session)
    for number, kind in enumerate(("run", "save", "cancel", "seeds")):
        made._answer(str(number), kind, {"now": ["a=1"], "pinned": None, "page": "first", "count": 3})
    assert asked_for == [
        ("run", ["a=1"], None, "first"),
        ("save", ["a=1"]),
        ("cancel", "first"),
        ("compare", ["a=1"], None, 3, "first"),
    ]
    assert [(told["number"], told["answer"], told["isLast"]) for told in sent] == [
        ("0", {"page": "p"}, True),
        ("1", {"folder": "f"}, True),
        ("2", {}, True),
        ("3", {"done": 1}, False),
        ("3", {}, True),
    ]


@pytest.mark.slow
def test_a_comparison_is_told_pair_by_pair_and_can_be_cancelled(widget):
    made, sent = widget
    asked(made, 1, "seeds", now=["team.count=4"], pinned=[], count=3)
    until(lambda: sent and sent[-1]["isLast"])
    assert [each["answer"]["done"] for each in sent[:-1]] == [1, 2, 3]
    sent.clear()
    asked(made, 2, "seeds", now=["team.count=4"], pinned=[], count=1000)
    until(lambda: len(sent) > 1)
    asked(made, 3, "cancel", now=[])
    until(lambda: any(each["isLast"] and each["number"] == 2 for each in sent))
    assert len(sent) < 1000


@pytest.mark.slow
def test_two_views_of_a_widget_compare_independently(widget):
    made, sent = widget
    asked(made, 1, "seeds", now=["team.count=4"], pinned=[], count=10, page="first")
    until(lambda: sent)
    asked(made, 2, "cancel", now=[], page="second")
    until(lambda: any(each["isLast"] and each["number"] == 1 for each in sent))
    assert sum(each["number"] == 1 for each in sent) == 11


def test_requests_of_another_form_and_wrong_ones_have_an_error(widget):
    made, sent = widget
    asked(made, 1, "run", now="team.count=4")
    assert sent == [{"number": 1, "error": "the request is malformed"}]
    sent.clear()
    asked(made, 2, "seeds", now=["team.count=0"], pinned=[], count=1)
    until(lambda: sent and sent[-1]["isLast"])
    assert [(each["number"], each["isLast"]) for each in sent] == [(2, False), (2, True)]
    assert "team.count" in sent[0]["answer"]["error"]


PAGE = """<!doctype html><html><head><title>notebook</title><link rel="icon" href="data:,"><style>{style}</style></head>
<body><div id="cell"></div><script type="module">
{script}
const sent = [], hears = [];
const send = each => sent.push(each), on = (_, hear) => hears.push(hear);
const remove = widget.render({{ model: {{ get: () => "small", send, on, off: () => {{}} }}, el: cell }});
Object.assign(window, {{ sent, remove, tell: each => hears.forEach(hear => hear(each)) }});
</script></body></html>
"""


@in_chromium
@pytest.mark.whole
def test_the_page_in_a_cell_asks_the_kernel_and_shows_its_answers(widget, browser, tmp_path):
    made, sent = widget
    script = made._esm.replace("export default", "const widget =")
    (tmp_path / "cell.html").write_text(PAGE.format(script=script, style=made._css))
    browser.open(tmp_path / "cell.html", 1280, 900)

    def answer_all():
        """Pass on the requests of the page to the kernel, and its answers to the page."""
        browser.until("sent.length > 0")
        for request in browser.value("sent.splice(0)"):
            sent.clear()
            made._hear(made, request, [])
            until(lambda: sent and sent[-1]["isLast"])
            for each in sent:
                browser.value(f"tell({json.dumps(each)})")

    answer_all()
    browser.until("cell.play.runs === 1")
    assert browser.value("cell.querySelectorAll('[data-key]').length") > 5
    browser.value("cell.play.change('team.count', '4')")
    answer_all()
    browser.until("cell.play.runs === 2")
    assert browser.value("cell.play.replay.players.length") == 5  # four pursuers and the evader
    browser.value("cell.play.change('team.count', '5')")
    browser.until("sent.length > 0")
    (request,) = browser.value("sent.splice(0)")
    browser.value(f"tell({json.dumps({'number': request['number'], 'error': 'wrong form'})})")
    browser.until("cell.querySelector('.wrong').textContent === 'No answer: wrong form'")
    browser.value("remove()")
    assert browser.value("cell.childElementCount") == 0
    assert browser.errors == []
    assert [each for each in browser.requests if not each.startswith(("file:", "data:", "about:"))] == []


def test_a_widget_has_the_scenario_and_the_limit_of_the_call(monkeypatch):
    monkeypatch.setattr("desim.view.pages.widget.PlayWidget", lambda *given: given)
    assert desim.play(SMALL, 7.0) == (SMALL, 7.0)
