"""A scenario to play with: its keys are changed one by one, and each run is compared with a pinned run.

A pinned run is one that the user has chosen as the reference. A control is the part of a page that changes one key.
The page of `desim play` (`desim.view.pages.play_server`) and the widget of notebooks (`desim.view.pages.widget`) show
what the functions here return. Each answer to a request of a page is a JSON object.
"""

import shlex
import traceback
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cloudpickle
import tomli_w

from desim.analysis.drawing import palette
from desim.analysis.metrics import METRICS, Metric, Summary, more_is, summary, unit_of, users_metrics, words
from desim.analysis.statistics import mean, paired
from desim.analysis.tables import with_half_width
from desim.config.file_names import folder_name
from desim.config.json_numbers import to_json
from desim.results import provenance, run_folder
from desim.scenario.checks import warnings
from desim.scenario.overrides import ScenarioError, Source
from desim.scenario.scenario import Scenario
from desim.scenario.toml import validate
from desim.simulation.run import Result, run
from desim.simulation.watchdog import TimedOut, within
from desim.study.workers.batch import seeds_from
from desim.study.workers.workers import Workers
from desim.view.pages.controls import controls
from desim.view.pages.replay import replay_page, with_recordings

if TYPE_CHECKING:
    from concurrent.futures import Future

FIRST = (
    "capture_time",
    "active_time",
    "misassigned_time",
    "handovers",
    "messages_sent",
    "messages_lost",
    "age_mean",
    "belief_error",
)
"""The metrics that are shown first, in their order."""
MAX_SEEDS = 1000
"""The largest number of seeds of a comparison."""
INNERMOST = 3
"""The number of innermost calls that are shown of the traceback of a run that failed."""
KEPT = 3
"""The number of results that a process keeps: the pinned run is needed again with every change."""
Answer = dict[str, Any]
"""A JSON object."""
Changes = Sequence[str]
"""Changes of keys, each KEY=VALUE as in `--set`."""


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
            ScenarioError: if it is not valid.
        """
        return with_recordings(validate(self.changed(changes)))

    def result(self, changes: Changes) -> Result:
        """Run the scenario with changes, or return the result of an earlier equal call if it is still kept (`KEPT`).

        Raises:
            ScenarioError: if it is not valid.
            TimedOut: if it takes longer than the time limit.
        """
        return _result(_Request(cloudpickle.dumps((self, tuple(changes))), self, changes))

    def answer(self, now: Changes, pinned: Changes | None) -> Answer:
        """Run the scenario and return all that is shown of it.

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
            return _json({"errors": _by_key(error, now), "controls": self.controls(now)})
        shown = {"controls": [asdict(control) for control in controls(scenario)], "texts": self.texts(now)}
        try:
            result, other = self.result(now), None if pinned is None else self.result(pinned)
            is_other = pinned is not None and sorted(pinned) != sorted(now)
            named_metrics = _own_metrics(scenario)
            with within(self.timeout):
                return _json(
                    shown
                    | {
                        "page": replay_page(result, other if is_other else None),
                        "metrics": list(
                            _compared(summary(result), None if other is None else summary(other), named_metrics)
                        ),
                        "seeds": [result.seed, None if other is None else other.seed],
                        "warnings": [f"{key}: {why}" for key, why in warnings(scenario)],
                    }
                )
        except (Exception, TimedOut) as error:
            return _json(shown | {"errors": {"": _reason(error)}})

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
        """Return the scenario with changes as the text of a file, as a command, and as a program."""
        source = self.changed(changes)
        file = str(self.file or f"{self.name}.toml")
        allow = ["--allow-import"] if self.file is not None and self.base.allow_import else []
        options = [word for change in changes for word in ("--set", change)] if self.file is not None else []
        arguments = f", {list(changes)!r}" if options else ""
        return {
            "toml": tomli_w.dumps(Source.of(validate(source)).tables if self.file is None else source.tables),
            "command": shlex.join(["desim", "run", file, *allow, *options]),
            "python": "from desim import load, run\n\n"
            f"result = run(load({file!r}{arguments}{', allow_import=True' if allow else ''}))\n",
        }

    def save(self, changes: Changes, made: provenance.Document) -> Answer:
        """Run the scenario, and write the run to the first of out/NAME-1, out/NAME-2, ... that does not exist.

        `desim run --from` repeats the run from the run.json in this folder.

        Args:
            changes: the changes of the scenario.
            made: the provenance of the run.

        Returns:
            The `folder`, or an `error`.
        """
        try:
            result = self.result(changes)
            folder = _new_folder(Path("out"), folder_name(result.scenario.name))
            run_folder.write(result, folder, made)
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


class Session:
    """A playground and the workers that perform its runs, for one user with one page or several.

    Each page has a name of its own, the argument `page`. A request cancels earlier ones of the same page only.

    Args:
        playground: the scenario to play with.
        workers: they perform the runs.
    """

    def __init__(self, playground: Playground, workers: Workers):
        self.playground, self.workers = playground, workers
        self._last: dict[str, Future[Any]] = {}
        self._comparisons: dict[str, object] = {}
        """By page, an object of its own for the comparison that is under way."""

    def warm_up(self) -> None:
        """Let the workers import what a run needs, and return without waiting for them."""
        for _ in range(self.workers.count):
            self._submit(partial(self.playground.answer, self.playground.start, None))

    def run(self, now: Changes, pinned: Changes | None, page: str = "") -> Answer:
        """Let a worker compute `Playground.answer`; cancel the last request of the page if it has not begun."""
        if (last := self._last.get(page)) is not None:
            last.cancel()
        future = self._last[page] = self._submit(partial(self.playground.answer, now, pinned))
        try:
            return dict(self._result(future))
        except Exception as error:  # the worker died, or the request was cancelled
            why = "a later change came first" if future.cancelled() else f"{type(error).__name__}: {error}"
            return {"controls": self.playground.controls(now), "errors": {"": why}}
        finally:
            if self._last.get(page) is future:
                self._last.pop(page, None)

    def save(self, changes: Changes) -> Answer:
        """Save a run in a worker; see `Playground.save`."""
        ground = self.playground
        try:
            scenario = ground.scenario(changes)
            made = provenance.document(provenance.RUN, scenario, seed=scenario.seed, folder=ground.folder)
            return dict(self._result(self._submit(partial(ground.save, changes, made))))
        except Exception as error:
            return {"error": f"{type(error).__name__}: {error}"}

    def cancel(self, page: str = "") -> None:
        """End the comparison of a page: runs that have not begun are left out."""
        self._comparisons.pop(page, None)

    def compare(self, now: Changes, pinned: Changes, count: int, page: str = "") -> Generator[Answer, None, None]:
        """Run both scenarios with equal seeds, and yield after each pair of runs what is known of the differences.

        The seeds are those of several runs of the scenario with the changes `now`, see `seeds_from`. An earlier
        comparison of the same page is cancelled.

        Raises:
            ScenarioError: if a scenario is not valid.
        """
        scenario = self.playground.scenario(now)
        self.playground.scenario(pinned)
        comparison = self._comparisons[page] = object()
        waiting = list(seeds_from(scenario.seed, count))[::-1]
        pending: set[Future[Any]] = set()
        pairs: list[tuple[Summary, Summary]] = []
        failures: list[str] = []
        try:
            while (waiting or pending) and comparison is self._comparisons.get(page):
                while waiting and len(pending) < self.workers.count:
                    pending.add(self._submit(partial(self.playground.pair, now, pinned, waiting.pop())))
                for future in self.workers.done(pending):
                    pending.remove(future)
                    try:
                        outcome = self._result(future)
                    except Exception as error:
                        outcome = f"{type(error).__name__}: {error}"
                    (failures if isinstance(outcome, str) else pairs).append(outcome)
                    yield _differences(pairs, failures, count, _own_metrics(scenario))
        finally:
            for future in pending:
                future.cancel()
            if comparison is self._comparisons.get(page):
                self.cancel(page)

    def _submit(self, call: "partial[Any]") -> "Future[Any]":
        """Submit a call; workers that died since the last call are replaced."""
        try:
            return self.workers.submit(call)
        except Exception as error:
            if not self.workers.died(error):
                raise
            self.workers.renew()
            return self.workers.submit(call)

    def _result(self, future: "Future[Any]") -> Any:
        """Return the result of a call; if its worker died, the workers are replaced."""
        try:
            return self.workers.result(future)
        except Exception as error:
            if self.workers.died(error):
                self.workers.renew()
            raise


def style() -> str:
    """Return the style sheet of the page and of the widget."""
    hues = (
        f".play {{ --active: {palette.ACTIVE}; --better: #00694a; --worse: #a33f00; }}\n"
        f':is([data-theme="dark"], [data-theme="dark"] .play) {{ --active: {palette.SKY}; --better: #2ecc9b;'
        " --worse: #ff8534; }\n"
    )
    return hues + files("desim.view.pages").joinpath("play.css").read_text(encoding="utf-8")


def is_request(body: Any) -> bool:
    """Return whether a value has the form of a request: changes `now` and `pinned`, a `count` of seeds, and its `page`.

    A request without `pinned`, `count` or `page` gets their defaults.
    """
    if not isinstance(body, dict):
        return False
    now, pinned, count = body.get("now"), body.setdefault("pinned", None), body.setdefault("count", 1)
    is_of_page = isinstance(body.setdefault("page", ""), str)
    changes = [now] if pinned is None else [now, pinned]
    has_changes = all(
        isinstance(request_changes, list) and all(isinstance(change, str) for change in request_changes)
        for request_changes in changes
    )
    return has_changes and is_of_page and isinstance(count, int) and 1 <= count <= MAX_SEEDS


def _own_metrics(scenario: Scenario) -> Mapping[str, Metric]:
    """Return the metrics that a scenario names, by name."""
    return dict(users_metrics(scenario.record.metrics))


def _differences(
    pairs: Sequence[tuple[Summary, Summary]], failures: Sequence[str], of: int, named_metrics: Mapping[str, Metric]
) -> Answer:
    """Return the progress of a comparison, and the mean difference of each metric with its 95 % interval.

    `named_metrics` are the user's metrics by name.
    """
    rows = []
    for name in _ordered(pairs[0][0]) if pairs else []:
        complete = [
            (float(now[name]), float(pinned[name]))
            for now, pinned in pairs
            if now.get(name) is not None and pinned.get(name) is not None
        ]
        if complete:
            values, pinned_values = map(list, zip(*complete, strict=True))
            difference = paired(values, pinned_values)
            rows.append(
                _row(name, pairs[0][0], named_metrics)
                | {
                    "now": _formatted(mean(values).mean),
                    "pinned": _formatted(mean(pinned_values).mean),
                    "difference": with_half_width(difference, difference.count, sign="+"),
                    "differs": abs(difference.mean) > difference.half_width,
                    "sign": difference.mean,
                    "count": difference.count,
                }
            )
    done = len(pairs) + len(failures)
    return _json({"done": done, "of": of, "failed": len(failures), "failure": failures[:1], "metrics": rows})


def _compared(now: Summary, pinned: Summary | None, named_metrics: Mapping[str, Metric]) -> Iterator[Answer]:
    """Yield the value of each numeric metric of a run, and its difference from that of the pinned run.

    `named_metrics` are the user's metrics by name.
    """
    for name in _ordered(now):
        value, other = now[name], None if pinned is None else pinned.get(name)
        if value is None and other is None:
            continue
        row = _row(name, now, named_metrics) | {"value": _formatted(value)}
        if value is not None and other is not None and value != other:  # inf - inf is nan
            difference = float(value) - float(other)
            text = _formatted(difference, "+")
            if float(text.replace(",", "")):
                row |= {"difference": text, "sign": difference}
        yield row


def _row(name: str, metrics: Summary, named_metrics: Mapping[str, Metric]) -> Answer:
    """Return the name of a metric, its unit and whether more of it is better or worse."""
    row = {"name": words(name), "unit": unit_of(name, metrics.units), "more_is": more_is(name, named_metrics)}
    return row | {"first": name in FIRST}


def _ordered(metrics: Summary) -> list[str]:
    """Return the names of the metrics that are numbers, beginning with `FIRST`."""
    names = [name for name in metrics if name not in METRICS or METRICS[name].is_number]
    return [*FIRST, *(name for name in names if name not in FIRST)]


def _formatted(value: Any, sign: str = "") -> str:
    """Return a value of a metric as text."""
    if value is None or value != value:
        return "\N{EN DASH}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if float(value).is_integer() and abs(value) < 1e15:
        return f"{int(value):{sign},}"
    return f"{value:{sign},.{3 if abs(value) < 100.0 else 1}f}"


def _by_key(error: ScenarioError, changes: Changes) -> dict[str, str]:
    """Return the reasons of each key in the problems of an error; under "" those that belong to no key."""
    keys = {f"--set {change}": change.partition("=")[0] for change in changes}
    reasons: dict[str, list[str]] = {}
    for problem in error.problems:
        key = problem.key or keys.get(problem.where, "")
        reasons.setdefault(key, []).append(problem.reason if key else str(problem))
    return {key: "\n".join(texts) for key, texts in reasons.items()}


def _reason(error: BaseException) -> str:
    """Return why a run failed: the limit that it exceeded, or the exception and its innermost calls."""
    if isinstance(error, TimedOut):
        return f"The run {error}"
    return "".join(traceback.format_exception(error, limit=-INNERMOST)).strip()


def _json(answer: Answer) -> Answer:
    """Return an answer with infinity and NaN as strings."""
    return dict(to_json(answer))


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
