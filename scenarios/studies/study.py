"""The common part of all studies: their options, and the output of their results."""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from desim.analysis.statistics import Estimate
from desim.analysis.tables import as_json
from desim.cli.program import Program
from desim.config.json_numbers import to_json
from desim.config.whole_files import write_whole
from desim.results import provenance
from desim.results.run_folder import can_plot
from desim.study.workers.batch import run_many, seeds_from

if TYPE_CHECKING:
    from desim import Result, Scenario
    from desim.analysis.drawing.plots import Axes, Figure

Key = TypeVar("Key", bound=tuple[Any, ...])
Measured = TypeVar("Measured")
SCENARIOS = Path(__file__).parents[1]
"""Folder of the scenario files."""


@dataclass(frozen=True)
class Options:
    """The options of a study."""

    name: str
    runs: int
    jobs: int
    seed: int
    out: Path
    as_json: bool
    extra: Mapping[str, Any] = field(default_factory=dict)
    """Options that only this study has, by name."""

    def measure(
        self, scenarios: Sequence["Scenario"], label: str, metric: Callable[["Result"], Measured]
    ) -> list[list[Measured]]:
        """Run each scenario and return the metric of each of its runs; run k of every scenario has the same seed."""
        seeds = seeds_from(self.seed, self.runs)
        values = iter(
            run_many([(scenario, seed) for scenario in scenarios for seed in seeds], self.jobs, label, metric)
        )
        return [[next(values) for _ in seeds] for _ in scenarios]

    def measure_each(
        self,
        keys: Iterable[Key],
        scenario: Callable[..., "Scenario"],
        label: str,
        metric: Callable[["Result"], Measured],
    ) -> dict[Key, list[Measured]]:
        """Return the values of a metric in the runs of several scenarios, by key.

        `scenario` returns the scenario of a key, given its entries as arguments.
        """
        keys = list(keys)
        return dict(zip(keys, self.measure([scenario(*key) for key in keys], label, metric), strict=True))

    def show(self, document: dict[str, Any], table: str, figure: Callable[[], "Figure"] | None = None) -> None:
        """Print the table, or the document as JSON if requested; write both, and any figure, to the folder `out`.

        An object in the document, such as the results of one setting, is written as its attributes by name.
        NAME.run.json, where NAME is the name of the study, records the provenance of these files. Studies can share a
        folder, because the names of all files of a study begin with NAME.
        """
        document = {"study": self.name, "runs": self.runs, "seed": self.seed} | document
        text = json.dumps(to_json(document), indent=2, allow_nan=False, default=_in_json_types)
        click.echo(text if self.as_json else table)
        self.out.mkdir(parents=True, exist_ok=True)
        stem = self.out / self.name
        write_whole(stem.with_suffix(".json"), f"{text}\n".encode())
        provenance.write(
            self.out, provenance.document(self.name, seed=self.seed, runs=self.runs), f"{self.name}.{provenance.FILE}"
        )
        write_whole(stem.with_suffix(".txt"), f"{table}\n".encode())
        if figure is not None:
            self.save_figures(lambda: [(self.name, figure())])

    def save_figures(self, figures: Callable[[], Iterable[tuple[str, "Figure"]]], *, dpi: int = 150) -> None:
        """Write the named figures to the folder `out`, as SVG and as PNG with `dpi` dots per inch.

        Without matplotlib no figure is drawn, and a line on stderr says so.
        """
        if not can_plot():
            click.echo("no picture without matplotlib: pip install 'pursuit-desim[plot]'", err=True)
            return
        from desim.analysis.drawing.plots import save

        for name, figure in figures():
            for path in save(figure, self.out / name, dpi=dpi):
                click.echo(f"wrote {path}", err=True)


class NumberRange(click.FloatRange):
    """A range of numbers. It refuses nan, which is neither below nor above any bound."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number that a text denotes."""
        number: float = super().convert(value, param, ctx)
        if isnan(number):
            self.fail("nan is not in the range", param, ctx)
        return number


def metrics_of(*metrics: Callable[["Result"], Any]) -> Callable[["Result"], tuple[Any, ...]]:
    """Return a metric of runs whose value is the tuple of the values of several metrics."""
    return lambda result: tuple(metric(result) for metric in metrics)


def draw_estimates(axes: "Axes", x: Sequence[float], estimates: Sequence[Estimate], **look: Any) -> None:
    """Draw estimates as a line with marks, and their 95 % intervals as bars."""
    bars = list(zip(*(estimate.bars for estimate in estimates), strict=True))
    axes.errorbar(x, [estimate.mean for estimate in estimates], bars, **{"ms": 3, "lw": 1.0, "elinewidth": 0.7} | look)


def _in_json_types(value: Any) -> Any:
    return as_json(value) if isinstance(value, Estimate) else to_json(vars(value))


def expected_time(seconds: float, runs: int, jobs: int, once: float = 0.0) -> str:
    """Return how long a study takes, as text.

    Args:
        seconds: CPU time of one run of each cell, s, as measured.
        runs: number of runs per cell.
        jobs: number of worker processes; 0 = one per core.
        once: CPU time of the work that does not depend on the number of runs, such as a training, s.
    """
    workers = jobs or os.cpu_count() or 1
    minutes = (seconds * runs + once) / 60.0
    cores = "1 idle core" if workers == 1 else f"{workers} idle cores"
    unit, length = ("min", 1.0) if minutes < 120.0 else ("h", 60.0)
    return f"takes about {minutes / length:.2g} {unit} of CPU time, {minutes / length / workers:.2g} {unit} on {cores}"


def study(
    name: str, doc: str | None, runs: int, *options: click.Option, seconds: float | None = None, once: float = 0.0
) -> Callable[[Callable[[Options], None]], click.Command]:
    """Return a decorator that turns a function of `Options` into the command of a study.

    Args:
        name: name of the study.
        doc: help text of the command.
        runs: default number of runs per cell, which is one combination of settings.
        options: options that only this study has; see `Options.extra`.
        seconds: CPU time of one run of each cell, s, from which the command computes the expected time that it prints
            first; None: it prints none.
        once: CPU time of what does not depend on the number of runs, s.
    """

    def command(run: Callable[[Options], None]) -> click.Command:
        @click.command(name=name, help=doc, cls=Program)
        @click.option("--runs", type=click.IntRange(min=1), default=runs, show_default=True, help="Runs per cell.")
        @click.option("--jobs", type=click.IntRange(min=0), default=0, help="Worker processes; 0 = one per core.")
        @click.option(
            "--seed",
            type=click.IntRange(min=0),
            default=0,
            show_default=True,
            help="Root seed: run k has 1,000,000 S + k.",
        )
        @click.option(
            "--out", type=click.Path(path_type=Path), default=Path("out"), show_default=True, help="Output folder."
        )
        @click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")
        def main(runs: int, jobs: int, seed: int, out: Path, as_json: bool, **choices: Any) -> None:
            if seconds is not None:
                click.echo(f"{name} {expected_time(seconds, runs, jobs, once)}", err=True)
            try:
                out.mkdir(parents=True, exist_ok=True)  # before the runs, which may take hours
            except OSError as error:
                raise click.BadParameter(f"{out}: {error.strerror}", param_hint="--out") from error
            run(Options(name, runs, jobs, seed, out, as_json, choices))

        main.params.extend(options)
        return main

    return command
