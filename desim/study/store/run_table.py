"""Rows, one for each run of a sweep, and the runs of a configuration stored by column.

Columns take a tenth of the memory of an object per value: 9 bytes, a double and a code for its type. A value that no
double can hold (a table, a large integer) is kept as JSON text; equal texts of a column are kept once.

Kept equal to a list of rows by `tests/study/test_run_table.py::test_a_table_equals_the_list_of_its_rows`.
"""

import json
import re
from array import array
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, takewhile
from math import nan
from os import sep
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, overload

import numpy as np

from desim.analysis.metrics import Summary, columns_of
from desim.config.arrays import Floats
from desim.config.packages import package_folder

CALL = re.compile(r'^[ |]*File "(.+)", line (\d+)', re.MULTILINE)
"""Matches a call in a traceback: the file and the line."""
LIBRARY = re.compile(r"^<|[/\\](site-packages|dist-packages|lib[/\\]python[\d.]+)[/\\]")
"""Matches the files of Python and of installed packages."""
OWN_MODULE = re.compile(r"^(desim|protocols)\.[\w.]*?(?=\w+(:|$))")
"""Matches the module of an exception of desim, which precedes its name in a traceback."""
_OURS = tuple(f"{package_folder(package)}{sep}" for package in ("desim", "protocols"))
Status = Literal["ok", "error", "crashed"]
ABSENT, NONE, BOOL, INT, FLOAT, OBJECT = range(6)
"""The codes of the types of values; a run that was stored before a metric existed has no value, which is ABSENT."""
EXACT = 2**53
"""The largest integer up to which a double holds all integers."""
encode = json.JSONEncoder().encode
CHUNK = 1024
"""The number of rows that are converted to columns at a time."""


@dataclass(frozen=True, slots=True)
class Row:
    """A run of a sweep."""

    replication: int
    """The number of the run within its configuration, 0, 1, ..."""
    seed: int
    status: Status
    """ok; error: the run raised an exception; crashed: the run ended its worker process."""
    summary: Summary | None = None
    """The metrics, if ok."""
    traceback: str = ""
    """The traceback and the exception, if the run failed."""

    def value(self, metric: str) -> Any:
        """Return a metric of the run; None if it has no value or is missing, or if the run failed."""
        return None if self.summary is None else self.summary.get(metric)

    @property
    def ok(self) -> bool:
        """Whether the run ended and was measured."""
        return self.status == "ok"

    @property
    def place(self) -> str:
        """The file and line of the last call in the traceback, of a user's code if there is any; "" without a call."""
        calls = CALL.findall(self.traceback)
        user_calls = [call for call in calls if not (LIBRARY.search(call[0]) or call[0].startswith(_OURS))]
        return "{}:{}".format(*(user_calls or calls)[-1]) if calls else ""

    @property
    def failure(self) -> str:
        """The exception of the run in one line, and its place unless that is in desim itself, if the run failed."""
        place = self.place
        return f"{self.error} ({place})" if place and not place.startswith(_OURS) else self.error

    @property
    def error(self) -> str:
        """The exception of the run in one line; "" if it did not fail."""
        lines_of_traceback = self.traceback.strip().splitlines()
        # Of a group of exceptions, without the members of the group.
        own_lines = takewhile(lambda line: not line.startswith("  +-"), lines_of_traceback)
        lines = [line.removeprefix("  | ") for line in own_lines]
        last_call = max((k for k, line in enumerate(lines) if line.startswith('  File "')), default=-1)
        exception = [line for line in lines[last_call + 1 :] if line.strip() and not line.startswith("  ")]
        return OWN_MODULE.sub("", (exception or lines[-1:] or [""])[0])


class Measured(NamedTuple):
    """A run that did not fail, as it is read from a store: a row without the objects that a table does not need."""

    replication: int
    seed: int
    values: Mapping[str, Any]
    """The value of each metric by name."""
    traceback: str = ""


class _Missing:
    """The type of the object that stands for a value that is ABSENT."""


MISSING = _Missing()
KINDS: Mapping[type, int] = MappingProxyType({type(None): NONE, bool: BOOL, int: INT, float: FLOAT, _Missing: ABSENT})
"""The codes of the types that are not stored as OBJECT; `bool` precedes `int`, of which it is a subclass."""


class Column:
    """The values of one metric: numbers, truth values, None, and values that JSON can hold."""

    __slots__ = ("_kinds", "_numbers", "_places", "_texts")  # a pickled result has these names

    def __init__(self, values: Iterable[Any] = ()) -> None:
        self._numbers = array("d")
        self._kinds = bytearray()
        self._texts: list[str] = []
        self._places: dict[str, int] = {}
        self.extend(list(values))

    def extend(self, values: Sequence[Any]) -> None:
        """Append values."""
        # Values of one type are appended at once, in a sixth of the time that `_append` takes.
        types = set(map(type, values))
        integers = [value for value in values if type(value) is int] if int in types else ()
        if types <= KINDS.keys() and (not integers or (min(integers) >= -EXACT and max(integers) <= EXACT)):
            kinds = [KINDS[type_name] for type_name in types]
            self._kinds += bytes(kinds) * len(values) if len(kinds) == 1 else bytes([KINDS[type(v)] for v in values])
            has_gaps = ABSENT in kinds or NONE in kinds
            self._numbers.extend([nan if v is None or v is MISSING else v for v in values] if has_gaps else values)
        elif types == {dict}:
            self._kinds += bytes([OBJECT]) * len(values)
            self._numbers.extend(map(self._index_of_text, values))
        else:
            for value in values:
                self._append(value)

    def _append(self, value: Any) -> None:
        kind = next((code for type_, code in KINDS.items() if isinstance(value, type_)), OBJECT)
        if kind == OBJECT or (kind == INT and abs(value) > EXACT):
            kind, value = OBJECT, self._index_of_text(value)
        self._kinds.append(kind)
        self._numbers.append(nan if kind in {ABSENT, NONE} else value)

    def _index_of_text(self, value: Any) -> int:
        """Return the index of the text of a value among the texts, to which a new text is added."""
        text = "{}" if value == {} else encode(value)  # many tables are empty, and encoding takes a microsecond
        index = self._places.setdefault(text, len(self._texts))
        if index == len(self._texts):
            self._texts.append(text)
        return index

    def __len__(self) -> int:
        return len(self._kinds)

    def __getitem__(self, k: int) -> Any:
        """Return a value with its original type; None if it is absent."""
        return self._decoded(self._kinds[k], self._numbers[k])

    def _decoded(self, kind: int, number: float) -> Any:
        if kind == FLOAT:
            return number
        if kind == INT:
            return int(number)
        if kind == BOOL:
            return bool(number)
        return json.loads(self._texts[int(number)]) if kind == OBJECT else None

    def is_absent(self, k: int) -> bool:
        """Return whether a run has no value, not even None."""
        return self._kinds[k] == ABSENT

    @property
    def is_of_truths(self) -> bool:
        """Whether some values are truth values, and the others are missing."""
        return BOOL in self._kinds and {*self._kinds} <= {BOOL, NONE, ABSENT}

    def values(self) -> list[Any]:
        """Return all values; see `__getitem__`."""
        return list(map(self._decoded, self._kinds, self._numbers))

    def numbers(self) -> Floats:
        """Return the values as an array; nan where a value is None or absent.

        Raises:
            TypeError: if a value is not a number.
        """
        if OBJECT in self._kinds:
            return np.array(self.values(), dtype=float)
        view: Floats = np.asarray(self._numbers)  # shares the memory of the column
        view.setflags(write=False)
        return view


class RunTable(Sequence[Row]):
    """The runs of a configuration as a sequence of rows; each row is made when it is read.

    Args:
        rows: the runs, in the order of replications.
        units: the units of the metrics of `Measured` runs by name, without built-in metrics.
    """

    def __init__(self, rows: Iterable[Row | Measured] = (), units: Mapping[str, str] = MappingProxyType({})):
        self.replications, self.seeds = Column(), Column()
        self._metrics: dict[str, Column] = {}
        self._units: dict[str, str] = dict(units)
        self._failed: dict[int, Row] = {}
        remaining, count = iter(rows), 0
        while chunk := list(islice(remaining, CHUNK)):
            runs = []
            for k, row in enumerate(chunk, count):
                if isinstance(row, Measured):
                    runs.append(row)
                elif row.summary is None:
                    self._failed[k] = row
                else:
                    self._units |= row.summary.units
                    runs.append(Measured(row.replication, row.seed, row.summary))
            self._add(runs)
            count += len(chunk)

    def _add(self, runs: Sequence[Measured]) -> None:
        """Append runs that did not fail."""
        earlier = len(self.replications)
        self.replications.extend([run.replication for run in runs])
        self.seeds.extend([run.seed for run in runs])
        columns = columns_of([run.values for run in runs], MISSING)
        for name in columns:
            if name not in self._metrics:
                self._metrics[name] = Column([MISSING] * earlier)
        for name, column in self._metrics.items():
            column.extend(columns.get(name) or [MISSING] * len(runs))

    def __len__(self) -> int:
        return len(self.replications) + len(self._failed)

    @overload
    def __getitem__(self, k: int) -> Row: ...
    @overload
    def __getitem__(self, k: slice) -> list[Row]: ...
    def __getitem__(self, k: int | slice) -> Row | list[Row]:
        if isinstance(k, slice):
            return [self[row] for row in range(len(self))[k]]
        position = range(len(self))[k]
        if position in self._failed:
            return self._failed[position]
        failed_before = bisect_left(list(self._failed), position)
        return self._run(position - failed_before)

    def __iter__(self) -> Iterator[Row]:
        measured = map(self._run, range(len(self.replications)))
        return (self._failed[k] if k in self._failed else next(measured) for k in range(len(self)))

    def _run(self, k: int) -> Row:
        """Return the k-th run of those that did not fail."""
        values = {name: column[k] for name, column in self._metrics.items() if not column.is_absent(k)}
        return Row(self.replications[k], self.seeds[k], "ok", Summary(values, self._units))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def column(self, metric: str) -> Column:
        """Return a metric of each run that did not fail; None for a run without a value."""
        return self._metrics[metric] if metric in self._metrics else Column([None] * len(self.replications))

    @property
    def failed(self) -> list[Row]:
        """The runs that failed."""
        return list(self._failed.values())
