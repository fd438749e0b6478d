"""The part of the front page that runs examples, in a browser whose Python is a stand-in: CPython behind a server.

The script, the worker and what desim answers are those of the site. Only Pyodide is not: it is not on this machine.
"""

import json
import re
import sys
import threading
import zipfile
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from desim import examples, load, run, summary
from desim.view.pages.in_browser import answer_as_json
from desim.view.pages.replay import replay_page
from tests.view.browser import in_chromium, page

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))

import trial  # noqa: E402  it lies in the folder of the documentation

STAND_IN = """
export async function loadPyodide() {
  const answer_as_json = (name, changes) => {
    const request = new XMLHttpRequest();
    request.open("POST", "/python", false);
    request.send(JSON.stringify([name, changes]));
    if (request.status !== 200) throw new Error(request.responseText);
    return request.responseText;
  };
  const lockfile = { packages: { networkx: { file_name: "networkx.whl" } } };
  const loadPackage = async names => {
    if (!names.includes(new URL("/pyodide/networkx.whl", location).href)) throw new Error(names);
  };
  return { lockfile, loadPackage, unpackArchive() {}, runPython() {}, pyimport: () => ({ answer_as_json }) };
}
"""
BROKEN = r"""
export async function loadPyodide() {
  throw new Error("Traceback:\n  import numpy\nModuleNotFoundError: No module named 'numpy'\nLoad it.\nSee /advice.");
}
"""
"""A Pyodide without numpy, with the words of Pyodide 314."""
SHORT = "horizon=2.0"
REPLAY = "document.querySelector('iframe').contentWindow.replay"


class Handler(SimpleHTTPRequestHandler):
    """Serves the files of a folder, and runs of desim."""

    def do_POST(self):
        name, changes = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.asked.append((name, changes))
        content = answer_as_json(name, [SHORT, *changes]).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_):
        """Print nothing."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Yield the server of a front page, with the recorded replays of the examples."""
    folder = tmp_path_factory.mktemp("site")
    (part,) = re.findall(r'```\{raw\} html\n(<div id="try".*?)```', (DOCS / "index.md").read_text(), re.DOTALL)
    style = (DOCS / "_static" / "desim.css").read_text()
    head = f'<meta charset="utf-8"><link rel="icon" href="data:,"><style>{style}</style>'
    head += '<script src="_static/try.js"></script>'
    for name, pyodide in (("index", "/pyodide/"), ("offline", "/nowhere/"), ("broken", "/broken/")):
        marked = part.replace('id="try"', f'id="try" data-pyodide="{pyodide}"')
        (folder / f"{name}.html").write_text(f"<!doctype html><html lang=en><head>{head}</head><body>{marked}</body>")
    for file in ("try.js", "try_worker.js"):
        put(folder / "_static" / file, (DOCS / "_static" / file).read_text())
    put(folder / "pyodide" / "pyodide.mjs", STAND_IN)
    put(folder / "broken" / "pyodide.mjs", BROKEN)
    put(folder / "try" / "examples.json", json.dumps(trial.examples(DOCS)))
    put(folder / "try" / "desim.zip", "an archive")
    for name in trial.examples(DOCS):
        short = run(load(examples()[name], [SHORT, "record.messages=true", "record.trajectory=0.1"]))
        put(folder / "gallery" / "replays" / f"{name}.html", replay_page(short))
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=folder))
    server.asked = []
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def put(path, text):
    """Write a file and its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def move(tab, part, value):
    """Move a slider, and let it go."""
    tab.value(
        f"(() => {{ const slider = document.querySelector('[data-part={part}]'); slider.value = {value};"
        " slider.dispatchEvent(new Event('input')); slider.dispatchEvent(new Event('change')); })()"
    )


def text(part):
    """Return the script that gives the text of a part of the page."""
    return f"document.querySelector('[data-part={part}]').textContent"


@in_chromium
@pytest.mark.slow
def test_moving_a_slider_runs_the_example_and_shows_its_replay_and_its_file(site):
    address = f"http://127.0.0.1:{site.server_port}/index.html"
    with page() as tab:
        tab.visit(address)
        tab.until(f"{text('status')}.includes('recorded')")
        assert "gallery/replays/relay.html" in tab.value("document.querySelector('iframe').src")
        tab.until(f"{REPLAY}?.frames > 0")
        assert tab.value(f"{REPLAY}.end") == 2.0
        assert tab.value(text("command")) == "desim examples relay\ndesim replay relay.toml"
        move(tab, "latency", 0.3)
        tab.until(f"{text('status')}.startsWith('Run here:')")
        move(tab, "loss", 0.25)
        tab.until(f"{text('command')}.includes('network.loss=0.25')")
        assert site.asked[-1] == ("relay", ["network.latency=0.3", "network.loss=0.25"])
        changes = [SHORT, "network.latency=0.3", "network.loss=0.25"]
        measured = summary(run(load(examples()["relay"], changes)))
        assert f"active time {measured.active_time:.3f} s" in tab.value(text("status"))
        assert "latency = 0.3" in tab.value(text("file"))
        assert tab.value(text("command")) == f"desim run relay.toml {' '.join(f'--set {change}' for change in changes)}"
        assert "<title>relay" in tab.value("document.querySelector('iframe').srcdoc")
        tab.value("document.querySelector('[data-part=reset]').click()")
        assert tab.value("document.querySelector('iframe').hasAttribute('srcdoc')") is False
        assert tab.errors == []


@in_chromium
@pytest.mark.slow
def test_without_python_the_recorded_run_and_a_command_are_shown(site):
    with page() as tab:
        tab.visit(f"http://127.0.0.1:{site.server_port}/offline.html")
        tab.until(f"{text('status')}.includes('recorded')")
        move(tab, "latency", 0.3)
        tab.until(f"{text('status')}.startsWith('This page cannot run it')")
        assert "gallery/replays/relay.html" in tab.value("document.querySelector('iframe').src")
        assert tab.value(text("command")) == ("desim examples relay\ndesim replay relay.toml --set network.latency=0.3")
        tab.value("(() => { const c = document.querySelector('select'); c.value = 'faults'; c.onchange(); })()")
        assert "gallery/replays/faults.html" in tab.value("document.querySelector('iframe').src")


@in_chromium
@pytest.mark.slow
def test_the_reason_why_python_fails_is_its_exception(site):
    with page() as tab:
        tab.visit(f"http://127.0.0.1:{site.server_port}/broken.html")
        tab.until(f"{text('status')}.includes('recorded')")
        move(tab, "latency", 0.3)
        tab.until(f"{text('status')}.startsWith('This page cannot run it')")
        assert "cannot run it: ModuleNotFoundError: No module named 'numpy'. The" in tab.value(text("status"))


@in_chromium
@pytest.mark.slow
def test_a_front_page_without_its_examples_says_so_and_shows_the_recorded_run(site):
    (folder,) = site.RequestHandlerClass.keywords.values()
    text_of_page = (folder / "index.html").read_text()
    put(folder / "bare.html", text_of_page.replace("try/examples.json", "nowhere.json"))
    with page() as tab:
        tab.visit(f"http://127.0.0.1:{site.server_port}/bare.html")
        tab.until(f"{text('status')}.includes('did not load: open it again, or run desim play relay.toml')")
        tab.until(f"{REPLAY}?.frames > 0")
        assert tab.value("document.querySelector('[data-part=controls]').offsetHeight") == 0
        tab.open(folder / "index.html")
        tab.until(f"{text('status')}.includes('opened as a file only shows this run: serve its folder')")


def test_each_example_has_the_text_of_its_file_and_the_address_of_its_recorded_run():
    offered = trial.examples(DOCS)
    assert {name: example["toml"] for name, example in offered.items()} == {
        name: examples()[name].read_text(encoding="utf-8") for name in offered
    }
    assert offered["relay"]["replay"] == "gallery/replays/relay.html"
    assert all(example["title"] for example in offered.values())


@pytest.mark.slow
def test_the_archive_has_all_that_a_run_reads(tmp_path):
    """Code, templates, scripts and the examples; no figures, and the same bytes each time."""
    trial.write_archive(tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        names = set(archive.namelist())
    needed = ("desim/__init__.py", "protocols/local_min.py", "scenarios/relay.toml", "simpy/core.py")
    assert {*needed, "desim/view/pages/replay.html", "desim/view/pages/replay_run.js"} <= names
    assert any(re.fullmatch(r"pursuit_desim-.*\.dist-info/METADATA", name) for name in names)
    assert not [name for name in names if name.endswith((".svg", ".png", ".pyc"))]
    assert (tmp_path / "a.zip").stat().st_size < 2_000_000
