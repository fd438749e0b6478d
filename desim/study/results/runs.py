"""The runs of a sweep by configuration: their means and paired differences."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from desim.analysis.measuring import check_numeric
from desim.analysis.metrics import words
from desim.analysis.statistics import Estimate, mean, paired, share
from desim.config.arguments import value_text, without_addresses
from desim.config.arrays import Floats
from desim.config.number_texts import counted
from desim.config.python_numbers import as_python
from desim.config.suggestion import close_to
from desim.study.plan.configurations import in_words, label
from desim.study.store.run_table import EXACT, Row, RunTable

SHOWN = ("active_time", "capture_time", "messages_sent")
"""The metrics that a table shows by default."""
CAPTURE_TIMES = frozenset({"capture_time", "mean_capture_time"})
"""The metrics that a run without a capture lacks."""
MESSAGING = ("network.", "announce.")
"""The prefixes of keys that have an effect only if pursuers need messages."""
NO_MESSAGES_HINT = (
    "; a protocol may need no messages if all know the initial actions (`announce.start`) and see all positions"
    " (`announce.payload`), or if few pursuers could capture the evader in time"
)
START_RULES = {
    "announced": "pursuers announce their first actions at time 0, over the network that is varied",
    "known": "all pursuers know the initial actions at time 0, for free over any network",
    "silent": "at time 0 pursuers know nothing of each other, and do not announce their first actions",
}
"""What each `announce.start` means for a sweep over properties of the network; costs of latency depend on it."""
Indices = NDArray[np.intp]
Reference = int | Mapping[str, Any] | None
"""The configuration with which others are compared; see `SweepRuns.differences`."""


@dataclass(frozen=True)
class Group:
    """The runs of one configuration."""

    settings: Mapping[str, Any]
    """The value of each key of the grid, as shown in tables."""
    rows: Sequence[Row]
    """The runs, in the order of replications."""

    @cached_property
    def _table(self) -> RunTable:
        return self.rows if isinstance(self.rows, RunTable) else RunTable(self.rows)

    def values(self, metric: str) -> list[Any]:
        """Return a metric of each run that did not fail; None for a run without a value."""
        return self._table.column(metric).values()

    def numbers(self, metric: str) -> Floats:
        """Return a numeric metric of each run that did not fail; nan for a run without a value."""
        return self._table.column(metric).numbers()

    @property
    def seeds(self) -> list[int]:
        """The seeds of the runs that did not fail."""
        return self._table.seeds.values()

    def by_seed(self, metric: str) -> dict[int, float]:
        """Return a numeric metric of each run that did not fail, by its seed; nan for a run without a value."""
        return dict(zip(self.seeds, self.numbers(metric).tolist(), strict=True))

    def present(self, metric: str) -> Floats:
        """Return a numeric metric of each run that has a value."""
        values = self.numbers(metric)
        return values[~np.isnan(values)]

    def estimate(self, metric: str) -> Estimate:
        """Return the mean of a numeric metric over the runs with a value, or the share of runs in which it is true."""
        return (share if self._table.column(metric).is_of_truths else mean)(self.present(metric))

    def in_words(self, without: Sequence[str] = ()) -> str:
        """Return the settings as one line of text, except those of the keys in `without`."""
        return in_words({key: value for key, value in self.settings.items() if key not in without})

    @property
    def failed(self) -> list[Row]:
        """The runs that failed."""
        return self._table.failed

    def pairs(self, other: "Group") -> tuple[Indices, Indices]:
        """Return the pairs of runs of two configurations with equal replication numbers, if neither run failed.

        The two arrays hold the positions of the runs in `values` of this and of the other group. If seeds are common
        (`SweepRuns.common`), the two runs of a pair have the same seed.
        """
        numbers, others = (group._table.replications.numbers() for group in (self, other))
        if np.array_equal(numbers, others):  # the usual case; the general case takes much longer
            return np.arange(len(numbers)), np.arange(len(numbers))
        _, positions, other_positions = np.intersect1d(numbers, others, assume_unique=True, return_indices=True)
        return positions, other_positions


@dataclass(frozen=True, repr=False)
class SweepRuns:
    """The runs of a sweep by configuration."""

    name: str
    keys: tuple[str, ...]
    """The keys of the grid."""
    groups: tuple[Group, ...]
    """The groups in the order of the grid, whose last key changes fastest; see `SweepResult.of` for a whole store."""
    common: bool = True
    """Whether run k of every configuration has the same seed."""
    units: Mapping[str, str] = field(default_factory=dict)
    """The unit of each metric of the sweep that is not built in, by name."""
    start: str | None = None
    """`announce.start` of all configurations; None: unknown, or varied."""

    @property
    def start_rule(self) -> str | None:
        """A sentence about how pursuers learn the initial actions; None if no property of the network is varied."""
        if self.start not in START_RULES or not any(f"{key}.".startswith("network.") for key in self.keys):
            return None
        return f'announce.start = "{self.start}": {START_RULES[self.start]}'

    @property
    def failed(self) -> list[Row]:
        """The runs that failed, in order."""
        return [row for group in self.groups for row in group.failed]

    def estimates(self, metric: str) -> list[Estimate]:
        """Return the mean of a metric for each configuration, over its runs with a value.

        Raises:
            ValueError: if the sweep has no numeric metric of this name.
        """
        check_numeric(metric, self.units)
        return [group.estimate(metric) for group in self.groups]

    def differences(self, metric: str, reference: Reference = None) -> list[Estimate]:
        """Return the mean paired difference of a metric from a reference configuration, over runs with equal seeds.

        The differences are in the order of `groups`. A configuration that is its own reference has 0 in all runs.

        Args:
            metric: the name of the metric.
            reference: the position of the reference in `groups`; or the values of some keys, such as
                {"protocol": "sap"} (see `setting`). Each configuration is then compared with the configuration that has
                these values and is otherwise equal. None: as if the first key with several values and its first value
                were given.

        Raises:
            ValueError: if the configurations do not share their seeds, the sweep has no numeric metric of this name, or
                a configuration has no reference.
        """
        check_numeric(metric, self.units)
        if not self.common:
            raise ValueError("runs with independent seeds cannot be paired")
        return [
            paired(*_aligned(group, self.groups[other], metric))
            for group, other in zip(self.groups, self.references(reference), strict=True)
        ]

    def references(self, reference: Reference = None) -> list[int]:
        """Return the position in `groups` of the reference of each configuration; see `differences`.

        Raises:
            ValueError: if a configuration has no reference.
        """
        position = as_python(reference)
        if type(position) is int:
            if not -len(self.groups) <= position < len(self.groups):
                raise ValueError(f"there is no configuration {position}: they are 0 .. {len(self.groups) - 1}")
            return [position] * len(self.groups)
        if reference is None:
            return self.first_along(self.compared_by)
        if not isinstance(reference, Mapping):
            raise ValueError(
                'a reference should be a mapping, such as {"protocol": "sap"}, or the number of a configuration (got'
                f" {value_text(reference)})"
            )
        wanted = {key: self.setting(key, value) for key, value in reference.items()}
        positions = {repr(dict(group.settings)): k for k, group in enumerate(self.groups)}
        reference_positions = [positions.get(repr({**group.settings, **wanted})) for group in self.groups]
        for group, other in zip(self.groups, reference_positions, strict=True):
            if other is None:
                raise ValueError(f"{group.in_words()}: has no reference with {in_words(wanted)}")
        return [other for other in reference_positions if other is not None]

    def values(self, key: str) -> list[Any]:
        """Return the values of a key of the grid, in the order of the grid.

        Raises:
            ValueError: if the grid has no such key.
        """
        if not isinstance(key, str):
            raise ValueError(
                f"a key of the grid should be a text, 'network.latency.value' for instance (got {value_text(key)})"
            )
        if key not in self.keys:
            near = [name for name in self.keys if f"{name}.".startswith(f"{key}.")] or close_to(key, self.keys)
            hint = f", did you mean {near[0]}?" if near else f": its keys are {', '.join(self.keys) or 'none'}"
            raise ValueError(f"the grid has no key {key}{hint}")
        return list({repr(group.settings[key]): group.settings[key] for group in self.groups}.values())

    def groups_with(self, settings: Mapping[str, Any]) -> list[Group]:
        """Return the configurations that have some settings; `setting` says how to write their values.

        Raises:
            ValueError: as `setting`.
        """
        wanted = {key: self.setting(key, value) for key, value in settings.items()}
        return [group for group in self.groups if all(group.settings[key] == wanted[key] for key in wanted)]

    def setting(self, key: str, value: Any) -> Any:
        """Return the value of a key of the grid that a given value selects.

        A value of the key is selected if it equals the given value, has the same text, is the number that the given
        text says, or is the only value whose kind is the given value. For example, "0.50" says 0.5, "cbba" is the text
        of `CBBA()`, and the kind of `CBBA(schedule=Poisson(rate=5.0))`.

        Raises:
            ValueError: if the grid has no such key, the key does not take the value, or it takes several of this kind.
        """
        values = self.values(key)
        for candidate in values:
            if candidate == value or text(candidate) == label(value) or _says(value, candidate):
                return candidate
        of_this_kind = [candidate for candidate in values if kind_of(text(candidate)) == label(value)]
        if len(of_this_kind) == 1:
            return of_this_kind[0]
        problem = "has several values of the kind" if of_this_kind else "does not take the value"
        raise ValueError(f"{key} {problem} {without_addresses(label(value))}: it takes {', '.join(map(text, values))}")

    @property
    def compared_by(self) -> str | None:
        """The first key such that two configurations differ in this key only.

        If there is no such key: None for a design, and for a grid the first key that has several values.
        """
        alone = list(range(len(self.groups)))  # each configuration is the first with its other settings
        paired_key = next((key for key in self.keys if self.first_along(key) != alone), None)
        if paired_key is not None or self.drawn_keys:
            return paired_key
        return next((key for key in self.keys if len(self.values(key)) > 1), None)

    @property
    def drawn_keys(self) -> list[str]:
        """The keys whose numbers a design drew: two such keys have hardly more pairs of values than one has values.

        A grid has no such keys, because each value of one key occurs with each value of another.
        """
        columns = {key: [group.settings[key] for group in self.groups] for key in self.keys}
        counts = {key: len(set(map(repr, values))) for key, values in columns.items()}
        numeric = [key for key, values in columns.items() if counts[key] > 1 and all(map(is_number, values))]

        def is_of_points(key: str, other: str) -> bool:
            pairs = set(zip(columns[key], columns[other], strict=True))
            return len(pairs) <= 1.01 * max(counts[key], counts[other])  # two points may share a drawn number by chance

        return [key for key in numeric if any(is_of_points(key, other) for other in numeric if other != key)]

    def first_along(self, key: str | None) -> list[int]:
        """Return for each configuration the position of the first one that equals it in all keys but `key`."""
        first = dict[str, int]()
        other_settings = (
            repr({name: value for name, value in group.settings.items() if name != key}) for group in self.groups
        )
        return [first.setdefault(other, k) for k, other in enumerate(other_settings)]

    def warnings(self, metrics: Sequence[str] = SHOWN) -> list[str]:
        """Return a warning if capture times are shown but no run captured, and one for each key without effect.

        A key has no effect if runs with the same seed that differ only in this key agree, bit for bit, in `captured`
        and the given metrics. This may hold only for one value of another key, for example for one protocol; the
        warning then says so. There are no warnings about keys if seeds are independent, or if a run failed.
        `SweepPlan.warnings` returns the warnings that need no runs.
        """
        metrics = names_of_metrics(metrics)
        no_captures = [] if (sentence := self._without_capture(metrics)) is None else [sentence]
        if self.failed or not self.common:
            return no_captures
        names = ", ".join(("captured", *map(words, metrics)))
        return no_captures + [
            f"{condition}nothing shown ({names}) depends on {key}: equal in {counted(count, 'pair')} of runs that"
            f" differ in it only{NO_MESSAGES_HINT * key.startswith(MESSAGING)}"
            for key in self.keys
            for condition, count in self._without_effect(key, metrics)
        ]

    def _without_capture(self, metrics: Sequence[str]) -> str | None:
        """Return a sentence if a time of captures is among the metrics, and no run ended by a capture; else None."""
        if CAPTURE_TIMES.isdisjoint(metrics) or any(group.present("captured").any() for group in self.groups):
            return None
        ends = [end for group in self.groups for end in group.present("end_time").tolist()]
        if not ends:
            return None
        return (
            f"no run ended by a capture, the longest after {max(ends):g} s, so that capture times are missing: the"
            " `horizon` may be too short, or no pursuer fast enough"
        )

    def _without_effect(self, key: str, metrics: Sequence[str]) -> Iterator[tuple[str, int]]:
        """Yield the condition under which a key has no effect, and the number of pairs of runs that differ in it only.

        The condition is a text, for example "with protocol = sap, "; it is "" if the key has no effect at all.
        """
        firsts = zip(self.groups, self.first_along(key), strict=True)
        pairs = [(group, self.groups[first]) for k, (group, first) in enumerate(firsts) if k != first]
        if count := _count_equal(pairs, metrics):
            yield "", count
            return
        for other in [name for name in self.keys if name != key]:
            values = dict.fromkeys(text(group.settings[other]) for group, _ in pairs)
            for value in values if len(values) > 1 else ():  # a single value is no condition
                if count := _count_equal([pair for pair in pairs if text(pair[0].settings[other]) == value], metrics):
                    yield f"with {other} = {value}, ", count


def _count_equal(pairs: Sequence[tuple[Group, Group]], metrics: Sequence[str]) -> int:
    """Return the number of pairs of runs; 0 if the runs of any pair differ in `captured` or one of the metrics."""
    names = ("captured", *metrics)
    are_equal = all(
        np.array_equal(*_aligned(group, other, name), equal_nan=True) for group, other in pairs for name in names
    )
    return sum(len(group.pairs(other)[0]) for group, other in pairs) if are_equal else 0


def _aligned(group: Group, other: Group, metric: str) -> tuple[Floats, Floats]:
    """Return a metric of two configurations in each pair of their runs."""
    positions, other_positions = group.pairs(other)
    return group.numbers(metric)[positions], other.numbers(metric)[other_positions]


def in_numeric_order(keys: Sequence[str], groups: Sequence[Group]) -> tuple[Group, ...]:
    """Return groups such that the last key changes fastest; the values of a key that takes only numbers ascend.

    The values of another key are in the order of their first group.
    """
    ranks: list[dict[str, int]] = []
    for key in keys:
        values = list({repr(group.settings[key]): group.settings[key] for group in groups}.values())
        if all(is_number(value) for value in values):
            values.sort()
        ranks.append({repr(value): rank for rank, value in enumerate(values)})
    return tuple(
        sorted(
            groups,
            key=lambda group: [rank[repr(group.settings[key])] for key, rank in zip(keys, ranks, strict=True)],
        )
    )


def is_number(value: Any) -> TypeGuard[float]:
    """Return whether a setting is a number; true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def names_of_metrics(metrics: Sequence[str]) -> Sequence[str]:
    """Return the names of metrics, of columns or of keys; a single name may be given without a list.

    Any ordered collection of names is accepted, such as an array, the columns of a frame or the keys of a dict.

    Raises:
        ValueError: if the names are no list of texts.
    """
    names: Any = [metrics] if isinstance(metrics, str) else as_python(metrics)
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise ValueError(
            f"names of metrics or columns should be a list of texts, ['active_time'] (got {value_text(metrics)})"
        )
    return names


def text(value: Any) -> str:
    """Return a setting as text; a number has at most six significant digits, unless it is whole."""
    if isinstance(value, float):
        short = f"{value:g}"
        return f"{value:.0f}" if value.is_integer() and float(short) != value and abs(value) < EXACT else short
    return str(value).lower() if isinstance(value, bool) else str(value)


def _says(value: Any, number: Any) -> bool:
    """Return whether a value is a text of the given number, such as "0.50" or "5e-1" of 0.5."""
    if not isinstance(value, str) or not is_number(number):
        return False
    try:
        return float(value) == float(number)
    except ValueError:
        return False


def labels_of_values(result: SweepRuns, labels: Mapping[str, str], names: Collection[str] = ()) -> dict[str, str]:
    """Return labels by value as tables show it; they may be given by the kind of a value, or another text of a number.

    Args:
        result: the result of a sweep.
        labels: texts by value, by kind of a value, by key, or by another of `names`.
        names: what else may have a label.

    Raises:
        ValueError: if a label is no text, or belongs to nothing, or to a kind that several values have.
    """
    labels = {text(name): label_of_name for name, label_of_name in labels.items()}  # numbers are given as such, too
    for name, label_of_name in labels.items():
        check_label(name, label_of_name)
    settings = [value for key in result.keys for value in result.values(key)]
    values = set(map(text, settings))
    labels = {
        next((text(value) for value in settings if name not in values and _says(name, value)), name): label_of_name
        for name, label_of_name in labels.items()
    }
    kinds = Counter(map(kind_of, values))
    allowed = {*values, *result.keys, *names}
    if unknown := [name for name in labels if name not in allowed and kinds[name] != 1]:
        problem = "several values are of the kind" if kinds[unknown[0]] else "no key takes the value"
        name = without_addresses(str(unknown[0]))
        raise ValueError(f"{problem} {name}, which has a label; values: {', '.join(sorted(values))}")
    of_kinds = {value: labels[kind] for value in values if (kind := kind_of(value)) in labels and kind not in values}
    return {**of_kinds, **labels}


def check_label(name: str, label_of_name: Any) -> None:
    """Raise ValueError if the label of a value, a key or an axis is no text."""
    if not isinstance(label_of_name, str):
        raise ValueError(f"the label of {without_addresses(name)} should be a text (got {value_text(label_of_name)})")


def kind_of(value: str) -> str:
    """Return the kind of a model that is given as text; for example, the kind of "sap(tau=...)" is "sap"."""
    return value.partition("(")[0]
