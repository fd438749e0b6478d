"""The session of one user of a playground: its workers, its pending requests, and its comparisons over seeds."""

from collections.abc import Generator
from functools import partial
from typing import TYPE_CHECKING, Any

from desim.results import provenance
from desim.study.workers.batch import seeds_from
from desim.study.workers.workers import Workers
from desim.view.pages.answers import Answer, Changes
from desim.view.pages.metric_rows import differences_over_seeds, named_metrics_of
from desim.view.pages.playground import Playground

if TYPE_CHECKING:
    from concurrent.futures import Future

    from desim.analysis.metrics import Summary

MAX_SEEDS = 1000
"""The largest number of seeds of a comparison."""


class Session:
    """A playground and the workers that perform its runs, for one user with one page or several.

    Each page has a name of its own, the argument `page`. A request cancels earlier ones of the same page only.

    Args:
        playground: the scenario to play with.
        workers: the workers that perform the runs.
    """

    def __init__(self, playground: Playground, workers: Workers):
        self.playground, self.workers = playground, workers
        self._last: dict[str, Future[Any]] = {}
        """By page, the run that it requested last, until it ends."""
        self._comparisons: dict[str, object] = {}
        """By page, an object that stands for its comparison; a comparison ends when its object is removed."""

    def warm_up(self) -> None:
        """Let the workers import what a run needs, and return without waiting for them."""
        for _ in range(self.workers.count):
            self._submit(partial(self.playground.answer, self.playground.start, None))

    def run(self, now: Changes, pinned: Changes | None, page: str = "") -> Answer:
        """Let a worker compute `Playground.answer`; cancel the last request of the page if it has not begun."""
        if (last := self._last.get(page)) is not None:
            last.cancel()
        future = None
        try:
            future = self._last[page] = self._submit(partial(self.playground.answer, now, pinned))
            return dict(self._result(future))
        except Exception as error:  # the worker died or could not start, or the request was cancelled
            is_cancelled = future is not None and future.cancelled()
            why = "a later change came first" if is_cancelled else f"{type(error).__name__}: {error}"
            return {"controls": self.playground.controls(now), "errors": {"": why}}
        finally:
            if future is not None and self._last.get(page) is future:
                self._last.pop(page, None)

    def save(self, changes: Changes) -> Answer:
        """Save a run in a worker; see `Playground.save`."""
        playground = self.playground
        try:
            scenario = playground.scenario(changes)
            document = provenance.document(provenance.RUN, scenario, seed=scenario.seed, folder=playground.folder)
            return dict(self._result(self._submit(partial(playground.save, changes, document))))
        except Exception as error:
            return {"error": f"{type(error).__name__}: {error}"}

    def cancel(self, page: str = "") -> None:
        """End the comparison of a page: runs that have not begun are left out."""
        self._comparisons.pop(page, None)

    def compare(self, now: Changes, pinned: Changes, count: int, page: str = "") -> Generator[Answer, None, None]:
        """Run both scenarios with equal seeds; after each pair of runs, yield the mean differences so far.

        The seeds are those of several runs of the scenario with the changes `now`, see `seeds_from`. An earlier
        comparison of the same page is cancelled.

        Raises:
            ScenarioError: if a scenario is not valid.
        """
        scenario = self.playground.scenario(now)
        self.playground.scenario(pinned)
        comparison = self._comparisons[page] = object()
        seeds = list(seeds_from(scenario.seed, count))[::-1]  # `pop` takes the last
        pending: set[Future[Any]] = set()
        pairs: list[tuple[Summary, Summary]] = []
        failures: list[str] = []
        try:
            while (seeds or pending) and comparison is self._comparisons.get(page):
                while seeds and len(pending) < self.workers.count:
                    pending.add(self._submit(partial(self.playground.pair, now, pinned, seeds.pop())))
                for future in self.workers.done(pending):
                    pending.remove(future)
                    try:
                        outcome = self._result(future)
                    except Exception as error:
                        outcome = f"{type(error).__name__}: {error}"
                    (failures if isinstance(outcome, str) else pairs).append(outcome)
                    yield differences_over_seeds(pairs, failures, count, named_metrics_of(scenario))
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


def is_request(body: Any) -> bool:
    """Return whether a value has the form of a request: changes `now` and `pinned`, a `count` of seeds, and its `page`.

    The default of a missing `pinned`, `count` or `page` is added to the value.
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
