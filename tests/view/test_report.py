"""The report: the page tells what the store has, and a browser shows it without asking for anything."""

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from itertools import product
from math import inf
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from desim import Scenario, provenance
from desim.analysis.metrics import summary
from desim.analysis.tables import with_half_width
from desim.cli.many import merge
from desim.cli.report import report as command
from desim.scenario import Team
from desim.simulation import run
from desim.study.explain import Variants
from desim.study.result import SHOWN
from desim.study.store import Row, Store
from desim.study.sweep import Plan
from desim.study.workers import workers_for
from desim.view.report import MOST_FAILURES, Study, report
from tests.view.browser import CHROMIUM

HOSTILE = "</script><script>window.hurt = 1</script><!-- & \u2028 {{ name }} <b>Bold</b> $x_1$ </svg>"
BASE = Scenario(name=HOSTILE, horizon=0.05, team=Team(count=2))
GRID = {"horizon": [0.05, 0.1, 0.2], "network.range": [4.0, inf], "prune": ["inf", "none"]}
RUN = summary(run(BASE))


def swept(folder, grid=GRID, reps=3, failing=(), base=BASE, note=True, argv=("/a/bin/desim", "sweep", "x y.toml")):
    """Write a sweep in which the active time of configuration k is k + 0, 1, ... s; some runs of the first failed."""
    plan = Plan.of(base, grid, reps, 7)
    with Store(folder / "sweep.sqlite") as store:
        plan.enter(store)
        for (k, cell), r in product(enumerate(plan.cells), range(reps)):
            row = Row(r, 7 + r, "ok", replace(RUN, active_time=float(k + r), capture_time=None))
            if k == 0 and r < len(failing):
                row = Row(r, 7 + r, "error", None, failing[r])
            store.add(cell.key, plan.root, row)
    if note:
        made = provenance.document("sweep", base, seed=7, runs=len(plan.cells) * reps, folder=folder, reps=reps)
        provenance.write(folder, made | {"argv": list(argv), "commit": "c0ffee", "dirty": True})
    return folder


def explained(folder):
    """Write what imperfections cost, as `desim explain` does."""
    variants = Variants.of(BASE, 2, 7)
    with Store(folder / "sweep.sqlite") as store, workers_for(1) as workers:
        variants.plan.enter(store)
        found = variants.carry_out(store, workers)
    (folder / "explain.json").write_text(json.dumps(found.document()))
    provenance.write(folder, provenance.document("explain", BASE, seed=7, runs=2))
    return found


class Elements(HTMLParser):
    """What a browser would take a page for: its tags, attributes, cells and texts."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.references, self.rows, self.texts = [], [], [], [], []
        self._open = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.tags.append(tag)
        self.ids += [given["id"]] if "id" in given else []
        for key, value in given.items():
            self.references += re.findall(r"url\(#([^)]*)\)", value or "") + (
                [value] if key in {"href", "src", "xlink:href", "srcset", "action"} else []
            )
        self._open = tag
        if tag == "tr":
            self.rows.append([])
        elif tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        self._open = None if tag != "wbr" else self._open

    def handle_data(self, data):
        self.texts.append(data)
        if self._open in {"td", "th", "wbr"}:
            self.rows[-1][-1] += data


def page_of(folder):
    return report(Study.read(folder))


# What the page holds.


def test_the_tables_are_those_of_the_result(tmp_path):
    """The shown metrics in full, and the mean of 0, 1, 2 s of the first configuration: 1 +- 4.303 / sqrt(3) = 2.484."""
    study = Study.read(swept(tmp_path))
    rows = Elements(report(study)).rows
    for _, table in study.result.tables(SHOWN):
        for row in table:
            assert [cell.replace("+-", "±") for cell in row] in rows
    assert rows[1][:7] == ["0.05", "4", "inf", "3", "0.0% (0.0% .. 56.1%)", "1.000 ± 2.484", "-"]


def test_the_wide_table_has_a_row_per_metric_that_was_measured(tmp_path):
    study = Study.read(swept(tmp_path))
    rows = {row[0]: row[1:] for row in Elements(report(study)).rows if len(row) == 13}
    expected = [with_half_width(each, 3).replace("+-", "±") for each in study.result.estimates("end_time")]
    assert rows["end time, s"] == expected
    assert "capture time, s" not in rows
    assert "captured" in rows


def test_parameters_are_the_swept_keys_and_the_rest_is_fixed(tmp_path):
    study = Study.read(swept(tmp_path))
    assert study.parameters == {
        "horizon": ["0.05", "0.1", "0.2"],
        "network.range": ["4", "inf"],
        "prune": ["inf", "none"],
    }
    assert study.fixed["team.count"] == "2"
    assert study.fixed["team.box"] == "[0.0, 20.0]"
    assert not {"horizon", "network.range", "prune", "seed", "name"} & study.fixed.keys()
    texts = Elements(report(study)).texts
    assert texts[texts.index("network.range") + 1 :][:2] == ["4, inf ", "m"]
    assert texts[texts.index("team.count") + 1] == "2"


def test_a_swept_table_is_not_fixed(tmp_path):
    """The key that is swept is `network.loss`; none of what is below it is the same in all configurations."""
    loss = [{"kind": "bernoulli", "p": 0.1}, {"kind": "bernoulli", "p": 0.2}]
    study = Study.read(swept(tmp_path, {"network.loss": loss}))
    assert not [key for key in study.fixed if key.startswith("network.loss")]
    assert "network.latency.kind" in study.fixed


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["/a/bin/desim", "sweep", "x y.toml", "--set", "a=[1, 2]"], "desim sweep 'x y.toml' --set 'a=[1, 2]'"),
        (["/a/desim/__main__.py", "sweep", "x.toml"], "python -m desim sweep x.toml"),
        (["my.py", "--fast"], "my.py --fast"),
    ],
)
def test_the_command_is_that_of_run_json(argv, expected, tmp_path):
    texts = Elements(page_of(swept(tmp_path, argv=argv))).texts
    assert expected in texts
    assert shlex.split(expected)[-1] == argv[-1]


def test_all_commands_that_made_it_are_told_and_where_they_were_typed(tmp_path):
    made = provenance.read(swept(tmp_path) / "run.json")
    earlier = {"argv": ["desim", "sweep", "first.toml"], "cwd": "/a b"}
    provenance.write(tmp_path, made | {"earlier": [earlier, earlier], "cwd": "/c", "runs": 99})
    elements = Elements(page_of(tmp_path))
    told = "cd '/a b'\ndesim sweep first.toml\ndesim sweep first.toml\ncd /c\ndesim sweep 'x y.toml'"
    assert told in elements.texts
    assert any(", 36 runs" in each for each in elements.texts), "nobody knows of how many"


def test_pictures_are_as_large_as_in_print_so_that_all_type_is_of_one_size(tmp_path):
    """96 px to the inch; a width of 72 in the view box is an inch."""
    text = page_of(swept(tmp_path))
    widths = [int(each) for each in re.findall(r'style="--width: (\d+)px"', text)]
    boxes = [float(each) for each in re.findall(r'viewBox="0 0 ([\d.]+) ', text)]
    assert len(widths) == 2
    assert widths == [pytest.approx(each * 96 / 72, abs=1) for each in boxes]


def test_what_it_was_made_with_is_told(tmp_path):
    made = provenance.read(swept(tmp_path) / "run.json")
    texts = Elements(page_of(tmp_path)).texts
    assert texts[texts.index("commit") + 1] == "c0ffee with changes"
    for name, each in made["versions"].items():
        assert texts[texts.index(f"version of {name}") + 1] == (each or "unknown")
    for name, each in made["platform"].items():
        assert texts[texts.index(name) + 1] == each
    assert made["code"] in texts


def test_a_store_without_run_json_says_so(tmp_path):
    """The scenario is then that of the store."""
    study = Study.read(swept(tmp_path, note=False))
    assert study.fixed["team.count"] == "2"
    assert any("has no run.json" in each for each in Elements(report(study)).texts)


def test_failed_runs_are_shown_with_their_tracebacks_each_once(tmp_path):
    trace = 'Traceback (most recent call last):\n  File "<x>", line 1\nValueError: <b>'
    swept(tmp_path, failing=[trace, trace, trace.replace("<b>", "other")])
    elements = Elements(page_of(tmp_path))
    assert elements.texts.count(trace) == 1
    assert "2 × ValueError: <b>" in elements.texts
    assert "1 × ValueError: other" in elements.texts
    assert "horizon = 0.05, network.range = 4, prune = inf; seed 8 (error)" in elements.texts
    assert "3 failed" in elements.texts
    assert "b" not in elements.tags


def test_of_many_different_failures_some_are_shown(tmp_path):
    """One page of a sweep that failed everywhere should still open."""
    swept(tmp_path, {"horizon": [0.05]}, reps=25, failing=[f"ValueError: {k}" for k in range(25)])
    elements = Elements(page_of(tmp_path))
    assert sum("× ValueError" in each for each in elements.texts) == MOST_FAILURES
    assert "and 5 other tracebacks" in elements.texts
    assert "svg" not in elements.tags


@pytest.mark.parametrize(
    ("more", "said"), [({}, "36 of 99 runs"), ({"argv": ["desim", "--until", "regret:1"]}, ", 36 runs")]
)
def test_a_sweep_that_is_not_over_says_how_much_of_it_is_there(more, said, tmp_path):
    made = provenance.read(swept(tmp_path) / "run.json")
    provenance.write(tmp_path, made | {"runs": 99} | more)
    assert any(said in each for each in Elements(page_of(tmp_path)).texts)


@pytest.mark.parametrize(
    ("grid", "titles"),
    [
        (GRID, ["multiples-title", "phase-title"]),
        ({"horizon": [0.05, 0.1], "prune": ["inf", "none"]}, ["multiples-title"]),
        ({"prune": ["inf", "none"]}, ["multiples-title"]),
    ],
    ids=["two numbers", "one number", "none"],
)
def test_there_is_a_phase_diagram_if_two_numbers_are_swept(grid, titles, tmp_path):
    elements = Elements(page_of(swept(tmp_path, grid)))
    assert elements.tags.count("svg") == len(titles)
    assert [each for each in elements.ids if each.endswith("-title")] == titles


def test_costs_of_imperfections_are_shown_with_their_waterfall(tmp_path):
    """Of a folder that `desim explain` wrote, and of one of a sweep in which such a folder lies."""
    swept(tmp_path)
    (tmp_path / "explain").mkdir()
    found = explained(tmp_path / "explain")
    for folder, pictures in ((tmp_path, 3), (tmp_path / "explain", 2)):
        elements = Elements(page_of(folder))
        for row in found.rows():
            assert [cell.replace("+-", "±") for cell in row] in elements.rows
        assert elements.tags.count("svg") == pictures
        assert "waterfall-title" in elements.ids
    assert "The scenario as it is" in elements.texts


def test_all_ids_differ_and_all_references_lead_somewhere(tmp_path):
    swept(tmp_path)
    explained_in = tmp_path / "explain"
    explained_in.mkdir()
    explained(explained_in)
    elements = Elements(page_of(tmp_path))
    assert len(elements.ids) == len(set(elements.ids)) > 50
    inner = [each.removeprefix("#") for each in elements.references if each != "data:,"]
    assert len(inner) > 50
    assert set(inner) <= set(elements.ids)


def test_nothing_in_the_page_is_active_or_lies_elsewhere(tmp_path):
    text = page_of(swept(tmp_path))
    elements = Elements(text)
    assert not {"script", "iframe", "object", "image", "img", "foreignobject", "base", "form"} & set(elements.tags)
    assert elements.tags.count("link") == elements.tags.count("style") == 1
    assert "<?xml" not in text
    assert "<!DOCTYPE svg" not in text
    assert not re.findall(r"@import|https?:", text.replace(HOSTILE, ""))
    for svg in re.findall(r"<svg.*?</svg>", text, re.S):
        ElementTree.fromstring(svg)
        assert "#000000" not in svg


def test_a_hostile_name_is_text(tmp_path):
    elements = Elements(page_of(swept(tmp_path)))
    assert HOSTILE in elements.texts
    assert f"{HOSTILE}: report" in elements.texts


def test_a_hostile_key_and_value_are_text_also_in_pictures(tmp_path):
    """Settings of grids in a script may be of any text; those of the store are read as they are."""
    swept(tmp_path)
    import sqlite3

    with sqlite3.connect(tmp_path / "sweep.sqlite") as database:
        for key, settings in database.execute("SELECT configuration, settings FROM configurations").fetchall():
            changed = json.loads(settings)
            changed["prune"] = f"{changed['prune']}<script>hurt()</script> url(#x)"
            database.execute(
                "UPDATE configurations SET settings = ? WHERE configuration = ?", (json.dumps(changed), key)
            )
    database.close()
    elements = Elements(page_of(tmp_path))
    assert "script" not in elements.tags
    assert [each for each in elements.texts if "prune = inf<script>hurt()</script> url(#x)" in each]


@pytest.mark.slow
def test_the_same_store_gives_the_same_bytes_in_another_process(tmp_path):
    swept(tmp_path)
    explained_in = tmp_path / "explain"
    explained_in.mkdir()
    explained(explained_in)
    program = (
        "import sys; from pathlib import Path; from desim.view.report import Study, report;"
        "sys.stdout.buffer.write(report(Study.read(Path(sys.argv[1]))).encode())"
    )
    pages = [
        subprocess.run(
            [sys.executable, "-c", program, tmp_path],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    ]
    assert pages[0] == pages[1] == page_of(tmp_path).encode()


# The command.


def invoke(*arguments):
    return CliRunner().invoke(command, [*map(str, arguments)])


def test_the_command_writes_the_page(tmp_path):
    done = invoke(swept(tmp_path))
    assert done.exit_code == 0, done.output
    assert (tmp_path / "report.html").read_bytes() == page_of(tmp_path).encode()
    assert done.stdout.startswith(f"{tmp_path / 'report.html'}: 12 configurations, 36 runs, ")
    other = tmp_path / "other.html"
    assert invoke(tmp_path, "-o", other).exit_code == 0
    assert other.read_bytes() == (tmp_path / "report.html").read_bytes()


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (lambda folder: (folder / "sweep.sqlite").unlink(), "sweep.sqlite: there is no such store"),
        (lambda folder: (folder / "sweep.sqlite").write_text("no" * 999), "file is not a database"),
        (lambda folder: (folder / "run.json").write_text("{"), "run.json:1: not JSON"),
        (lambda folder: (folder / "explain.json").write_text("{"), "explain.json: "),
        (lambda folder: (folder / "explain.json").write_text("[]"), "explain.json: is not of an explanation"),
        (lambda folder: (folder / "explain.json").write_text('{"costs": {}}'), "is not of an explanation: KeyError"),
    ],
    ids=["no store", "no database", "bad run.json", "no JSON", "a list", "keys missing"],
)
def test_a_folder_that_is_not_of_a_sweep_is_refused(prepare, said, tmp_path):
    prepare(swept(tmp_path))
    done = invoke(tmp_path)
    assert done.exit_code == 2
    assert said in done.stderr
    assert "Traceback" not in done.output


def test_a_folder_with_parts_of_a_sweep_says_how_to_put_them_together(tmp_path):
    (swept(tmp_path) / "sweep.sqlite").rename(tmp_path / "sweep.1-of-1.sqlite")
    done = invoke(tmp_path)
    assert done.exit_code == 2
    assert (
        f"holds parts of a sweep (sweep.1-of-1.sqlite); put them together first: desim merge {tmp_path} -o"
        in done.stderr
    )
    assert CliRunner().invoke(merge, shlex.split(done.stderr.split("desim merge ")[1])).exit_code == 0
    assert invoke(tmp_path).exit_code == 0


def test_a_page_of_another_kind_is_refused(tmp_path):
    done = invoke(swept(tmp_path), "-o", tmp_path / "x.pdf")
    assert done.exit_code == 2
    assert "x.pdf: should end in .html, or have no suffix, got .pdf" in done.stderr
    assert invoke(tmp_path, "-o", tmp_path / "v1.2").exit_code == 0
    assert (tmp_path / "v1.2.html").exists()


def test_without_what_it_needs_the_command_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    done = invoke(swept(tmp_path))
    assert done.exit_code == 2
    assert "a report needs jinja2: pip install" in done.stderr


def test_a_page_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "no").touch()
    done = invoke(swept(tmp_path), "-o", tmp_path / "no" / "x.html")
    assert done.exit_code == 2
    assert "x.html: cannot be written: " in done.stderr


# In a browser.

in_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="NO BROWSER, so the report was NOT looked at: apt-get install chromium"
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Return a page with everything in it."""
    folder = swept(tmp_path_factory.mktemp("report"), failing=["Traceback:\nValueError: <b>"])
    (folder / "explain").mkdir()
    explained(folder / "explain")
    (folder / "report.html").write_text(page_of(folder), encoding="utf-8")
    return folder / "report.html"


@pytest.fixture
def shown(browser, path):
    """Return what opens the page, and judge in the end that nothing went wrong and nothing left the page."""

    def show(**window):
        browser.open(path, **window)
        return browser

    yield show
    assert browser.errors == []
    assert browser.requests == [path.resolve().as_uri()]


@in_chromium
def test_a_browser_shows_a_hostile_name_as_text(shown):
    opened = shown()
    assert opened.value("document.querySelector('h1').textContent") == HOSTILE
    assert opened.value("document.title").startswith("</script><script>window.hurt")
    assert opened.value("window.hurt") is None
    assert opened.value("document.scripts.length") == 0
    assert opened.value("document.querySelectorAll('svg').length") == 3
    assert opened.value("document.querySelectorAll('main > section').length") == 7


@in_chromium
@pytest.mark.parametrize(("width", "theme"), [(1280, "light"), (1280, "dark"), (360, "light")])
def test_a_page_fits_its_window(width, theme, shown):
    opened = shown(width=width, theme=theme)
    opened.value("document.querySelectorAll('details').forEach(each => each.open = true)")
    assert opened.value("document.documentElement.scrollWidth") <= width


CONTRAST = """(() => {
  const linear = c => (c /= 255) <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const light = text => {
    const [r, g, b] = text.match(/[\\d.]+/g).map(Number);
    return 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  };
  const card = light(getComputedStyle(document.querySelector("section")).backgroundColor);
  return [...document.querySelectorAll("h1, h2, td, th, dt, dd, caption, summary, pre, .bad, svg text")]
    .filter(each => !each.closest(".phase") && each.textContent.trim())
    .map(each => light(each.matches("svg *") ? getComputedStyle(each).fill : getComputedStyle(each).color))
    .map(each => (Math.max(each, card) + 0.05) / (Math.min(each, card) + 0.05))
    .reduce((a, b) => Math.min(a, b));
})()"""
"""The least contrast of text with the ground on which it stands (WCAG 2.1: should be at least 4.5)."""


@in_chromium
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_can_be_read_on_light_and_dark(theme, shown):
    assert shown(theme=theme).value(CONTRAST) >= 4.5


@in_chromium
def test_on_paper_it_is_light_and_no_wider_than_the_paper(shown):
    """A4 at 96 px/in with margins: 718 px."""
    opened = shown(theme="dark", width=718)
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    opened.tell("Emulation.setEmulatedMedia", media="print", features=dark)
    try:
        assert opened.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert opened.value(CONTRAST) >= 4.5
        assert opened.value("document.documentElement.scrollWidth") <= 718
    finally:
        opened.tell("Emulation.setEmulatedMedia", media="")
