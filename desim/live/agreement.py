"""Live against simulated: whether runs of a scenario over sockets have the metrics of its simulation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import copysign, inf
from typing import Any, NamedTuple, get_args

from desim.analysis.measuring import summary
from desim.analysis.metrics import METRICS
from desim.analysis.statistics import Estimate, mean, paired, t_quantile
from desim.analysis.tables import aligned, decimals_of, number
from desim.config.arguments import scenario_argument
from desim.config.number_texts import counted
from desim.config.python_numbers import whole
from desim.kernel.core.portable_math import portable_sum
from desim.kernel.core.units import SECOND
from desim.live.live_runs import LinkKind, runs
from desim.live.result import LateKind, LiveResult, lateness_of
from desim.live.wall_clock import Lateness
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, run
from desim.study.workers.batch import seeds_from

GATE = 0.02
"""The 99th percentile of lateness, s, above which a comparison says nothing."""
FALSE_ALARMS = 0.05
"""An upper bound, by Bonferroni's inequality, on the probability that a metric seems to differ although none does."""
SHOWN = ("active_time", "idle_time", "crowded_time", "end_time", "decisions", "messages_sent", "messages_lost")
"""The metrics that are compared."""
CONFIDENCE = 1.0 - FALSE_ALARMS / len(SHOWN)
"""The confidence of the interval by which one metric is judged."""


class Row(NamedTuple):
    """A metric, live and simulated."""

    metric: str
    unit: str
    live: Estimate
    simulated: Estimate
    difference: Estimate
    """Live minus simulated, paired by seed."""
    margin: float
    """The part of the difference that late actions explain: of a metric in s, the mean over the runs of the summed
    lateness of all changes of actions; of any other metric, 0."""

    @property
    def errors(self) -> float:
        """The difference beyond the margin, in standard errors; infinite if all pairs differ by the same amount."""
        if not self._beyond:
            return 0.0
        error = self.difference.standard_error
        return copysign(self._beyond / error if error else inf, self.difference.mean)

    @property
    def agrees(self) -> bool:
        """Whether the difference beyond the margin cannot be told apart from 0; see `FALSE_ALARMS`."""
        return not replace(self.difference, mean=self._beyond).excludes_0(CONFIDENCE)

    @property
    def _beyond(self) -> float:
        return max(abs(self.difference.mean) - self.margin, 0.0)


@dataclass(frozen=True)
class Agreement:
    """Runs of a scenario live and simulated, with the same seeds.

    Attributes:
        scenario: the experiment.
        live: the results of the live runs.
        simulated: the results of the simulated runs, in the same order.
    """

    scenario: Scenario
    live: Sequence[LiveResult]
    simulated: Sequence[Result]

    @property
    def p99(self) -> float:
        """The 99th percentile of the lateness of the timers of all runs, s."""
        return self.late("timers").p99

    def late(self, name: LateKind) -> Lateness:
        """Return how late timers, deliveries of messages or orders were in all runs."""
        return lateness_of(self.live, name)

    @property
    def is_on_time(self) -> bool:
        """Whether the timers were early enough for the comparison to say anything; see `GATE`."""
        return self.p99 <= GATE

    @property
    def rows(self) -> list[Row]:
        """The metrics, live and simulated."""
        live, simulated = [list(map(summary, results)) for results in (self.live, self.simulated)]
        orders = [lateness for result in self.live for lateness in result.conduct.orders]
        margin_of_times = portable_sum(orders) / SECOND / len(self.live)
        rows = []
        for name in SHOWN:
            first, second = [[getattr(run, name) for run in runs] for runs in (live, simulated)]
            margin = margin_of_times if (unit := METRICS[name].unit) == "s" else 0.0
            rows.append(Row(name, unit, mean(first), mean(second), paired(first, second), margin))
        return rows

    @property
    def agrees(self) -> bool | None:
        """Whether all metrics agree; None if the timers were too late to say."""
        return all(row.agrees for row in self.rows) if self.is_on_time else None

    def table(self) -> str:
        """Return the comparison as text."""
        head = ("", "live", "simulated", "difference", "late", "s.e.", "in s.e.", "")
        digits = [decimals_of(row.difference.standard_error) for row in self.rows]
        rows = [
            (
                f"{row.metric}{f', {row.unit}' if row.unit else ''}",
                *(number(value, decimals) for value in (row.live.mean, row.simulated.mean, row.difference.mean)),
                number(row.margin, decimals),
                number(row.difference.standard_error, decimals),
                f"{row.errors:+z.1f}",
                "agrees" if row.agrees else "differs",
            )
            for row, decimals in zip(self.rows, digits, strict=True)
        ]
        error, orders = self.late("deliveries"), self.late("orders")
        return "\n".join(
            [
                f"{self.scenario.name}, {self.scenario.protocol_name}: {counted(len(self.live), 'run')} live and"
                f" simulated, paired by seed; a metric differs by more than"
                f" {t_quantile(len(self.live) - 1, CONFIDENCE):.3g} standard errors beyond what late actions explain,"
                f" at a level of {100.0 * FALSE_ALARMS:g} % for all {len(SHOWN)} together (Bonferroni)",
                aligned([head, *rows]),
                f"timers late: 99 % of them at most {1e3 * self.p99:.1f} ms; deliveries late: median"
                f" {1e3 * error.median:.2f} ms, 99 % at most {1e3 * error.p99:.1f} ms; actions late: median"
                f" {1e3 * orders.median:.2f} ms",
                self._verdict(),
            ]
        )

    def _verdict(self) -> str:
        if not self.is_on_time:
            return f"no verdict: timers were late by more than {1e3 * GATE:g} ms; try again on an idle machine"
        if self.agrees:
            return f"live and simulated agree, as far as {len(self.live)} runs of each tell"
        return "live and simulated differ"

    def document(self) -> dict[str, Any]:
        """Return the comparison as JSON types."""
        rows = [
            {
                "metric": row.metric,
                "unit": row.unit,
                "live": row.live.mean,
                "simulated": row.simulated.mean,
                "difference": row.difference.mean,
                "margin": row.margin,
                "standard_error": row.difference.standard_error,
                "agrees": row.agrees,
            }
            for row in self.rows
        ]
        late = {name: self.late(name)._asdict() for name in get_args(LateKind)}
        return {"runs": len(self.live), "agrees": self.agrees, "level": FALSE_ALARMS, **late, "rows": rows}


def compare(
    scenario: Scenario,
    count: int = 20,
    seed: int | None = None,
    *,
    simulated: Scenario | None = None,
    at_once: int = 1,
    links: LinkKind = "drawn",
    finished: Callable[[LiveResult], object] | None = None,
) -> Agreement:
    """Run a scenario live and simulated with the same seeds, and compare the metrics.

    Args:
        scenario: the experiment.
        count: number of runs of each kind, at least 2.
        seed: root seed, as of `desim run -n`; None: that of the scenario.
        simulated: another experiment to simulate, as a control that should differ; None: the same.
        at_once: number of live runs at the same time.
        links: how the links of the live runs are made; see `desim.live.live_runs.run`.
        finished: called with each live result.

    Raises:
        ValueError: if there are fewer than 2 runs, which have no standard error; and as `desim.live.live_runs.run`.
        LiveError: as `desim.live.live_runs.run`.
        NamespaceError: as `desim.live.live_runs.run`.
    """
    scenario_argument(Scenario).check(scenario, "compare")
    if simulated is not None:
        scenario_argument(Scenario).check(simulated, "compare")
    if (count := whole(count, "count")) < 2:
        raise ValueError(f"a comparison needs at least 2 runs of each kind (got {count})")
    seeds = seeds_from(scenario.seed if seed is None else seed, count)
    live = runs(scenario, seeds, at_once=at_once, links=links, finished=finished)
    return Agreement(scenario, live, [run(simulated or scenario, seed) for seed in seeds])
