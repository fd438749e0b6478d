"""The site: its generated pages, its front page, and, where it has been built, the pages as they are read.

`nox -s docs` builds the site and then runs this file, so that the tests of built pages see it.
"""

import json
import re
import sys
import xml.etree.ElementTree as ET
from itertools import chain, groupby
from pathlib import Path

import pytest
from PIL import Image, ImageSequence

import desim
import protocols
from desim.analysis.metrics import METRICS
from desim.scenario.scenario import PROTOCOLS

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
BUILT = DOCS / "_build"
is_built = pytest.mark.skipif(not (BUILT / "searchindex.js").exists(), reason="the site is not built")
sys.path.insert(0, str(DOCS))

import api  # noqa: E402  it lies in the folder of the documentation
import dark  # noqa: E402
import film  # noqa: E402
import notebooks  # noqa: E402
import pages  # noqa: E402
import thumbnails  # noqa: E402

TUTORIALS = [path for path in sorted(DOCS.glob("tutorials/*.md")) if path.stem != "index"]


def page(name):
    return (DOCS / name).read_text(encoding="utf-8")


def test_every_public_name_is_on_one_page_of_the_python_interface():
    names = [name for group in api.PAGES.values() for section in group.sections for name in api.names_in(section)]
    assert len(names) == len(set(names))
    public = {f"desim.{name}" for name in (*desim.__all__, "open")} | {
        f"protocols.{name}" for name in protocols.__all__
    }
    assert public <= set(names)


def test_every_page_and_section_of_the_python_interface_has_a_sentence():
    for group in api.PAGES.values():
        assert group.text.endswith(".")
        assert all(section.text.endswith(".") and api.names_in(section) for section in group.sections)


def test_every_metric_is_in_one_group_and_said_in_one_way():
    names = [name for _, group in pages.METRIC_GROUPS.values() for name in group]
    assert sorted(names) == sorted(METRICS)
    text = pages.metrics()
    meanings = [line.split(" | ")[2] for line in text.splitlines() if line.startswith("| [`")]
    assert len(meanings) == len(METRICS)
    assert all(re.match(r"[A-Z]", meaning) and not re.match(r"The |Return|How", meaning) for meaning in meanings)


def test_every_key_has_an_anchor_of_its_own_on_the_page_of_the_keys():
    text, anchors = pages.keys(), pages.key_anchors()
    assert {"network.latency", "network.latency.kind", "protocol.kind", "protocol.sap", "seed"} <= anchors.keys()
    for key, anchor in anchors.items():
        assert text.count(f"{{#{anchor}}}") + text.count(f"({anchor})=") == 1, key


def test_the_index_of_the_reference_is_short_and_says_what_each_page_is():
    text = page("reference/index.md")
    assert len(text.splitlines()) < 40
    rows = re.findall(r"^\| \[.+\]\(([\w/]+)\.md\) \| (.+\.) \|$", text, re.MULTILINE)
    (tree,) = re.findall(r"```\{toctree\}\n(:hidden:\n:maxdepth: 1)\n\n(.*?)```", text, re.DOTALL)
    assert sorted(name for name, _ in rows) == sorted(tree[1].split())


def test_the_front_page_has_installation_code_a_film_figures_and_ways_on():
    text = page("index.md")
    assert re.search(r"```sh\npip install .*pursuit-desim", text)
    assert "{code-cell}" in text
    assert "_static/replay.gif" in text
    assert len(re.findall(r"!\[.+\]\(\.\./scenarios/\w+\.svg\)", text)) == 3


@pytest.mark.slow
def test_each_frame_of_the_film_shows_the_players():
    """The control is a page whose plane is not drawn yet."""
    with Image.open(film.FILM) as taken:
        assert [film.is_drawn(frame) for frame in ImageSequence.Iterator(taken)] == [True] * len(film.TIMES)
        empty = taken.convert("RGB")
    empty.paste("white", (16, 96, empty.width // 2, empty.height // 2))
    assert not film.is_drawn(empty)


@pytest.mark.whole
def test_the_code_of_the_front_page_is_short_and_prints(capsys):
    (code,) = notebooks.CELL.findall(page("index.md"))
    assert len([line for line in code.splitlines() if line.strip()]) <= 12
    exec(compile(code.replace("reps=20", "reps=2, executor=1"), "index.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "s of active time" in printed
    assert "difference from protocol = sap" in printed


def test_every_tutorial_begins_with_its_notebook():
    for path in TUTORIALS:
        text = path.read_text(encoding="utf-8")
        assert f"{{download}}`notebook <../_notebooks/{path.stem}.ipynb>`" in text.partition("\n## ")[0], path


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_notebook_has_the_code_of_its_tutorial_and_links_to_the_site(path):
    text = path.read_text(encoding="utf-8")
    made = notebooks.notebook(text, "tutorials", "https://example.org/")
    cells = ["".join(cell["source"]) for cell in made["cells"] if cell["cell_type"] == "code"]
    assert cells == [cell.strip("\n") for cell in notebooks.CELL.findall(text)]
    prose = "\n".join(cell["source"] for cell in made["cells"] if cell["cell_type"] == "markdown")
    assert "{download}" not in prose
    assert all(link.startswith("https://") for link in re.findall(r"\]\(([^)]+)\)", prose))
    assert "https://example.org/explanation/" in prose or "https://example.org/howto/" in prose
    json.dumps(made)


def test_pictures_of_the_gallery_are_of_scenario_files_and_of_many_kinds():
    files = {path.stem for path in ROOT.glob("scenarios/*.toml")}
    assert thumbnails.PICTURES.keys() | thumbnails.SPACETIME.keys() <= files
    titles = [title for _, title in thumbnails.PICTURES.values()]
    plain = files - thumbnails.PICTURES.keys() - thumbnails.SPACETIME.keys()
    assert len(set(titles)) >= 8
    assert len(plain) < len(files) / 3


@pytest.mark.parametrize("path", sorted(ROOT.glob("scenarios/*.svg")), ids=lambda path: path.stem)
def test_a_dark_figure_has_the_same_texts_and_no_black_ink_but_on_maps(path):
    text = path.read_text(encoding="utf-8")
    made = dark.dark(text)
    assert [each.text for each in ET.fromstring(made).iter()] == [each.text for each in ET.fromstring(text).iter()]
    has_map = "<image" in text or "QuadMesh" in text
    assert "fill: #ffffff" not in made or has_map
    assert "#000000" not in re.sub("<defs>.*?</defs>", "", made, flags=re.DOTALL) or has_map
    assert dark.INK in made


# Which protocol?


def active_times():
    """Return the active times of the panel "paper" of the figure of the study, by protocol, in order of the latency."""
    svg = "{http://www.w3.org/2000/svg}"
    texts = []
    for group in ET.parse(ROOT / "scenarios/rivals.svg").getroot().iter(f"{svg}g"):
        if group.get("id") == "axes_1":
            for text in group.iter(f"{svg}text"):
                x, y = map(float, re.search(r"rotate\(\S+ (\S+) (\S+)\)", text.get("transform")).groups())
                texts.append((round(y), x, text.text))
    rows = [[text for *_, text in sorted(row, key=lambda each: each[1])] for _, row in by_height(texts)]
    return {row[0]: row[1:] for row in rows if len(row) == 6}


def name_in(row):
    return row[0].strip("`")


def by_height(texts):
    """Return the texts in rows; those of a row differ by at most two units, as labels and cells are centred apart."""
    heights = sorted({y for y, *_ in texts})
    first = {y: min(other for other in heights if y - other <= 2) for y in heights}
    return groupby(sorted(texts, key=lambda each: first[each[0]]), key=lambda each: first[each[0]])


def test_the_table_of_protocols_has_every_kind_and_the_numbers_of_the_study():
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in page("howto/which_protocol.md").splitlines()
        if re.match(r"\| `\w+` \| \d", line)
    ]
    measured = active_times()
    silent = measured.pop("nobody talks")
    assert {row[0].strip("`"): row[1:6] for row in rows} == measured
    assert re.findall(r"^\| `(\w+)` \| [^\d]", page("howto/which_protocol.md"), re.MULTILINE) == [*map(name_in, rows)]
    assert measured.keys() == PROTOCOLS.choices().keys() - {"policy"}  # which is what its weights make of it
    assert f"announces nothing needs {silent[0]} s" in page("howto/which_protocol.md").replace("\n", " ")
    assert all(cell for row in rows for cell in row)


def test_the_glossary_is_sorted_and_says_what_each_term_is():
    (body,) = re.findall(r"```\{glossary\}\n(.*?)```", page("reference/glossary.md"), re.DOTALL)
    terms = [entry.partition("\n")[0] for entry in body.split("\n\n")]
    assert len(terms) >= 25
    assert terms == sorted(terms, key=lambda term: term.lower().replace(",", " "))


# The pages as they are read.


def html(name):
    return (BUILT / name).read_text(encoding="utf-8")


@is_built
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_built_tutorial_shows_its_pictures(path):
    text = html(f"tutorials/{path.stem}.html")
    drawn = re.findall(r"^(?:(?:\w+\.)?plot\(.*|figure)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    assert drawn
    assert len(re.findall(r'<img[^>]+src="\.\./_images/\w+\.png"', text)) == len(drawn)
    assert "widget-view" not in text
    assert "StyledFigure" not in text
    assert re.search(rf'href="[^"]+/{path.stem}\.ipynb"', text)


@is_built
def test_the_built_pages_have_a_version_an_icon_and_the_repository():
    for name in ("index.html", "howto/sweeps.html", "reference/index.html"):
        text = html(name)
        assert "navbar-version" in text
        assert 'rel="icon"' in text
        assert "https://github.com/desim-project/desim" in text


@is_built
def test_no_built_page_loads_a_script_or_a_style_from_elsewhere():
    loading = re.compile(r"<(?:script|link)\b[^>]*\b(?:src|href)=\"https?://(?!desim-project\.)[^\"]+")
    assert [found for path in BUILT.rglob("*.html") for found in loading.findall(path.read_text("utf-8"))] == []


@is_built
def test_the_built_figures_of_studies_have_dark_variants():
    text = html("explanation/findings.html")
    assert (
        len(re.findall(r'<img[^>]*class="only-dark"', text))
        == len(re.findall(r'<img[^>]*class="only-light"', text))
        > 5
    )


@is_built
def test_the_built_front_page_shows_what_its_code_prints():
    text = html("index.html")
    assert "s of active time" in text
    assert "difference from protocol = sap" in text


@is_built
def test_the_built_index_of_the_reference_has_few_links():
    article = re.search(r"<article.*?</article>", html("reference/index.html"), re.DOTALL)[0]
    assert len(re.findall("<a ", article)) < 40


@is_built
def test_the_search_knows_the_keys_and_their_rank():
    assert "reference/keys" in html("_static/language_data.js")
    index = html("searchindex.js")
    assert all(name in index for name in chain(("network", "announce"), ('"latency"', '"heartbeat"')))
    assert '"summary"' in index
    assert '"metric-active_time"' in index or '"active_time"' in index
    assert 'page === "reference/metrics"' in html("_static/language_data.js")
