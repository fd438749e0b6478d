"""The report: the page has the data of the store, and a browser shows it without any requests."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import product
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from desim import Scenario
from desim.analysis.measuring import summary
from desim.analysis.metrics import METRICS, words
from desim.cli.merge import merge
from desim.cli.pages import report as command
from desim.results import provenance
from desim.scenario.players import Team
from desim.study.ablation.explain import Variants
from desim.study.results.costs import Saving
from desim.study.store.history import runs_requested, shell_lines
from desim.study.store.run_table import Row
from desim.study.store.store import Store
from desim.study.sweeps.sweep_plan import SweepPlan
from desim.study.workers.executors import workers_for
from desim.view.pages.report import MAX_FAILURES, Study, _greatest_cost, findings, report
from tests.golden import golden
from tests.study.by_hand import explanation
from tests.summaries import changed
from tests.view.browser import in_chromium
from tests.view.by_hand import history
from tests.view.elements import Elements

HOSTILE = "</script><script>window.hurt = 1</script><!-- & \u2028 {{ name }} <b>Bold</b> $x_1$ </svg>"
BASE = Scenario(name=HOSTILE, horizon=0.05, team=Team(count=2))
GRID = {"horizon": [0.05, 0.1, 0.2], "network.range": [4.0, inf], "prune": ["inf", "none"]}
ONE = {"prune": ["none"]}
RUN = summary(history())
TRACE = 'Traceback (most recent call last):\n  File "<x>", line 1\nValueError: <b>'
COMMAND = ("/a b", ["/a/bin/desim", "sweep", "x y.toml"])
"""Where the command that made a sweep was typed, and its words."""
MADE = {
    **{"argv": COMMAND[1], "runs": 99, "commit": "c0ffee", "dirty": True},
    **{"versions": {"python": "3.11", "jinja2": None}, "platform": {"system": "Linux"}, "code": "5eed"},
    **{"folder": None, "unrecorded": ["protocol.x"]},
}
"""Values in run.json in place of those that depend on the machine."""


def swept(folder, grid=ONE, reps=1, failing=(), made=MADE):
    """Write a sweep in which the active time of configuration k is k + 0, 1, ... s; some runs of the first failed."""
    plan = SweepPlan.of(BASE, grid, reps, 7)
    with Store(folder / "sweep.sqlite") as store:
        plan.register(store)
        store.note_command(*COMMAND)
        for (k, cell), r in product(enumerate(plan.configurations), range(reps)):
            row = Row(r, 7 + r, "ok", changed(RUN, active_time=float(k + r), capture_time=None))
            if k == 0 and r < len(failing):
                row = Row(r, 7 + r, "error", None, failing[r])
            store.add(cell.key, plan.root, row)
    if made is not None:
        provenance.write(folder, provenance.document("sweep", BASE, seed=7, runs=1, reps=reps) | made)
    return folder


class Full(NamedTuple):
    """A page with everything in it, and what it is of."""

    study: Study
    explanation: Any
    text: str
    path: Path


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """Make the page of a sweep that was explained, too; each of its settings, as of a script, is a hostile text."""
    folder = swept(tmp_path_factory.mktemp("report"), GRID, 3, [TRACE, TRACE, TRACE.replace("<b>", "other")])
    (folder / "explain").mkdir()
    variants = Variants.of(BASE, 2, 7)
    with Store(folder / "explain" / "sweep.sqlite") as store, workers_for(1) as workers:
        variants.plan.register(store)
        store.note_command(*COMMAND)
        found = variants.carry_out(store, workers)
    (folder / "explain" / "explain.json").write_text(json.dumps(found.document()))
    provenance.write(folder / "explain", provenance.document("explain", BASE, seed=7, runs=2) | MADE)
    study = Study.read(folder)
    hurting = [
        replace(each, settings=each.settings | {"prune": f"{each.settings['prune']}<script>hurt()</script> url(#x)"})
        for each in study.result.groups
    ]
    study = replace(study, result=replace(study.result, groups=tuple(hurting)))
    text = report(study)
    (folder / "report.html").write_text(text, encoding="utf-8")
    return Full(study, found, text, folder / "report.html")


# What the page holds.


def test_the_text_of_a_page_is_golden(full):
    """The mean of 0, 1, 2 s of the second configuration: 2 +- 4.303 / sqrt(3) = 2.484. Two of three failed alike.

    Of what is the same in all configurations, which comes from the scenario, and of the costs, some lines are left out.
    """
    fixed = {key: each for key, each in full.study.fixed.items() if key.startswith("team.")}
    lines = Elements(full.text).lines
    begin = lines.index("h2: Cost of each imperfection")
    end = lines.index("h2: Means and 95 % intervals")
    said = {f"dt: {key}" for key in full.study.fixed.keys() - fixed.keys()}
    kept = [k for k in range(len(lines)) if lines[k] not in said and not (k and lines[k - 1] in said)]
    assert full.text.lstrip().startswith("<!doctype html>\n")
    assert full.text.endswith("</html>\n")
    golden("report.txt", "\n".join(lines[k] for k in kept if not begin < k < end) + "\n")


def test_costs_of_imperfections_are_shown(full):
    rows = Elements(full.text).rows
    for row in full.explanation.rows():
        assert [cell.replace("+-", "±") for cell in row] in rows


@pytest.fixture(scope="module")
def explained(full):
    """Return the page of the explanation alone."""
    return report(Study.read(full.path.parent / "explain"))


@pytest.mark.whole
def test_the_page_of_an_explanation_alone_is_of_the_scenario_as_it_is(explained):
    elements = Elements(explained)
    assert elements.tags.count("svg") == 7, "two costs, five metrics"
    assert {"waterfall-title", "multiples-title"} <= set(elements.ids)
    assert "All parameters of the scenario" in elements.texts
    assert any(text.startswith("Variants of the scenario: as it is, without ") for text in elements.texts)


def test_the_variants_of_an_explanation_are_named_as_in_its_table():
    names = ("as it is", "latency", "ideal", "perfect network", "no messages at all")
    groups = [SimpleNamespace(settings={"without": name}) for name in names]
    study = Study(SimpleNamespace(keys=["without"], groups=groups), {}, None)
    words = "as it is, without latency, ideal (without all of these), perfect network, no messages at all"
    assert study.variants == words.split(", ")


# What was found.

KEYS = {"horizon": [0.05, 0.1], "prune": ["inf", "none"]}


def found_in(folder, values, grid=KEYS, seeds="common"):
    """Return what the page says was found of a sweep with these active times, a list for each configuration, s."""
    base = BASE.model_copy(update={"sweep": BASE.sweep.model_copy(update={"seeds": seeds})})
    plan = SweepPlan.of(base, grid, len(values[0]), 7)
    with Store(folder / "sweep.sqlite") as store:
        plan.register(store)
        for cell, each in zip(plan.configurations, values, strict=True):
            for r, time in enumerate(each):
                store.add(cell.key, plan.root, Row(r, 7 + r, "ok", changed(RUN, active_time=time)))
    return list(findings(Study.read(folder)))


def test_the_key_of_the_greatest_difference_is_named(tmp_path):
    """8, 9, 10 s more: 9 +- 4.303 / sqrt(3) s; the interval for the greatest of 4 is twice as wide."""
    assert found_in(tmp_path, [[1, 2, 3], [1, 2, 3], [2, 3, 4], [9, 11, 13]]) == [
        "horizon matters most: 0.1 instead of 0.05 (with prune = none) changes the active time by +9.000 +- 2.484 s "
        "(95 % interval of this one alone, 3 pairs of runs with the same seed). Of 4 paired differences, this is the "
        "greatest that is distinguishable from 0 at a level of 5 % for all 4 together (Bonferroni)."
    ]


def test_no_key_is_named_if_no_difference_can_be_told_from_0(tmp_path):
    """The only difference that is not 0 has an interval that excludes it, but not that of the greatest of four.

    0.7, 1, 1.3 s: 1 +- 4.303 * 0.1732 = 0.745 s; at 5 % / 4, the quantile is 8.860 instead of 4.303.
    """
    said = found_in(tmp_path, [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.7, 3.0, 4.3]])
    assert said == [
        "No paired difference in active time is distinguishable from 0 at a level of 5 % for all 4 together "
        "(Bonferroni); "
        "the greatest of 4 is +1.000 +- 0.745 s (95 % interval of this one alone, 3 pairs of runs with the same "
        "seed), for horizon = 0.1 instead of 0.05 (with prune = none)."
    ]


def test_the_only_paired_difference_is_not_called_the_greatest_of_one(tmp_path):
    (said,) = found_in(tmp_path, [[1.0, 2.0, 3.0], [2.0, 2.0, 2.3]], {"prune": ["none", "inf"]})
    assert said.startswith("No paired difference in active time is distinguishable from 0; the greatest is +0.100 +-")


def test_runs_are_counted_in_the_plural_if_there_should_be_several(tmp_path):
    study = replace(Study.read(swept(tmp_path, made=MADE | {"runs": 30})), commands=[COMMAND])
    (said,) = re.findall(r"<p>(1 configuration,.*?);", report(study), re.DOTALL)
    assert " ".join(said.split()) == "1 configuration, 1 of 30 runs"


def test_nothing_is_said_where_nothing_can_be_compared(tmp_path):
    (tmp_path / "one").mkdir()
    assert found_in(tmp_path / "one", [[1.0, 2.0]], {"prune": ["none"]}) == []
    assert found_in(tmp_path, [[1.0, 2.0]] * 3 + [[8.0, 9.0]], seeds="independent") == []


def test_nothing_is_said_of_costs_of_a_single_run():
    """One run has no interval; of three, the second cost is the same in each."""
    of_three = explanation()
    (name, cost), *_ = of_three.costs.items()
    of_one = {part: Saving.of([1.0]) for part in cost.parts}
    assert list(_greatest_cost(replace(of_three, costs={name: replace(cost, parts=of_one)}))) == []
    assert len(list(_greatest_cost(of_three))) == 1, "a control"


def test_no_absolute_folder_of_the_author_is_shown(tmp_path):
    trace = 'Traceback:\n  File "/home/me/p/desim/kernel/clock.py", line 1, in f\nValueError: x'
    made = MADE | {"folder": "/home/me/work"}
    page = report(Study.read(swept(tmp_path, failing=[trace], made=made)))
    assert "/home/me" not in page
    assert "/a b" not in page
    assert "desim sweep &#39;x y.toml&#39;" in page
    assert "File &#34;kernel/clock.py&#34;, line 1" in page


def test_a_swept_table_is_not_fixed(tmp_path):
    """The key that is swept is `network.loss`; none of what is below it is the same in all configurations."""
    loss = [{"kind": "bernoulli", "p": 0.1}, {"kind": "bernoulli", "p": 0.2}]
    study = Study.read(swept(tmp_path, {"network.loss": loss}))
    assert not [key for key in study.fixed if key.startswith(("network.loss", "sweep", "seed", "name"))]
    assert study.fixed["network.latency.kind"] == '"constant"'
    assert study.fixed["team.box"] == "[0.0, 20.0]"


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["/a/bin/desim", "sweep", "x y.toml", "--set", "a=[1, 2]"], "desim sweep 'x y.toml' --set 'a=[1, 2]'"),
        (["/x/desim/__main__.py", "sweep", "x.toml"], "python -m desim sweep x.toml"),
        (["my.py", "--fast"], "my.py --fast"),
        (["/home/me/my.py", "/home/you/x.toml", "-o", "/a/out/x"], "my.py x.toml -o out/x"),
        (["/a/my.py", "--set", "network.graph.file=/home/me/g.json"], "my.py --set network.graph.file=g.json"),
        (["my.py", "--set", 'file="/home/me/g.json"', "-o/home/me/x"], """my.py --set 'file="g.json"' -ox"""),
        (["my.py", "-g", "file=['/home/a/g','/home/b/h']", "1/2"], """my.py -g 'file=['"'"'g'"'"','"'"'h'"'"']' 1/2"""),
        ([], "desim"),
    ],
)
def test_the_command_is_shown_as_it_may_be_typed(argv, expected):
    assert shell_lines([("/a", argv)]) == [expected]


def test_all_commands_and_the_names_of_several_working_folders_are_listed():
    """Then it is unknown how many runs there should be, and if they go on until something is known."""
    first, more = ("/a b", ["desim", "sweep", "first.toml"]), ("/a b", ["desim", "sweep", "first.toml", "-n", "9"])
    other, until = ("/c", ["desim", "sweep", "x y.toml"]), ("/c", ["desim", "sweep", "--until", "regret:1"])
    told = ["# in the folder a b", "desim sweep first.toml", "desim sweep first.toml -n 9"]
    told += ["# in the folder c", "desim sweep 'x y.toml'"]
    assert shell_lines([first, more, other]) == told
    made = {"what": "sweep", "runs": 99}
    assert [runs_requested(made, each) for each in ([first], [first, other], [until], [])] == [99, None, None, None]
    assert runs_requested(made | {"what": "explain"}, [first]) is None


def test_pictures_are_as_large_as_in_print_so_that_all_type_is_of_one_size(full):
    """96 px to the inch; a width of 72 in the view box is an inch."""
    widths = [int(each) for each in re.findall(r'style="--width: (\d+)px"', full.text)]
    boxes = [float(each) for each in re.findall(r'viewBox="0 0 ([\d.]+) ', full.text)]
    assert len(widths) == len(boxes) == 9
    assert widths == [pytest.approx(each * 96 / 72, abs=1) for each in boxes]
    heads = re.findall(r"<svg [^>]*>", full.text)
    assert len(heads) == 9
    assert not any(re.search(r"\s(height|version)=", head) for head in heads)  # the height follows from the width


def test_each_picture_has_its_subject_as_text(full):
    labels = re.findall(r'<svg [^>]*aria-label="([^"]*)"', full.text)
    metrics = [label for label in labels if label in map(words, METRICS)]
    others = [label for label in labels if label not in metrics]
    assert (len(metrics), len(set(metrics))) == (5, 5)
    assert [label.rpartition(", ")[2] for label in others] == ["costs", "costs", "legend of the figures", "heat map"]


def test_some_of_many_failures_are_shown_and_a_missing_run_json_is_reported(tmp_path):
    """One page of a sweep that failed everywhere should still open; its scenario is that of the store."""
    study = Study.read(swept(tmp_path, reps=25, failing=[f"ValueError: {k}" for k in range(25)], made=None))
    elements = Elements(report(study))
    assert sum("× ValueError" in each for each in elements.texts) == MAX_FAILURES
    assert "and 5 other tracebacks" in elements.texts
    assert "svg" not in elements.tags
    assert study.fixed["team.count"] == "2"
    assert any("has no run.json" in each for each in elements.texts)


@pytest.mark.slow
def test_there_is_no_phase_diagram_if_one_number_is_swept(tmp_path):
    elements = Elements(report(Study.read(swept(tmp_path, {"horizon": [0.05, 0.1], "prune": ["inf", "none"]}, 2))))
    assert [each for each in elements.ids if each.endswith("-title")] == ["multiples-title"]
    assert elements.tags.count("svg") == 6


def test_all_ids_differ_and_all_references_lead_somewhere(full):
    elements = Elements(full.text)
    assert len(elements.ids) == len(set(elements.ids)) > 50
    assert [each for each in elements.ids if each.endswith("-title")] == [
        "waterfall-title", "multiples-title", "phase-title"
    ]  # fmt: skip
    inner = [each.removeprefix("#") for each in elements.references if each != "data:,"]
    assert len(inner) > 50
    assert set(inner) <= set(elements.ids)


def test_nothing_in_the_page_is_active_or_lies_elsewhere(full):
    elements = Elements(full.text)
    active = {"script", "iframe", "object", "image", "img", "foreignobject", "base", "form", "b"}
    assert not active & set(elements.tags)
    assert elements.tags.count("link") == elements.tags.count("style") == 1
    assert "<?xml" not in full.text
    assert "<!DOCTYPE svg" not in full.text
    assert not re.findall(r"@import|https?:", full.text.replace(HOSTILE, ""))
    pictures = re.findall(r"<svg.*?</svg>", full.text, re.S)
    assert len(pictures) == 9, "two costs, five metrics, their legend, a heat map"
    for svg in pictures:
        ElementTree.fromstring(svg)
        assert "#000000" not in svg


def test_hostile_names_and_settings_are_text_also_in_pictures(full):
    elements = Elements(full.text)
    assert HOSTILE in elements.texts
    assert elements.title == f"{HOSTILE}: report"
    pictures = "".join(re.findall(r"<svg.*?</svg>", full.text, re.S))
    assert "prune = inf&lt;script&gt;hurt()&lt;/script&gt; url(#x)" in pictures


@pytest.mark.whole
def test_the_same_store_gives_the_same_bytes_in_another_process(full, explained):
    program = (
        "import sys; from pathlib import Path; from desim.view.pages.report import Study, report;"
        "sys.stdout.buffer.write(report(Study.read(Path(sys.argv[1]))).encode())"
    )
    folder, environment = full.path.parent / "explain", os.environ | {"PYTHONHASHSEED": "1"}
    other = subprocess.run([sys.executable, "-c", program, folder], env=environment, stdout=-1, check=True)
    assert other.stdout == explained.encode()


# The command.


def invoke(*arguments):
    return CliRunner().invoke(command, [*map(str, arguments)])


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return swept(tmp_path_factory.mktemp("small"), failing=[TRACE])


@pytest.fixture
def folder(small, tmp_path):
    """Return a folder of a sweep of which nothing was measured, so that its page is made soon."""
    return shutil.copytree(small, tmp_path / "swept")


@pytest.mark.slow
def test_the_command_writes_the_page(folder):
    done = invoke(folder)
    assert done.exit_code == 0, done.output
    assert (folder / "report.html").read_bytes() == report(Study.read(folder)).encode()
    assert done.stdout.startswith(f"{folder / 'report.html'}: 1 configuration, 1 run, ")
    other = folder / "other.html"
    assert invoke(folder, "-o", other).exit_code == 0
    assert other.read_bytes() == (folder / "report.html").read_bytes()


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (lambda folder: (folder / "sweep.sqlite").unlink(), "sweep.sqlite: there is no such store"),
        (lambda folder: (folder / "sweep.sqlite").write_text("no" * 999), "file is not a database"),
        (lambda folder: (folder / "run.json").write_text("{"), "run.json:1: not JSON"),
        (lambda folder: (folder / "explain.json").write_text("{"), "explain.json: "),
        (lambda folder: (folder / "explain.json").write_text("[]"), "explain.json: is not an explanation"),
        (lambda folder: (folder / "explain.json").write_text('{"costs": {}}'), "is not an explanation: KeyError"),
    ],
    ids=["no store", "no database", "bad run.json", "no JSON", "a list", "keys missing"],
)
def test_a_folder_that_is_not_of_a_sweep_is_refused(prepare, said, folder):
    prepare(folder)
    done = invoke(folder)
    assert done.exit_code == 2
    assert said in done.stderr
    assert "Traceback" not in done.output


@pytest.mark.slow
def test_a_folder_with_parts_of_a_sweep_gives_an_error_that_explains_merging(folder):
    (folder / "sweep.sqlite").rename(folder / "sweep.1-of-1.sqlite")
    done = invoke(folder)
    assert done.exit_code == 2
    assert f"holds parts of a sweep (sweep.1-of-1.sqlite); merge them first: desim merge {folder} -o" in done.stderr
    assert CliRunner().invoke(merge, shlex.split(done.stderr.split("desim merge ")[1])).exit_code == 0
    assert invoke(folder).exit_code == 0


def test_a_page_of_another_kind_is_refused(folder, tmp_path):
    done = invoke(folder, "-o", tmp_path / "x.pdf")
    assert done.exit_code == 2
    assert "x.pdf: should end in .html, or have no suffix, got .pdf" in done.stderr
    assert invoke(folder, "-o", tmp_path / "v1.2").exit_code == 0
    assert (tmp_path / "v1.2.html").exists()


def test_without_its_dependencies_the_command_names_the_packages_to_install(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    done = invoke(folder)
    assert done.exit_code == 2
    assert "no report: jinja2 is missing: pip install" in done.stderr


def test_a_page_that_cannot_be_written_is_refused(folder, tmp_path):
    (tmp_path / "no").touch()
    done = invoke(folder, "-o", tmp_path / "no" / "x.html")
    assert done.exit_code == 2
    assert "x.html: cannot be written: " in done.stderr


# In a browser.


@pytest.fixture
def shown(browser, full):
    """Return what opens the page, and judge in the end that nothing went wrong and nothing left the page."""

    path = full.path

    def show(**window):
        browser.open(path, **window)
        return browser

    yield show
    assert browser.errors == []
    assert browser.requests == [path.resolve().as_uri()]


@in_chromium
@pytest.mark.slow
def test_a_browser_shows_a_hostile_name_as_text(shown):
    opened = shown()
    assert opened.value("document.querySelector('h1').textContent") == HOSTILE
    assert opened.value("document.title").startswith("</script><script>window.hurt")
    assert opened.value("window.hurt") is None
    assert opened.value("document.scripts.length") == 0
    assert opened.value("document.querySelectorAll('svg').length") == 9
    assert opened.value("document.querySelectorAll('main > section').length") == 8


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize(("width", "theme"), [(1280, "light"), (1280, "dark"), (360, "light")])
def test_a_page_fits_its_window(width, theme, shown):
    opened = shown(width=width, theme=theme)
    opened.value("document.querySelectorAll('details').forEach(each => each.open = true)")
    assert opened.value("document.documentElement.scrollWidth") <= width
    assert opened.value(
        "[...document.querySelectorAll('svg')].every(each => each.getBoundingClientRect().right <= innerWidth)"
    )


CONTRAST = """(() => {
  const linear = c => (c /= 255) <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const light = text => {
    const [r, g, b] = text.match(/[\\d.]+/g).map(Number);
    return 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  };
  const card = light(getComputedStyle(document.querySelector("section")).backgroundColor);
  return [...document.querySelectorAll("h1, h2, td, th, dt, dd, p, summary, pre, .bad, svg text")]
    .filter(each => !each.closest(".phase") && each.textContent.trim())
    .map(each => light(each.matches("svg *") ? getComputedStyle(each).fill : getComputedStyle(each).color))
    .map(each => (Math.max(each, card) + 0.05) / (Math.min(each, card) + 0.05))
    .reduce((a, b) => Math.min(a, b));
})()"""
"""The least contrast of text with the ground on which it stands (WCAG 2.1: should be at least 4.5)."""


@in_chromium
@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_can_be_read_on_light_and_dark(theme, shown):
    assert shown(theme=theme).value(CONTRAST) >= 4.5


@in_chromium
@pytest.mark.slow
def test_on_paper_it_is_light_and_no_wider_than_the_paper(shown):
    """A4 at 96 px/in with margins: 718 px."""
    opened = shown(theme="dark", width=718)
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    opened.send("Emulation.setEmulatedMedia", media="print", features=dark)
    try:
        assert opened.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert opened.value(CONTRAST) >= 4.5
        assert opened.value("document.documentElement.scrollWidth") <= 718
    finally:
        opened.send("Emulation.setEmulatedMedia", media="")
