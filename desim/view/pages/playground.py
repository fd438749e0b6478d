"""A scenario to play with: its keys are changed one by one, and each run is compared with a pinned run.

A pinned run is one that the user has chosen as the reference. A control is the part of a page that changes one key.
The page of `desim play` (`desim.view.pages.play_server`) and the widget of notebooks (`desim.view.pages.widget`) show
the results of these functions. Each answer to a request of a page is a JSON object.
"""

import re
import shlex
import traceback
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path

import cloudpickle
import tomli_w

from desim.analysis.measuring import summary
from desim.analysis.metrics import Summary
from desim.config.file_names import folder_name
from desim.results import provenance, run_folder
from desim.scenario.checks import warnings
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.scenario import Scenario
from desim.scenario.toml import brief, validate
from desim.simulation.run import Result, run
from desim.simulation.watchdog import TimedOut, within
from desim.view.pages.answers import Answer, Changes, json_answer
from desim.view.pages.controls import controls
from desim.view.pages.metric_rows import compared_metrics, named_metrics_of
from desim.view.pages.replay import replay_page, with_recordings

WITH_COMMA = re.compile(r"[+-]?\d+,\d+")
"""A number with a decimal comma, which TOML does not have."""
INNERMOST = 3
"""The number of innermost calls that are shown of the traceback of a run that failed."""
KEPT = 3
"""The number of results that a process keeps, because the pinned run is needed again with every change."""


@dataclass(frozen=True)
class Playground:
    """A scenario whose keys can be changed."""

    base: Source
    """The scenario before any change."""
    file: Path | None
    """Its file; None for a scenario that was constructed in Python."""
    start: tuple[str, ...] = ()
    """The changes with which a page begins."""
    timeout: float = 30.0
    """The wall time after which a run is ended, s."""

    def changed(self, changes: Changes) -> Source:
        """Return the source with changes, without its sweep.

        Raises:
            ScenarioError: if a change is no KEY=VALUE, or its key does not belong to a table.
        """
        source = self.base.copy()
        source.tables.pop("sweep", None)
        for change in changes:
            source.override(change)
        return source

    def scenario(self, changes: Changes) -> Scenario:
        """Return the scenario with changes and with the recordings that a replay needs.

        Raises:
            ScenarioError: if the scenario is not valid.
        """
        return with_recordings(validate(self.changed(changes)))

    def result(self, changes: Changes) -> Result:
        """Run the scenario with changes, or return the result of an earlier equal call if it is still kept (`KEPT`).

        Raises:
            ScenarioError: if the scenario is not valid.
            TimedOut: if the run takes longer than the time limit.
        """
        return _result(_Request(cloudpickle.dumps((self, tuple(changes))), self, changes))

    def answer(self, now: Changes, pinned: Changes | None) -> Answer:
        """Run the scenario and return the content of the page.

        Args:
            now: the changes of the run that is shown.
            pinned: the changes of the run with which it is compared; None if there is none.

        Returns:
            The entry `controls`: the controls of the keys. If the scenario is valid, the entry `texts`: the scenario as
            TOML, as a command and in Python. If all runs succeed, the entries `page` (the replay), `metrics`, `seeds`
            and `warnings`; otherwise the entry `errors`. It has a message for each key that is wrong, and under "" the
            messages that belong to no key, such as the reason why a run failed.
        """
        try:
            scenario = self.scenario(now)
        except ScenarioError as error:
            controls_shown = self.controls(now)
            by_key = {control["key"]: control for control in controls_shown}
            return json_answer({"errors": _by_key(error, now, by_key), "controls": controls_shown})
        shown = {"controls": [asdict(control) for control in controls(scenario)], "texts": self.texts(now)}
        try:
            result, other = self.result(now), None if pinned is None else self.result(pinned)
            is_changed = pinned is not None and sorted(pinned) != sorted(now)
            named_metrics = named_metrics_of(scenario)
            with within(self.timeout):
                return json_answer(
                    shown
                    | {
                        "page": replay_page(result, other if is_changed else None),
                        "metrics": list(
                            compared_metrics(summary(result), None if other is None else summary(other), named_metrics)
                        ),
                        "seeds": [result.seed, None if other is None else other.seed],
                        "warnings": [f"{key}: {why}" for key, why in warnings(scenario)],
                    }
                )
        except ScenarioError as error:  # the address of the page may name a wrong pinned run
            return json_answer(shown | {"errors": {"": f"The pinned run is not valid, so unpin it: {error}"}})
        except (Exception, TimedOut) as error:
            return json_answer(shown | {"errors": {"": _reason(error)}})

    @property
    def name(self) -> str:
        """The name of the scenario."""
        return str(self.base.tables.get("name", "scenario"))

    @property
    def values(self) -> dict[str, str]:
        """The value of each key before any change, as `Control.value`."""
        return {control["key"]: control["value"] for control in self.controls(())}

    def controls(self, changes: Changes) -> list[Answer]:
        """Return the controls of a scenario; those of the base if the changes cannot be applied."""
        try:
            source = self.changed(changes)
        except ScenarioError:
            source = self.base
        try:
            return [asdict(control) for control in controls(validate(source))]
        except ScenarioError:
            return [asdict(control) for control in controls(source.tables)]

    def texts(self, changes: Changes) -> dict[str, str]:
        """Return the scenario with changes as the text of a file, as a command, and as a program.

        Without a file, the text for a new file contains the changes, and the command and the program run this file.
        """
        source = self.changed(changes)
        file = str(self.file or f"{self.name}.toml")
        allow = ["--allow-import"] if self.file is not None and self.base.allow_import else []
        options = [word for change in changes for word in ("--set", change)] if self.file is not None else []
        arguments = f", {list(changes)!r}" if options else ""
        return {
            "toml": brief(validate(source)) if self.file is None else tomli_w.dumps(source.tables),
            "command": shlex.join(["desim", "run", file, *allow, *options]),
            "python": "from desim import load, run\n\n"
            f"result = run(load({file!r}{arguments}{', allow_import=True' if allow else ''}))\n",
        }

    def save(self, changes: Changes, document: provenance.Document) -> Answer:
        """Run the scenario, and write the run to the first of out/NAME-1, out/NAME-2, ... that does not exist.

        `desim run --from` repeats the run from the run.json in this folder.

        Args:
            changes: the changes of the scenario.
            document: the provenance of the run.

        Returns:
            The `folder`, or an `error`.
        """
        try:
            result = self.result(changes)
            folder = _new_folder(Path("out"), folder_name(result.scenario.name))
            run_folder.write(result, folder, document)
        except (Exception, TimedOut) as error:
            return {"error": str(error) if isinstance(error, ScenarioError | OSError) else _reason(error)}
        return {"folder": str(folder)}

    @property
    def folder(self) -> Path | None:
        """The folder of the scenario file."""
        return None if self.file is None else self.file.parent

    def pair(self, now: Changes, pinned: Changes, seed: int) -> tuple[Summary, Summary] | str:
        """Run the scenario with `now` and with `pinned`, on one seed; return the metrics of both, or why one failed."""
        try:
            first, second = (self._measured(changes, seed) for changes in (now, pinned))
        except (Exception, TimedOut) as error:
            return _reason(error)
        return first, second

    def _measured(self, changes: Changes, seed: int) -> Summary:
        with within(self.timeout):
            return summary(run(self.scenario(changes), seed))


@dataclass(frozen=True)
class _Request:
    """A run of a playground; requests with the same bytes are equal."""

    content: bytes
    playground: Playground = field(compare=False)
    changes: Changes = field(compare=False)


@lru_cache(maxsize=KEPT)
def _result(request: _Request) -> Result:
    """Return the result of a request; see `Playground.result`."""
    with within(request.playground.timeout):
        return run(request.playground.scenario(request.changes))


def _by_key(error: ScenarioError, changes: Changes, controls_by_key: Mapping[str, Answer]) -> dict[str, str]:
    """Return by key the reasons why its value is wrong; under "" the problems of an error that belong to no key.

    A reason does not repeat the help of its key, which a page shows beneath the control. A number with a comma has a
    reason of its own. Its comma is not read as a decimal point, because 1,000 may be a thousand.
    """
    values = {key: value for key, sign, value in (change.partition("=") for change in changes) if sign}
    keys = {f"--set {change}": change.partition("=")[0] for change in changes}
    reasons: dict[str, list[str]] = {}
    for problem in error.problems:
        key = problem.key or keys.get(problem.where, "")
        control = controls_by_key.get(key, {})
        help_text = control.get("help", "").rstrip(".")
        reason = problem.reason.replace(f"; {help_text}", "", 1) if help_text else problem.reason
        value = values.get(key, "").strip()
        if WITH_COMMA.fullmatch(value) and control.get("form") == "integer":
            reason = f"should be an integer without a comma (got {value})"
        elif WITH_COMMA.fullmatch(value) and not reason.startswith("should be a list"):
            reason = f"should be a number with a decimal point: {value.replace(',', '.')} (got {value})"
        elif key in values and not value:
            reason = "is empty: type a value, or undo the change"
        reasons.setdefault(key, []).append(reason if key else str(problem))
    return {key: "\n".join(texts) for key, texts in reasons.items()}


def _reason(error: BaseException) -> str:
    """Return why a run failed: the limit that it exceeded, or the exception and its innermost calls."""
    if isinstance(error, TimedOut):
        return f"The run {error}"
    return "".join(traceback.format_exception(error, limit=-INNERMOST)).strip()


def _new_folder(parent: Path, name: str) -> Path:
    """Create the folder NAME-1, or the first of NAME-2, NAME-3, ... that does not exist, and return it.

    Raises:
        OSError: if the folder cannot be created.
    """
    number = 1
    while (folder := parent / f"{name}-{number}").exists():
        number += 1
    folder.mkdir(parents=True)
    return folder
