"""Bodies of messages of all kinds, each with its content in JSON types and its size."""

import array
import collections
import ctypes
import dataclasses
import datetime
import enum
import functools
import math
import random
import threading
import types
import uuid
from collections import Counter, OrderedDict, UserDict, UserList, UserString, defaultdict, deque
from collections.abc import Mapping, Sequence, Set
from decimal import Decimal
from fractions import Fraction
from math import inf
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, NamedTuple

import attrs
import networkx as nx
import numpy as np
import pandas as pd
import pyarrow as pa
import pydantic

from desim.config.model import Value
from desim.kernel.core.records import Record

THIRDS = np.arange(2000) / 3.0


@dataclasses.dataclass
class Bid:
    task: int
    price: float
    path: list[int]


@dataclasses.dataclass(eq=False)
class ByIdentity:
    path: list[int]


@dataclasses.dataclass(frozen=True)
class FrozenBid:
    task: int
    place: tuple[float, float]


@dataclasses.dataclass(slots=True)
class InSlots:
    path: list[int]


@dataclasses.dataclass(frozen=True)
class FrozenOutside:
    path: list[int]


class Computing(FrozenBid):
    """Derived from a frozen dataclass, and none itself: its objects may have other attributes."""


class Named(NamedTuple):
    active: int
    path: Any


class NamedWithAttributes(Named):
    pass


class Plan:
    def __init__(self, *path):
        self.path = list(path)


class Computed(Plan):
    """Keeps what was computed from its path."""

    @functools.cached_property
    def total(self):
        return sum(self.path)


class WithModule(Plan):
    """Holds the module that computes with it, as rotations of scipy do."""

    def __init__(self, *path):
        super().__init__(*path)
        self.code = math

    def __reduce__(self):
        return type(self), tuple(self.path)


class Locked(Plan):
    """Leaves out of its pickles what cannot be copied."""

    def __init__(self, *path):
        super().__init__(*path)
        self.lock = threading.Lock()

    def __getstate__(self):
        return {"path": self.path}

    def __setstate__(self, state):
        self.__init__(*state["path"])


class Mean(list):
    """A list that keeps what was computed from its items."""

    @functools.cached_property
    def mean(self):
        return sum(self) / len(self)


def looked_at():
    """Return a graph whose nodes and degrees were read: networkx keeps the views that it has made for that."""
    graph = nx.Graph([(1, 2, {"w": 0.5})])
    list(graph.nodes), graph.degree(1), graph.adj, graph.edges
    return graph


def read(body, name):
    """Return an object whose attribute was read."""
    assert getattr(body, name)
    return body


class Slotted:
    __slots__ = ("__secret", "path")

    def __init__(self):
        self.path, self.__secret = [1], 2


class Self:
    """Has an attribute of the name under which the class is recorded."""

    def __init__(self):
        self.class_name = 7


class Model(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="allow", arbitrary_types_allowed=True)
    path: list[int]
    limit: float = inf
    matrix: Any = None


class FrozenModel(Value):
    place: tuple[float, float]


class FrozenWithList(Value):
    path: list[int]


class WithPlain:
    def plain(self):
        return {"plain": {3, 1}}


@attrs.define
class Attrs:
    path: list[int]


class Colour(enum.Enum):
    RED = "red"
    PLACE = (1, 2.5)


class Level(enum.IntEnum):
    HIGH = 3


class Right(enum.Flag):
    READ = enum.auto()
    WRITE = enum.auto()


class Word(enum.StrEnum):
    YES = "yes"


class Route(list):
    """A list with attributes."""

    def __init__(self, items, **attributes):
        super().__init__(items)
        vars(self).update(attributes)


class Table(dict):
    """A dict with attributes."""

    def __init__(self, items, **attributes):
        super().__init__(items)
        vars(self).update(attributes)


class OfAttributes(dict):
    """A dict whose items are its attributes."""

    def __init__(self, **items):
        super().__init__(items)
        self.__dict__ = self


class Length:
    """A number with a unit, as that of pint."""

    def __init__(self, magnitude):
        self.magnitude, self.units = magnitude, "meter"

    def __float__(self):
        return float(self.magnitude)

    def tolist(self):
        raise AttributeError("a number has no list")


class Lengths(np.ndarray):
    """An array with a unit, as that of astropy, whose items have it, too."""

    unit = "m"

    @property
    def value(self):
        return np.asarray(self)

    def tolist(self):
        raise NotImplementedError("cannot make a list of quantities")


class Number(int):
    """An int that may have attributes."""


class Distance(float):
    pass


class TaskId(str):
    __slots__ = ("__dict__",)


class Frame(bytes):
    pass


class Ring(deque):
    pass


class Bag(UserDict):
    pass


class Queue(UserList):
    pass


class Samples(np.ndarray):
    """An array with attributes, as in the documentation of numpy."""

    def __array_finalize__(self, other):
        self.rate = getattr(other, "rate", None)


class Track(Sequence):
    """A collection of its own class, which keeps more than its items."""

    def __init__(self, *points, owner=None):
        self._points = list(points)
        if owner is not None:
            self.owner = owner

    def __len__(self):
        return len(self._points)

    def __getitem__(self, k):
        return self._points[k]


class Board(Mapping):
    def __init__(self, rows):
        self.rows = rows

    def __len__(self):
        return len(self.rows)

    def __iter__(self):
        return iter(self.rows)

    def __getitem__(self, key):
        return self.rows[key]


@dataclasses.dataclass
class Chosen(Set):
    tasks: set[int]
    by: int

    def __len__(self):
        return len(self.tasks)

    def __iter__(self):
        return iter(self.tasks)

    def __contains__(self, task):
        return task in self.tasks


@dataclasses.dataclass
class Tour(list):
    cost: float


class PlainBid(Bid):
    """Derived from a dataclass, and none itself."""

    def __init__(self, bidder, *fields):
        super().__init__(*fields)
        self.bidder, self._rank = bidder, 3


@attrs.define(slots=False)
class LateAttrs:
    path: list[int]

    def __attrs_post_init__(self):
        self.length = len(self.path)


def with_attributes(body, **attributes):
    vars(body).update(attributes)
    return body


def function(a=1):
    """Refer to nothing that changes."""
    return a


STRUCTURED = np.array([(1, 2.5), (2, 3.5)], dtype=[("id", "i4"), ("x", "f8")])
DAY = datetime.datetime(2024, 5, 6, 7, 8, 9, 10, tzinfo=datetime.UTC)
UUID = uuid.UUID(int=5)
NONE = None
"""The size of a body that has none."""

IMMUTABLE: dict[str, tuple[Any, Any, int | None]] = {
    "none": (None, None, 0),
    "bool": (True, True, 8),
    "int": (7, 7, 8),
    "large int": (2**70, 2**70, 8),
    "float": (0.1, 0.1, 8),
    "infinite": (inf, inf, 8),
    "complex": (3 + 4j, [3.0, 4.0], 16),
    "str": ("für", "für", 4),
    "lone surrogate": ("a\ud800", "a\ud800", 4),
    "bytes": (b"\x00\xff", "00ff", 2),
    "memoryview": (memoryview(b"\x00\xff"), "00ff", 2),
    "range": (range(4), [0, 1, 2, 3], 32),
    "tuple": ((1, (2.0, None)), [1, [2.0, None]], 16),
    "named tuple": (Named(1, (2, 3)), {"active": 1, "path": [2, 3]}, 24),
    "record": (Record(1, 2, 3, 4), {"src": 1, "seq": 2, "stamp": 3, "body": 4}, 24),
    "active of no action": (Named(0.5, (1,)), {"active": 0.5, "path": [1]}, 16),
    "frozenset": (frozenset({"b", "a", 3, 2.5}), [2.5, 3, "a", "b"], 18),
    "frozen dataclass": (FrozenBid(1, (2.0, 3.0)), {"task": 1, "place": [2.0, 3.0]}, 24),
    "frozen model": (FrozenModel(place=(2.0, inf)), {"place": [2.0, inf]}, 16),
    "enum": (Colour.RED, "red", 3),
    "enum of a tuple": (Colour.PLACE, [1, 2.5], 16),
    "int enum": (Level.HIGH, 3, 8),
    "str enum": (Word.YES, "yes", 3),
    "flag": (Right.READ | Right.WRITE, 3, 8),
    "decimal": (Decimal("0.10"), "0.10", 8),
    "fraction": (Fraction(1, 3), "1/3", 8),
    "uuid": (UUID, str(UUID), 16),
    "path": (PurePosixPath("a/b"), "a/b", 3),
    "windows path": (PureWindowsPath("a\\b"), "a/b", 3),
    "date": (datetime.date(2024, 5, 6), "2024-05-06", 8),
    "time": (datetime.time(7, 8), "07:08:00", 8),
    "datetime": (DAY, "2024-05-06T07:08:09.000010+00:00", 8),
    "duration": (datetime.timedelta(minutes=1), 60.0, 8),
    "np.bool": (np.True_, True, 8),
    "np.int64": (np.int64(5), 5, 8),
    "np.float32": (np.float32(0.1), 0.10000000149011612, 8),
    "np.float64": (np.float64(0.1), 0.1, 8),
    "np.longdouble": (np.longdouble(0.1), 0.1, 8),
    "np.complex64": (np.complex64(1j), [0.0, 1.0], 16),
    "np.str": (np.str_("ab"), "ab", 2),
    "np.bytes": (np.bytes_(b"ab"), "6162", 2),
    "np.datetime64": (np.datetime64("2024-05-06T07"), "2024-05-06T07", 8),
    "np.timedelta64": (np.timedelta64(1500, "ms"), 1.5, 8),
    "np months": (np.timedelta64(3, "M"), "3 months", 8),
    "pandas.NA": (pd.NA, None, 8),
    "time zone": (datetime.UTC, "UTC", 3),
    "class": (Bid, "Bid", NONE),
    "function": (function, "function", NONE),
    "builtin": (len, "len", NONE),
}
"""By name: an immutable body, its content and its size, bytes."""
MUTABLE: dict[str, tuple[Any, Any, int | None]] = {
    "list": ([1, 2.0, [3] * 10], [1, 2.0, [3] * 10], 96),
    "tuple of a list": ((1, [2]), [1, [2]], 16),
    "tuple of an object": ((1, Plan(2)), [1, {"class_name": "Plan", "path": [2]}], 16),
    "named tuple of a list": (Named(0, [2]), {"active": 0, "path": [2]}, 16),
    "named tuple that may have attributes": (NamedWithAttributes(0, 5), {"active": 0, "path": 5}, 16),
    "named tuple with attributes": (
        with_attributes(NamedWithAttributes(0, 5), seen=[1]),
        {"active": 0, "path": 5, "seen": [1]},
        24,
    ),
    "attributes beside fields": (
        PlainBid(7, 1, 2.0, [3]),
        {"task": 1, "price": 2.0, "path": [3], "bidder": 7},
        32,
    ),
    "attributes beside those of attrs": (LateAttrs([5]), {"path": [5], "length": 1}, 16),
    "int with an attribute": (
        with_attributes(Number(5), unit="m"),
        {"class_name": "Number", "value": 5, "unit": "m"},
        9,
    ),
    "float with an attribute": (
        with_attributes(Distance(5.5), unit="m"),
        {"class_name": "Distance", "value": 5.5, "unit": "m"},
        9,
    ),
    "text with an attribute": (
        with_attributes(TaskId("a"), at=[1]),
        {"class_name": "TaskId", "value": "a", "at": [1]},
        9,
    ),
    "bytes with an attribute": (
        with_attributes(Frame(b"a"), at=[1]),
        {"class_name": "Frame", "value": "61", "at": [1]},
        9,
    ),
    "deque with an attribute": (
        with_attributes(Ring([1, 2]), at=3),
        {"class_name": "Ring", "items": [1, 2], "at": 3},
        24,
    ),
    "user dict with an attribute": (
        with_attributes(Bag(a=1), owner=3),
        {"class_name": "Bag", "items": {"a": 1}, "owner": 3},
        17,
    ),
    "user list with an attribute": (
        with_attributes(Queue([1, 2]), owner=3),
        {"class_name": "Queue", "items": [1, 2], "owner": 3},
        24,
    ),
    "array with an attribute": (
        with_attributes(np.array([1.5, 2.5]).view(Samples), rate=3),
        {"class_name": "Samples", "items": [1.5, 2.5], "rate": 3},
        24,
    ),
    "own sequence": (Track(1, 2), [1, 2], 16),
    "own sequence with an attribute": (
        Track(1, 2, owner=3),
        {"class_name": "Track", "_points": [1, 2], "owner": 3},
        24,
    ),
    "own mapping with an attribute": (Board({"a": 1}), {"class_name": "Board", "rows": {"a": 1}}, 9),
    "own set with fields": (Chosen({1, 2}, 3), {"tasks": [1, 2], "by": 3}, 24),
    "list that is a dataclass": (Tour(2.5), {"class_name": "Tour", "items": [], "cost": 2.5}, 8),
    "dict with a method as attribute": (Table({"a": 1}, look=len), {"a": 1}, 9),
    "list with attributes": (
        Route([1, 2], cost=3.0, _kept=4),
        {"class_name": "Route", "items": [1, 2], "cost": 3.0},
        24,
    ),
    "dict with attributes": (Table({"a": 1}, cost=3), {"class_name": "Table", "items": {"a": 1}, "cost": 3}, 17),
    "dict of attributes": (OfAttributes(a=1), {"a": 1}, 9),
    "quantity": (Length(3.0), {"value": 3.0, "unit": "meter"}, 8),
    "array with a unit": (np.array([1.0, 2.0]).view(Lengths), {"value": [1.0, 2.0], "unit": "m"}, 16),
    "number with a unit": (np.array(1.0).view(Lengths), {"value": 1.0, "unit": "m"}, 8),
    "int with attributes": (Number(5), 5, 8),
    "dict": ({"who": 3, 4: (5, 6)}, {"who": 3, "4": [5, 6]}, 3 + 8 + 8 + 16),
    "fields of announcements": ({"active": [1], "records": [7]}, {"active": [1], "records": [7]}, 6 + 8 + 7 + 8),
    "dict by any key": (
        {np.int64(2): np.float32(0.5), (1, "b"): 2, None: 3, True: 4, Level.HIGH: 5, b"x": 6},
        {"2": 0.5, '[1, "b"]': 2, "null": 3, "true": 4, "3": 5, "78": 6},
        8 + 8 + 9 + 8 + 0 + 8 + 8 + 8 + 8 + 8 + 1 + 8,
    ),
    "dict by keys of one text": ({1: "a", "1": "b"}, [[1, "a"], ["1", "b"]], 8 + 1 + 1 + 1),
    "default dict": (defaultdict(list, {"a": [1]}), {"a": [1]}, 9),
    "ordered dict": (OrderedDict(b=1, a=2), {"b": 1, "a": 2}, 18),
    "counter": (Counter("aab"), {"a": 2, "b": 1}, 18),
    "user dict": (UserDict(a=1), {"a": 1}, 9),
    "user list": (UserList([1, 2]), [1, 2], 16),
    "user string": (UserString("ab"), "ab", 2),
    "set": ({"uav3", "uav1", "uav2"}, ["uav1", "uav2", "uav3"], 12),
    "mixed set": (
        {None, "b", "a", 10, 9, 2.5, (10, 1), (9, 2), frozenset({3}), b"\x01", Colour.RED},
        [None, 2.5, 9, 10, "01", "a", "b", "red", [3], [9, 2], [10, 1]],
        0 + 2 + 3 * 8 + 4 * 8 + 8 + 1 + 3,
    ),
    "bytearray": (bytearray(b"\x00\xff"), "00ff", 2),
    "array.array": (array.array("H", [1, 2]), [1, 2], 4),
    "deque": (deque(range(3), maxlen=5), [0, 1, 2], 24),
    "np.array": (THIRDS, THIRDS.tolist(), 16_000),
    "read-only array": (np.broadcast_to(np.zeros(1), (2,)), [0.0, 0.0], 16),
    "matrix": (np.ones((3, 2), np.uint8), [[1, 1]] * 3, 48),
    "scalar array": (np.array(5.0), 5.0, 8),
    "complex array": (np.array([1j], np.complex64), [[0.0, 1.0]], 16),
    "text array": (np.array(["ab", "c"]), ["ab", "c"], 3),
    "object array": (np.array([[1], "x", None], object), [[1], "x", None], 9),
    "dates": (np.array(["2024-05-06"], "datetime64[D]"), ["2024-05-06"], 8),
    "durations": (np.array([[1500]], "timedelta64[ms]"), [[1.5]], 8),
    "long doubles": (np.array([0.1], np.longdouble), [0.10000000000000000555], 8),
    "structured array": (STRUCTURED, [{"id": 1, "x": 2.5}, {"id": 2, "x": 3.5}], 32),
    "structured scalar": (STRUCTURED[0], {"id": 1, "x": 2.5}, 16),
    "void": (np.void(b"\x01\x02"), "0102", 2),
    "masked array": (np.ma.masked_array([1.5, 2.0], [False, True]), [1.5, None], 16),
    "series": (pd.Series([1.5, 2.5]), [1.5, 2.5], 16),
    "index": (pd.Index([1, 2]), [1, 2], 16),
    "frame": (pd.DataFrame({"a": [1, 2], "b": [0.5, 1.5]}), {"a": [1, 2], "b": [0.5, 1.5]}, 34),
    "time stamp": (pd.Timestamp("2024-05-06"), "2024-05-06T00:00:00", 8),
    "dataclass": (Bid(1, 2.0, [3] * 10), {"task": 1, "price": 2.0, "path": [3] * 10}, 96),
    "dataclass by identity": (ByIdentity([1]), {"path": [1]}, 8),
    "dataclass in slots": (InSlots([1]), {"path": [1]}, 8),
    "frozen dataclass of a list": (FrozenOutside([1]), {"path": [1]}, 8),
    "derived from a frozen dataclass": (Computing(1, (2.0, 3.0)), {"task": 1, "place": [2.0, 3.0]}, 24),
    "model": (
        Model(path=[1], matrix=np.eye(1), more={2}),
        {"path": [1], "limit": inf, "matrix": [[1.0]], "more": [2]},
        32,
    ),
    "frozen model of a list": (FrozenWithList(path=[1]), {"path": [1]}, 8),
    "attrs": (Attrs([1]), {"path": [1]}, 8),
    "plain object": (Plan(1, 2), {"class_name": "Plan", "path": [1, 2]}, 16),
    "object with a cached property": (
        read(Computed(1, 2), "total"),
        {"class_name": "Computed", "path": [1, 2]},
        16,
    ),
    "object with a module": (WithModule(1), {"class_name": "WithModule", "path": [1], "code": "math"}, 8),
    "object that leaves out a lock": (Locked(1, 2), {"class_name": "Locked", "path": [1, 2]}, 16),
    "list with a cached property": (read(Mean([1, 2]), "mean"), [1, 2], 16),
    "graph": (
        looked_at(),
        {
            "class_name": "Graph",
            "graph": {},
            "_node": {"1": {}, "2": {}},
            "_adj": {"1": {"2": {"w": 0.5}}, "2": {"1": {"w": 0.5}}},
            "__networkx_cache__": {},
        },
        66,
    ),
    "table of Arrow": (pa.table({"a": [1, 2], "b": ["x", None]}), {"a": [1, 2], "b": ["x", None]}, 19),
    "object in slots": (Slotted(), {"class_name": "Slotted", "_Slotted__secret": 2, "path": [1]}, 16),
    "object with a class name": (Self(), {"class_name_": "Self", "class_name": 7}, 8),
    "namespace": (types.SimpleNamespace(a=[1]), {"class_name": "SimpleNamespace", "a": [1]}, 8),
    "chain of maps": (collections.ChainMap({"a": 1}), {"a": 1}, 9),
    "object with plain": (WithPlain(), {"plain": [1, 3]}, 21),
    "exception": (ValueError("no", [3]), {"class_name": "ValueError", "args": ["no", [3]]}, NONE),
    "partial": (
        functools.partial(function, [2], a=3),
        {"class_name": "partial", "func": "function", "args": [[2]], "keywords": {"a": 3}},
        NONE,
    ),
    "method": (Plan(1).__init__, "Plan.__init__", NONE),
    "empty object": (types.SimpleNamespace(), {"class_name": "SimpleNamespace"}, NONE),
    "object": (object(), {"class_name": "object"}, NONE),
    "series with a missing number": (pd.Series([1, None], dtype="Int64"), [1, None], 16),
    "random.Random": (
        random.Random(1),
        {"class_name": "Random", "args": [], "state": [3, [*random.Random(1).getstate()[1]], None]},
        NONE,
    ),
    "slice": (slice(1, 2), {"class_name": "slice", "args": [1, 2, None]}, NONE),
    "interval": (pd.Interval(0, 1), {"class_name": "Interval", "args": [0, 1, "right"]}, NONE),
    "C integer": (ctypes.c_int8(5), {"class_name": "c_byte", "args": ["c_byte", [{}, "05"]]}, 1),
}
"""By name: a body that may change, its content and its size, bytes."""
BODIES = IMMUTABLE | MUTABLE
