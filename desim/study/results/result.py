"""The result that a sweep returns: its runs, as tables, figures, a data frame and files."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Self

from desim.analysis.metrics import METRICS
from desim.analysis.table_formats import SUFFIXES, Table, TableFormat, TabularResult, formatted
from desim.config.arguments import HintedAttributes, naming_arguments, value_text
from desim.config.extras import naming_extras
from desim.config.whole_files import write_whole
from desim.study.results import export
from desim.study.results import tables as sweep_tables
from desim.study.results.crossover import Crossover
from desim.study.results.runs import SHOWN, Group, SweepRuns, in_numeric_order, names_of_metrics
from desim.study.results.threshold import Threshold
from desim.study.store.file import StoreError
from desim.study.store.run_table import Row
from desim.study.store.store import Store

if TYPE_CHECKING:
    import pandas as pd

    from desim.analysis.drawing.plots import Axes, Figure, Style


@dataclass(frozen=True, repr=False)
class SweepResult(TabularResult, SweepRuns, HintedAttributes):
    """The runs of a sweep by configuration, as tables, figures, a data frame and files."""

    def _instead_of(self, name: str) -> str:
        """Return what to write instead of an attribute that the result of a sweep does not have."""
        metric = name if name in METRICS or name in self.units else SHOWN[0]
        return (
            f"result.to_frame() has the runs for pandas, result.to_frame()[{metric!r}] a column of them;"
            f" result.estimates({metric!r}) has the means, result.table([{metric!r}]) and result.plot({metric!r}) show"
            " them, and result.write('runs.csv') writes the runs"
        )

    @classmethod
    def of(
        cls,
        store: Store,
        configurations: Sequence[str] | None = None,
        failed: Mapping[tuple[str, int], Row] = MappingProxyType({}),
    ) -> Self:
        """Return the result of the runs in a store, for the configurations with the given hashes; None = all.

        Given configurations keep their order. A whole store may have configurations of several grids: the values of a
        key that takes only numbers ascend, and other values are in the order of the grid that was run last.

        The rows of `failed`, by (configuration hash, replication), replace the rows of the same runs in the store.

        Raises:
            StoreError: if the store is empty or damaged.
        """
        if "grid" not in store.about or not store.keys:
            raise StoreError(f"{store.path}: is empty")
        types = {"name": str, "grid": list[str], "seeds": str, "root seed": int}
        name, grid, seeds, root = (
            store.read_property(name_of_property, kind) for name_of_property, kind in types.items()
        )
        settings_by_hash = dict(store.configurations())
        for config, settings in settings_by_hash.items():
            if settings.keys() != set(grid):
                raise StoreError(f"{store.path}: configuration {config}: should have the settings {', '.join(grid)}")
        hashes = settings_by_hash if configurations is None else configurations
        # The first configuration belongs to the grid that was registered last; its keys are in the order of that grid.
        keys = tuple(next(iter(settings_by_hash.values())))
        groups = tuple(
            Group(
                {key: settings_by_hash[config][key] for key in keys},
                store.run_table(config, root, failed),
            )
            for config in hashes
        )
        if configurations is None:
            groups = in_numeric_order(keys, groups)
        units = {name: unit for name, unit in store.units.items() if name not in METRICS}
        fixed = store.read_property("scenario", dict[str, Any]) if "scenario" in store.about else {}
        return cls(name, keys, groups, seeds == "common", units, fixed.get("announce.start"))

    @naming_extras()
    @naming_arguments
    def plot(
        self,
        y: str = SHOWN[0],
        *,
        kind: Literal["means", "phase", "scatter", "contour"] | None = None,
        x: str | None = None,
        by: str | Sequence[str] = (),
        against: Mapping[str, Any] | None = None,
        labels: Mapping[str, str] = MappingProxyType({}),
        xlabel: str | None = None,
        ylabel: str | None = None,
        size: str | None = None,
        style: "Style" = None,
        ax: "Axes | None" = None,
    ) -> "Figure":
        """Return a figure of a metric; needs matplotlib (the extra `plot`).

        The figure can be resized, `figure.set_size_inches(3.5, 2.5)`, and written with `figure.savefig(file)`.

            swept.plot("active_time", x="network.latency.value", by="protocol", labels={"sap": "SAP (ours)"})
            swept.plot("active_time", against={"protocol": "sap"}, size="8.5cm")
            figure, axes = plt.subplots(1, 2, layout="constrained")
            swept.plot("active_time", ax=axes[0])

        Args:
            y: the name of the metric.
            kind: means: the mean of each configuration, or its paired difference from a reference; phase: the mean of
                each configuration as a heat map, with a key on each axis; scatter: the mean at each point of a design,
                over each key; contour: bands of the mean over two keys. None = scatter for a design, else means.
            x: of means: the key on the abscissa; None = the first key not in `by` that takes several numbers. If no
                key does: with `by`, the first other key with several values; else each configuration has a row.
            by: of means: the key or keys whose values name the lines; each combination of values of the other keys has
                a panel. By default all keys but `x` name the lines, in one panel.
            against: of means: values of some keys, such as {"protocol": "sap"}. The reference of a configuration is the
                one that has these values and is otherwise equal; the differences from the references are drawn, see
                `differences`. None = draw the means.
            labels: of means: texts to show in place of values, such as {"sap": "SAP (ours)"}. A label belongs to a
                value, or to the kind of a value, such as "sap" of "sap(tau=...)", if only one value has this kind. If
                one key names the lines, a label of this key is the title of the legend. Text between dollar signs is
                mathematics, here and in `xlabel` and `ylabel`.
            xlabel: the label of the abscissa; None = the name and the unit of what is on it.
            ylabel: the label of the ordinate; None = the name and the unit of what is on it.
            size: the width and perhaps the height, such as "8.5cm" or "8.5cmx6cm". A figure with a size has no title:
                put the title in the caption. None = as the panels need.
            style: a style of matplotlib on top of that of desim: rcParams, the name of a style, or a list of these.
            ax: the axes to draw on, for a figure of several; it keeps its size and title, and the legend then lies
                above the axes. None = a figure of its own, with the legend below.

        Raises:
            ValueError: if the sweep has no such metric, key, value or reference, an option does not fit the kind, the
                size is invalid, or several panels do not fit into `ax`.
            TypeError: if `ax` is not one pair of axes of matplotlib.
            ModuleNotFoundError: if matplotlib is not installed; the message names the extra.
        """
        from desim.study.results.design_figures import contour, scatter
        from desim.study.results.figures import means
        from desim.study.results.heat_maps import phase

        by = names_of_metrics(by)
        kinds = {"means": means, "phase": phase, "scatter": scatter, "contour": contour}
        of_means = {"x": x, "by": by, "against": against, "labels": labels}
        # An option that only the kind means has selects this kind.
        chosen = kind or ("means" if any(of_means.values()) else self.usual_kind)
        if chosen not in kinds:
            raise ValueError(f"kind should be {', '.join(list(kinds)[:-1])} or contour, got {value_text(kind)}")
        labelled = {"xlabel": xlabel, "ylabel": ylabel}
        options: dict[str, Any] = {"size": size, "style": style, "ax": ax}
        if chosen == "means":
            return means(self, y, **of_means, **labelled, **options)  # type: ignore[arg-type]
        unavailable = of_means if chosen == "phase" else of_means | labelled
        if refused := [name for name, value in unavailable.items() if value is not None and len(value)]:
            raise ValueError(f"a figure of {chosen} has no option {refused[0]!r}: it is one of means")
        return kinds[chosen](self, y, **(options | labelled if chosen == "phase" else options))

    @property
    def usual_kind(self) -> Literal["means", "scatter"]:
        """The kind of figure that suits: scatter if a design drew the numbers of several keys, else means."""
        return "scatter" if self.drawn_keys else "means"

    @naming_arguments
    def table(
        self,
        metrics: Sequence[str] = SHOWN,
        *,
        against: Mapping[str, Any] | None = None,
        format: TableFormat = "text",  # noqa: A002 - the usual word
        labels: Mapping[str, str] = MappingProxyType({}),
        without: Sequence[str] = (),
    ) -> str:
        """Return the table of means, the table of paired differences and the notes (failed runs, warnings).

            print(swept.table(["active_time"], format="latex"))

        The reference of a difference has the values `against`, or the first value of the first key with several values,
        and is otherwise equal. Independent seeds have no table of differences.

        Args:
            metrics: the names of the metrics.
            against: values of some keys, which the references have; None = the first value of the first key.
            format: text: aligned, for terminals; latex: tabulars with the rules of booktabs, without a caption;
                markdown: tables of GitHub's Markdown. Names are escaped.
            labels: texts to show in place of keys, values, metrics, and the heads "runs", "captured" and "pairs".
            without: the heads of columns to be left out, such as "captured".

        Raises:
            ValueError: if the sweep has no such metric, there is no such format, or a label or a column to be left out
                belongs to nothing in the tables.
        """
        metrics, without = names_of_metrics(metrics), names_of_metrics(without)
        notes = sweep_tables.notes(self, metrics)
        tables = self.tables(metrics, against=against)
        if labels or without:
            tables = sweep_tables.relabelled(self, tables, metrics, labels, without)
        key_columns = len(self.keys) - sum(key in without for key in self.keys)
        return formatted(tables, notes, format, right_from=key_columns)

    @naming_arguments
    def tables(self, metrics: Sequence[str] = SHOWN, *, against: Mapping[str, Any] | None = None) -> list[Table]:
        """Return each table as its title and rows of text; the first row is the header."""
        return list(sweep_tables.tables(self, names_of_metrics(metrics), against))

    def document(self, metrics: Sequence[str] = SHOWN, against: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return means, half widths and paired differences as JSON-compatible values; None where undefined.

        The differences are those of `table` with the same `against`.
        """
        return sweep_tables.document(self, names_of_metrics(metrics), against)

    @naming_arguments
    def crossover(
        self,
        metric: str,
        key: str,
        a: Mapping[str, Any],
        b: Mapping[str, Any],
        *,
        where: Mapping[str, Any] | None = None,
        confidence: float = 0.95,
    ) -> Crossover:
        """Return the value of a key from which one of two curves is better than the other, with an interval.

            swept.crossover("active_time", "network.latency.value", {"protocol": "sap"}, {"protocol": "cbba"})

        The curves are the means over the finite values of the key, joined by straight lines, so the values should lie
        close together where the curves cross. The interval is Fieller's, for runs paired by seed: it holds the points
        at which a paired t test does not tell the curves apart; see `desim.study.results.crossover`.

        Args:
            metric: the name of the metric.
            key: a key of the grid that takes numbers.
            a: the values of other keys on the first curve.
            b: the values of these keys on the second curve.
            where: the values of the other keys that take several.
            confidence: the probability that the interval covers the crossing.

        Raises:
            ValueError: if the sweep has no such metric, key or value, another key has several values on a curve, fewer
                than two values of the key or two seeds are common to both curves, or seeds are independent.
        """
        return Crossover.of(self, metric, key, a, b, where, confidence)

    @naming_arguments
    def threshold(
        self,
        metric: str,
        key: str,
        over: float,
        *,
        baseline: Any = None,
        where: Mapping[str, Any] | None = None,
        confidence: float = 0.95,
    ) -> Threshold:
        """Return the value of a key from which a metric exceeds its baseline by a share, with an interval.

            swept.threshold("active_time", "network.loss.p", 0.1)

        The runs are paired by seed, and the curve of means is that of `crossover`. The relative difference at the end
        of the curve has Fieller's interval; see `desim.study.results.threshold`.

        Args:
            metric: the name of the metric; its mean at the baseline should be positive.
            key: a key of the grid that takes numbers.
            over: the share of the baseline's mean: 0.1 = more than 10 % over it, -0.1 = more than 10 % under it.
            baseline: the value of the key that the others are compared with; None = the least one.
            where: the values of the other keys that take several.
            confidence: the probability that the interval covers the value of the key.

        Raises:
            ValueError: if the sweep has no such metric, key or value, the mean at the baseline is not positive, there
                are fewer than two values of the key or two seeds with a value at each, or seeds are independent.
        """
        return Threshold.of(self, metric, key, over, baseline, where, confidence)

    def __repr__(self) -> str:
        heading = sweep_tables.heading(self, ())
        return f"<{type(self).__name__} of {heading.partition(';')[0]}, over {', '.join(self.keys)}>"

    def _notes(self) -> Iterator[str]:
        return sweep_tables.notes(self, SHOWN)

    def records(self) -> Iterator[dict[str, Any]]:
        """Yield each run as a flat record: settings, replication, seed, status, metrics and error."""
        return export.records(self)

    def to_frame(self) -> "pd.DataFrame":
        """Return a data frame with a row per run (needs the extra `frame`); see `records`.

        Raises:
            ImportError: if pandas is not installed.
        """
        return export.data_frame(self)

    @naming_arguments
    def write(
        self,
        file: str | Path,
        metrics: Sequence[str] = SHOWN,
        *,
        labels: Mapping[str, str] = MappingProxyType({}),
        without: Sequence[str] = (),
    ) -> None:
        """Write a row per run to a file, .csv or .parquet (needs the extra `frame`); or write the tables, .tex or .md.

        Args:
            file: the file; its suffix sets the format.
            metrics: the metrics in the tables of a .tex or .md; the other files have all.
            labels: of the tables; see `table`.
            without: the columns that the tables leave out; see `table`.

        Raises:
            ValueError: if the file has another suffix, the sweep has no such metric, a label or a column belongs to
                nothing, or is given for a file that has no tables.
            ImportError: if a package for Parquet is not installed.
            OSError: if the file cannot be written.
        """
        without = names_of_metrics(without)
        if (path := Path(file)).suffix in SUFFIXES:
            table = self.table(metrics, format=SUFFIXES[path.suffix], labels=labels, without=without)
            write_whole(path, f"{table}\n".encode())
        elif labels or without:
            raise ValueError(f"{path}: labels and columns to be left out are those of tables, .tex or .md")
        else:
            export.write(self, path)
