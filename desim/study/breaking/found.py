"""What a search has found, for people: the scenario as a file with comments, and texts."""

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from desim.analysis.properties import Judgement
from desim.config.number_texts import counted
from desim.config.parameters import as_jsonable
from desim.config.traits import kind_of
from desim.scenario.properties import Property
from desim.scenario.scenario import PROTOCOLS, Scenario
from desim.scenario.toml import brief
from desim.study.breaking.features import Case
from desim.study.breaking.search import Search, Violation
from desim.study.breaking.sightings import SIGHTINGS


def scenario_text(violation: Violation, file: str, command: str, folder: Path | None = None) -> str:
    """Return the scenario of a violation as a commented file, with its seed and its property.

    `file` is the name of the file, for the commands in its comments. `command` is the command that found the violation.
    For `folder` see `with_comment`.
    """
    verdict, prop, protocol = violation.verdict, violation.prop, violation.scenario.protocol_name
    verb = "fails" if violation.failure else f'violates "{prop.text}"'
    lines = [
        f"{protocol} {verb} here: {told_text(verdict, violation.failure, prop)}.",
        f"Found as case {violation.searched} of: {command}",
        f"Made smaller in {counted(violation.shrunk, 'run')}. What is changed:",
        *(f"  {feature}: {_changes_text(changes)}" for feature, changes in violation.case.items()),
        f"Look: {command_for('run' if violation.failure else 'replay', file, violation.scenario, folder)}"
        + ("" if violation.failure else f", then add #t={verdict.at:g} to the address"),
    ]
    return with_comment(violation.scenario, prop, violation.seed, lines, folder)


def command_for(verb: str, file: str, scenario: Scenario, folder: Path | None) -> str:
    """Return the command `desim VERB` for the file of a scenario.

    `folder` has the code that the scenario names, which is not beside the file.
    """
    command = f"desim {verb} {shlex.quote(file)}"
    if PROTOCOLS.holds(scenario.protocol) and ":" not in kind_of(scenario.protocol):
        return command
    return f"{'' if folder is None else f'PYTHONPATH={shlex.quote(str(folder))} '}{command} --allow-import"


def with_comment(
    scenario: Scenario, prop: Property, seed: int, lines: Iterable[str], folder: Path | None = None
) -> str:
    """Return a scenario with a property and a seed as the text of a file that begins with the lines of a comment.

    `folder` is where the code that the scenario names was found; None: nowhere.
    """
    margin = f"margin:{prop.label}"
    changes = {"seed": seed, "properties": [prop], "record.messages": True, "record.metrics": [margin]}
    statement = f"{prop.name}: {prop.text}" if prop.name else prop.text
    comment = "".join(f"# {' '.join(line.splitlines())}\n" for line in lines)
    return f"{comment}\n{brief(scenario.with_(changes), folder, properties=[statement])}"


def _changes_text(changes: Mapping[str, Any]) -> str:
    def text(value: Any) -> str:
        if isinstance(value, dict):
            return "{ " + ", ".join(f"{key} = {text(entry)}" for key, entry in value.items()) + " }"
        if isinstance(value, list):
            return "[" + ", ".join(map(text, value)) + "]"
        return "none" if value is None else tomli_w.dumps({"x": value}).removeprefix("x = ").strip()

    return ", ".join(f"{key} = {text(value)}" for key, value in as_jsonable(changes).items())


def case_text(case: Case) -> str:
    """Return the changes of a case on one line."""
    return "; ".join(_changes_text(changes) for changes in case.values()) or "nothing changed"


def told_text(verdict: Judgement, failure: str, prop: Property) -> str:
    """Return the outcome of a run as text: its judgement, or the exception that it raised."""
    unit = f" {prop.unit}" if prop.unit else ""
    against = "" if verdict.reference is None else f", {prop.against} {_number(verdict.reference)}{unit}"
    return failure or f"margin {_number(verdict.margin)}{unit} (it has {_number(verdict.measure)}{unit}{against})"


def _number(value: float) -> str:
    return f"{value:.3g}"


def protocols_text(verdicts: Mapping[str, Judgement | str], prop: Property) -> str:
    """Return a table of the margins and measures of all protocols, the worst first."""
    unit = f", {prop.unit}" if prop.unit else ""
    lines = [f"{'protocol':<28}{'margin' + unit:>10}{'measure' + unit:>12}"]
    judged = {kind: verdict for kind, verdict in verdicts.items() if isinstance(verdict, Judgement)}
    for kind, verdict in sorted(judged.items(), key=lambda pair: (pair[1].margin, pair[0])):
        mark = "" if verdict.holds else "  violates"
        lines.append(f"{kind:<28}{_number(verdict.margin):>10}{_number(verdict.measure):>12}{mark}")
    return "\n".join([*lines, *(f"{kind:<28}{reason}" for kind, reason in verdicts.items() if isinstance(reason, str))])


def search_text(search: Search, prop: Property) -> str:
    """Return the violation that a search found, or its least margin, and the sightings of its runs, as text."""
    lines: list[str] = []
    if (violation := search.violation) is not None:
        verb = "failed" if violation.failure else "violated"
        outcome = told_text(violation.verdict, violation.failure, prop)
        lines += [
            f"{verb} in case {violation.searched}: seed {violation.seed}, {outcome}",
            f"smallest after {counted(violation.shrunk, 'more run')}: {case_text(violation.case)}",
        ]
    else:
        least = f"{_number(search.closest)} {prop.unit}".rstrip()
        lines.append(f"no violation in {counted(search.runs, 'case')}; the least margin is {least}")
    if search.stopped:
        lines.append("the time was up before all cases were run")
    if search.refused:
        lines.append(f"no valid scenario, and so not run: {counted(search.refused, 'case')}")
    lines += ["", f"of {counted(search.runs, 'case')}:"]
    lines += [f"  {search.seen[sentence]:>5}  {sentence}" for sentence in SIGHTINGS]
    lines += [f"  {count:>5}  with {name}" for name, count in sorted(search.featured.items())]
    return "\n".join([*lines, *(f"warning: {text}" for text in search.warnings(prop))])
