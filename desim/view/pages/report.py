"""The report of a sweep: one self-contained HTML page; equal results give equal bytes.

The page has no script and requests no resources. Its figures are inline SVG in the colours of the page.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from xml.etree import ElementTree

from desim.analysis.drawing.palette import ON_DARK
from desim.analysis.metrics import METRICS, unit_of, words
from desim.analysis.statistics import Estimate
from desim.analysis.tables import with_half_width
from desim.config.file_names import STORE
from desim.config.key_index import unit_of_key
from desim.config.number_texts import counted
from desim.config.trust import regular_or_missing
from desim.results import provenance
from desim.scenario.scenario import Scenario
from desim.study.results.costs import AS_IT_IS, IDEAL, PERFECT, SILENT
from desim.study.results.explanation import Explanation
from desim.study.results.result import SweepResult
from desim.study.results.runs import SHOWN, text
from desim.study.store.history import runs_requested, shell_lines
from desim.study.store.properties import flat
from desim.study.store.store import Store

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

PANELS = ("active_time", "capture_time", "idle_time", "crowded_time", "switches", "messages_sent")
"""The built-in metrics drawn as small multiples, if they were measured."""
MAPPED = "active_time"
"""The metric of the heat map."""
MAX_FAILURES = 20
"""Maximum number of different tracebacks shown."""
SOURCE_LINE = re.compile(r'File "[^"\n]*?((?:[^"/\\\n]+[/\\])?[^"/\\\n]+)"')
"""Matches the path of a file in a traceback; the group consists of the names of its folder and of the file."""
SVG, XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
COLOURS = {"#000000": "currentColor"} | {
    colour.lower(): f"var(--on-{colour[1:].lower()})" for colour in ON_DARK if colour not in {"#000000", "#ffffff"}
}
"""The colours of figures that are illegible on a dark page, and the CSS colours that replace them."""


@dataclass(frozen=True)
class Study:
    """The contents of a folder of results."""

    result: SweepResult
    fixed: Mapping[str, str]
    """The parameters common to all configurations: JSON text by dotted key."""
    document: provenance.Document | None
    """The provenance; None if the folder has no run.json."""
    explanation: Explanation | None = None
    """The cost of each imperfection, if `desim explain` computed it."""
    commands: Sequence[tuple[str, Sequence[str]]] = ()
    """The working folder and the words of each command that added runs."""
    versions: Sequence[Mapping[str, str]] = ()
    """The versions of Python and of the packages that computed the runs; several if they were mixed."""
    against: Mapping[str, str] | None = None
    """The values of the configurations from which the tables show differences; None = the first value of a key."""

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read a folder of `desim sweep`, of `desim explain`, or of both.

        Raises:
            OSError: if a file cannot be read, or the store is missing or damaged (StoreError).
            ValueError: if the contents of a file are invalid (ProvenanceError, ...).
        """
        with Store(folder / STORE, read_only=True) as store:
            result, base = SweepResult.of(store), store.read_property("scenario", dict[str, Any])
            commands, versions = store.commands, store.versions
        path = folder / provenance.FILE
        document = provenance.read(path) if path.exists() else None
        scenario = (document and document["scenario"]) or base
        excluded = tuple(f"{key}." for key in (*result.keys, "sweep", "seed", "name"))
        settings = flat(scenario, _has_keys).items()
        fixed = {
            key: json.dumps(value, ensure_ascii=False) for key, value in settings if not f"{key}.".startswith(excluded)
        }
        return cls(result, fixed, document, _explanation(folder), commands, versions)

    @property
    def runs(self) -> int:
        """The number of runs in the store."""
        return sum(len(group.rows) for group in self.result.groups)

    @property
    def parameters(self) -> dict[str, list[str]]:
        """The values of each key of the grid, in the order of the grid."""
        return {
            key: list(dict.fromkeys(text(group.settings[key]) for group in self.result.groups))
            for key in self.result.keys
        }

    @property
    def variants(self) -> list[str]:
        """The variants of the scenario in a folder of `desim explain`, in words: bounds, or what is removed."""
        bounds = {IDEAL: f"{IDEAL} (without all of these)", AS_IT_IS: AS_IT_IS, PERFECT: PERFECT, SILENT: SILENT}
        return [bounds.get(name, f"without {name}") for name in self.parameters["without"]]

    @property
    def measured(self) -> list[str]:
        """The numeric metrics with a value in at least one run, except `captured`, which every table includes."""
        names = [name for name, metric in METRICS.items() if metric.is_number and name != "captured"]
        groups = self.result.groups
        return [name for name in (*names, *self.result.units) if any(len(group.present(name)) for group in groups)]


def report(study: Study) -> str:
    """Return a self-contained HTML page about a sweep; needs jinja2 and matplotlib (the extra `plot`)."""
    from jinja2 import Environment

    from desim.study.results.design_figures import contour, scatter
    from desim.study.results.figure_labels import swept_numbers
    from desim.study.results.figures import legend, multiples
    from desim.study.results.heat_maps import phase

    result, measured, explanation = study.result, study.measured, study.explanation
    panels = [metric for metric in (*PANELS, *result.units) if metric in measured]
    drawn = result.drawn_keys
    has_map = (len(drawn) == 2 if drawn else len(swept_numbers(result)) > 1) and MAPPED in measured
    shown = [*SHOWN, *result.units]
    template = files("desim.view.pages").joinpath("report.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, keep_trailing_newline=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"signs": lambda cell: cell.replace("+-", "±"), "counted": counted}
    environment.filters["unit"] = lambda key: unit_of_key(key, Scenario)
    failures = list(_failures(result))
    document = study.document
    key = legend(result) if panels and not drawn else None
    return environment.from_string(template).render(
        study=study,
        result=result,
        tables=result.tables(shown, against=study.against),
        warnings=result.warnings(shown),
        wide=[(title, list(zip(*rows, strict=True))) for title, rows in result.tables(measured, against=study.against)]
        if measured
        else [],
        failures=failures[:MAX_FAILURES],
        more_failures=len(failures) - MAX_FAILURES,
        findings=list(findings(study)),
        commands=shell_lines(study.commands),
        asked=None if document is None else runs_requested(document, study.commands),
        origin=({} if document is None else _origin(document)) | _computed_by(study.versions),
        panels=[
            _inline(
                scatter(result, panel) if drawn else multiples(result, [panel], has_legend=False),
                f"panel-{panel}",
                words(panel),
            )
            for panel in panels
        ],
        legend=_inline(key, "legend", "legend of the figures") if key else None,
        colours=[(name[1:].lower(), name, on_dark) for name, on_dark in ON_DARK.items()],
        phase=_inline((contour if drawn else phase)(result, MAPPED), "phase", f"{words(MAPPED)}, heat map")
        if has_map
        else None,
        waterfalls=[
            _inline(explanation.plot(name), f"waterfall-{name}", f"{words(name)}, costs") for name in explanation.costs
        ]
        if explanation
        else [],
    )


def findings(study: Study) -> Iterator[str]:
    """Yield the findings as sentences: one about the costs of imperfections, and one about the paired differences.

    Costs are those in the first metric of the explanation, differences those in the first measured metric of the
    tables. Of the costs or differences whose means differ significantly from 0, a sentence names the one with the
    greatest absolute mean. If none differs, the sentence says so and names the greatest of all. The test has a level of
    5 % for all costs or all differences together (Bonferroni). The 95 % interval shown is for one cost or difference
    alone, as in the tables. If nothing can be compared, there is no sentence. Runs of `desim explain` have no sentence
    about differences.
    """
    if study.explanation:
        yield from _greatest_cost(study.explanation)
    if study.document is None or study.document["what"] != "explain":
        yield from _greatest_difference(study)


def _greatest_cost(explanation: Explanation) -> Iterator[str]:
    """Yield a sentence about the greatest cost in the first metric of an explanation; see `findings`."""
    cost = next(iter(explanation.costs.values()))
    parts = [(name, saving.mean) for name, saving in cost.parts.items() if saving.mean.count > 1]
    if not parts:
        return
    name, estimate = max(parts, key=lambda part: (_excludes_0(part[1], len(parts)), abs(part[1].mean)))
    if _excludes_0(estimate, len(parts)):
        yield (
            f"Of the imperfections with an effect distinguishable from 0{_corrected(len(parts))}, {name} matters most:"
            f" it changes the {cost.label} by {_size(estimate, cost.unit, len(parts))}."
        )
    else:
        yield (
            f"No imperfection has an effect on the {cost.label} that is distinguishable from 0"
            f"{_corrected(len(parts))}; the greatest{f' of {len(parts)}' * (len(parts) > 1)} is that of {name},"
            f" {_size(estimate, cost.unit, len(parts))}."
        )


def _greatest_difference(study: Study) -> Iterator[str]:
    """Yield a sentence about the greatest paired difference in the first measured metric; see `findings`."""
    result = study.result
    metric = next((name for name in (*SHOWN, *result.units) if name in study.measured), None)
    if not result.common or metric is None:
        return
    differences = [
        (key, k, other, difference)
        for key in result.keys
        for k, (other, difference) in _differences_along(result, key, metric).items()
        if difference.count > 1
    ]
    if not differences:
        return
    count = len(differences)
    key, k, other, estimate = max(differences, key=lambda row: (_excludes_0(row[-1], count), abs(row[-1].mean)))
    value, first = (text(result.groups[group].settings[key]) for group in (k, other))
    other_settings = result.groups[k].in_words(without=[key])
    change = f"{value} instead of {first}{f' (with {other_settings})' if other_settings else ''}"
    size = _size(estimate, unit_of(metric, result.units), count)
    if _excludes_0(estimate, count):
        among = (
            f" Of {count} paired differences, this is the greatest that is distinguishable from 0{_corrected(count)}."
            if count > 1
            else ""
        )
        yield f"{key} matters most: {change} changes the {words(metric)} by {size}.{among}"
    else:
        yield (
            f"No paired difference in {words(metric)} is distinguishable from 0{_corrected(count)}; the greatest"
            f"{f' of {count}' * (count > 1)} is {size}, for {key} = {change}."
        )


def _differences_along(result: SweepResult, key: str, metric: str) -> dict[int, tuple[int, Estimate]]:
    """Return the paired differences of a metric along a key of the grid.

    Each configuration is compared with a reference that has the first value of the key and is otherwise equal. The
    result maps the position of the configuration in `groups` to the position of its reference and the difference.
    References themselves are absent.
    """
    references = result.first_along(key)
    by_reference = {other: result.differences(metric, reference=other) for other in set(references)}
    return {k: (other, by_reference[other][k]) for k, other in enumerate(references) if k != other}


def _excludes_0(estimate: Estimate, count: int) -> bool:
    """Return whether a mean, one of `count`, differs from 0 in a two-sided t test at a level of 5 % / `count`."""
    return estimate.excludes_0(1.0 - 0.05 / count)


def _corrected(count: int) -> str:
    """Return the correction of a test that is one of `count`, as text; "" for a single test."""
    return f" at a level of 5 % for all {count} together (Bonferroni)" if count > 1 else ""


def _size(estimate: Estimate, unit: str, count: int) -> str:
    """Return a mean of pairs, one of `count`, with its interval, which is not corrected for the others."""
    size = with_half_width(estimate, estimate.count, "+", unit)
    alone = " of this one alone" if count > 1 else ""
    return f"{size} (95 % interval{alone}, {estimate.count} pairs of runs with the same seed)"


def _explanation(folder: Path) -> Explanation | None:
    """Return the explanation in a folder or in its subfolder `explain`; None if there is none."""
    for path in (folder / "explain.json", folder / "explain" / "explain.json"):
        if path.exists():
            try:
                return Explanation.of(json.loads(regular_or_missing(path).read_bytes()))
            except (ValueError, RecursionError) as error:
                raise ValueError(f"{path}: {error}") from error
    return None


def _has_keys(node: Any) -> bool:
    """Return whether a node is a table with keys or a list of tables; a list of numbers or strings is one value."""
    return any(isinstance(value, dict) for value in node) if isinstance(node, list) else bool(node)


def _failures(result: SweepResult) -> Iterator[tuple[str, str, list[str]]]:
    """Yield each different traceback: the exception, the traceback, and descriptions of the runs that raised it."""
    runs: dict[tuple[str, str], list[str]] = {}
    for group in result.groups:
        for row in group.failed:
            runs.setdefault((row.error, row.traceback), []).append(
                f"{group.in_words()}; seed {row.seed} ({row.status})"
            )
    yield from ((error, SOURCE_LINE.sub(r'File "\1"', trace), texts) for (error, trace), texts in runs.items())


def _computed_by(versions: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return the versions that computed the runs, as a label and a text, if there are several."""
    texts = [
        ", ".join(f"{name} {version}" for name, version in versions_of_run.items()) for versions_of_run in versions
    ]
    return {"runs computed by": "; and by ".join(texts)} if len(texts) > 1 else {}


def _origin(document: provenance.Document) -> dict[str, str]:
    """Return the provenance as labels and texts."""
    state = "" if document["dirty"] is None else ", with uncommitted changes" if document["dirty"] else ", unchanged"
    rows = {
        "first seed": str(document["seed"]),
        "commit": f"{document['commit']}{state}" if document["commit"] else "unknown",
        "hash of the source code": document["code"],
        **{f"version of {name}": version or "unknown" for name, version in document["versions"].items()},
        **{str(name): value for name, value in document["platform"].items()},
    }
    if document["folder"] is None:
        rows["scenario"] = "built by a script"
    if document["unrecorded"]:
        rows["parameters not recorded"] = ", ".join(map(str, document["unrecorded"]))
    return {name: str(value) for name, value in rows.items()}


def _inline(figure: "Figure", name: str, label: str) -> "Markup":
    """Return a figure as inline SVG for HTML; its ids are prefixed with `name`, to be unique on the page."""
    from markupsafe import Markup

    stream = BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None}, transparent=True)
    root = ElementTree.fromstring(stream.getvalue())
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in {f"{{{SVG}}}metadata", f"{{{SVG}}}style"}:
                parent.remove(child)
    for element in root.iter():
        element.tag = element.tag.removeprefix(f"{{{SVG}}}")
        attributes = {key.removeprefix(f"{{{XLINK}}}"): value for key, value in element.attrib.items()}
        element.attrib.clear()
        element.attrib.update({key: _attribute(key, value, name) for key, value in attributes.items()})
    for key in ("height", "version"):
        root.attrib.pop(key, None)
    root.set("style", f"--width: {96.0 * figure.get_figwidth():.0f}px")  # at this width, fonts are as large as in print
    root.set("role", "img")
    root.set("aria-label", label)
    return Markup(ElementTree.tostring(root, encoding="unicode"))  # escaped by ElementTree


def _attribute(key: str, value: str, name: str) -> str:
    """Return the value of an SVG attribute with the colours of the page and ids prefixed with `name`."""
    if key == "id":
        return f"{name}-{value}"
    if key == "href":
        return value.replace("#", f"#{name}-", 1)
    if key == "style":
        value = re.sub("#[0-9a-f]{6}", lambda match: COLOURS.get(match[0], match[0]), value)
    return value.replace("url(#", f"url(#{name}-")
