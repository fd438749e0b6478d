"""The quantities of properties (`desim.scenario.conditions.QUANTITIES`), as step functions of a trace.

A step function is given by its changes: (time in ns, new value), in order of time, the first at time 0. Of several
changes at one instant the last counts. The values of `waiting` and `age` rise by 1 s per second between their changes.
"""

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import islice, pairwise, starmap
from operator import itemgetter
from types import MappingProxyType
from typing import Any, NamedTuple

from desim.analysis.activity import action, changes
from desim.analysis.hindsight import hindsight
from desim.analysis.knowledge import knowledge
from desim.analysis.trace_index import ended, started
from desim.config.answers import wrong_answer
from desim.config.python_numbers import real
from desim.kernel.core.events import Event
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.models.faults import Crash
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Started
from desim.scenario.conditions import JUST_BELOW_0, Condition, QuantityComparison
from desim.scenario.properties import PropertyPiece
from desim.simulation.run import Result

StepChanges = Iterator[tuple[int, float]]
"""The changes of a step function: (time in ns, new value)."""
RISING = frozenset({"waiting", "age"})
"""The quantities that rise by 1 s per second between their changes."""
QuantityKey = tuple[str, int | None]
"""The name of a quantity, and the number of its evader; None: all evaders."""


class Level(NamedTuple):
    """The value of a quantity since its last change."""

    since: int
    """ns"""
    value: float
    rises: bool = False
    """Whether the value has risen by 1 s per second since then."""


class Tally:
    """The quantities in `WATCHED`, kept up to date event by event. A method of the same name returns each quantity."""

    def __init__(self) -> None:
        self._profile: list[int] = []
        """The action of each pursuer."""
        self._at_large: set[int] = set()
        self._evaders = 0
        self._down: Counter[int] = Counter()
        """By robot, the number of its present crashes, which may overlap."""
        self._last_decision = 0  # ns

    def __call__(self, event: Event) -> bool:
        """Process an event; return whether a quantity may have changed."""
        if isinstance(event, Decided):
            self._profile[event.pursuer] = event.active
            self._last_decision = event.t
        elif isinstance(event, BrokeDown):
            self._profile[event.pursuer] = 0
        elif isinstance(event, Captured):
            self._at_large.discard(event.evader)
            self._profile = [0 if chased == event.evader else chased for chased in self._profile]
        elif isinstance(event, Started):
            self._profile, self._evaders = list(event.active), len(event.evaders)
            self._at_large = set(range(1, self._evaders + 1))
        elif isinstance(event, FaultStarted | FaultEnded) and isinstance(event.fault, Crash):
            if event.fault.scope == "robot":
                self._down[event.fault.node] += 1 if isinstance(event, FaultStarted) else -1
        else:
            return False
        return True

    def value(self, name: str, evader: int | None, now: int) -> float:
        """Return the value of a quantity in `WATCHED` at the present time, ns."""
        return float(getattr(self, name)(evader, now))

    def active(self, evader: int | None, _: int) -> int:
        """Return the number of pursuers that chase an evader, or any (None)."""
        return self._profile.count(evader) if evader else len(self._profile) - self._profile.count(0)

    def idle(self, evader: int | None, _: int) -> int:
        """Return the number of evaders at large without a pursuer."""
        return sum(not self._profile.count(j) for j in self._watched_evaders(evader))

    def crowded(self, evader: int | None, _: int) -> int:
        """Return the number of evaders at large with several pursuers."""
        return sum(self._profile.count(j) > 1 for j in self._watched_evaders(evader))

    def captured(self, evader: int | None, _: int) -> int:
        """Return the number of captured evaders."""
        return self._evaders - len(self._at_large) if evader is None else int(evader not in self._at_large)

    def down(self, _: int | None, __: int) -> int:
        """Return the number of robots that are down."""
        return sum(crashes > 0 for crashes in self._down.values())

    def waiting(self, _: int | None, now: int) -> float:
        """Return the time since the last decision, s."""
        return seconds(now - self._last_decision)

    def _watched_evaders(self, evader: int | None) -> set[int]:
        """Return the evaders at large, or only the given one."""
        return self._at_large if evader is None else self._at_large & {evader}


WATCHED = frozenset({"active", "idle", "crowded", "captured", "down", "waiting"})
"""The quantities that are known while a run lasts; the others need its whole trace."""


def _tallied(result: Result, keys: Collection[QuantityKey]) -> Mapping[QuantityKey, list[tuple[int, float]]]:
    """Return the changes of some quantities in `WATCHED`, from one pass over the trace."""
    changes_by_key: dict[QuantityKey, list[tuple[int, float]]] = {key: [] for key in keys}
    tally = Tally()
    for event in result.trace if keys else ():
        if tally(event):
            for key, steps in changes_by_key.items():
                value = tally.value(*key, event.t)
                # An equal value is a change if the quantity has risen since.
                if not steps or steps[-1][1] != value or key[0] in RISING:
                    steps.append((event.t, value))
    return changes_by_key


def _misassigned(result: Result) -> StepChanges:
    """Yield the changes of the quantity: 1 while the relay pursuers are not the only active ones, else 0."""
    pieces = hindsight(result)
    yield from zip(pieces.times.tolist(), (~pieces.relayed).astype(float).tolist(), strict=False)


def _records(result: Result) -> list[tuple[int, int, int, int, int]]:
    """Return (time, reader, source, action, time of the announcement) of each newer record, in order of time; ns."""
    columns = (knowledge(result)[name].tolist() for name in ("begin", "reader", "source", "active", "created"))
    return sorted(zip(*columns, strict=True), key=lambda row: row[0])


def _wrong_beliefs(result: Result) -> StepChanges:
    """Yield the changes of the number of pairs whose reader believes a wrong action of the source."""
    actions, size = list(started(result).active), len(started(result).active)
    believed: dict[tuple[int, int], int] = {}
    wrong: set[tuple[int, int]] = set()
    # A true change has None in place of a reader.
    truths = [(change.t, None, change.pursuer, action(change), 0) for change in changes(result)]
    for t, reader, source, act, _ in heapq.merge(truths, _records(result), key=lambda row: row[0]):
        if reader is None:
            actions[source] = act
            readers = [i for i in range(size) if i != source]
        else:
            believed[reader, source] = act
            readers = [reader]
        pairs = {(i, source) for i in readers}
        wrong -= pairs
        wrong |= {pair for pair in pairs if believed.get(pair, 0) != actions[source]}
        yield t, float(len(wrong))


def _disagreements(result: Result) -> StepChanges:
    """Yield the changes of the number of sources of which two readers believe different actions."""
    size = len(started(result).active)
    readers_by_action = [Counter[int]() for _ in range(size)]  # for each source, the number of readers
    believed: dict[tuple[int, int], int] = {}
    for t, reader, source, announced, _ in _records(result):
        if (before := believed.get((reader, source))) is not None:
            readers_by_action[source][before] -= 1
        believed[reader, source] = announced
        readers_by_action[source][announced] += 1
        yield t, float(sum(len(+readers) > 1 for readers in readers_by_action))  # `+` drops counts of 0


def _age(result: Result) -> StepChanges:
    """Yield the changes of the greatest age of a newest record."""
    created: dict[tuple[int, int], int] = {}
    for t, reader, source, _, announced in _records(result):
        created[reader, source] = announced
        yield t, seconds(t - min(created.values()))


_OF_TRACE: Mapping[str, Callable[[Result], StepChanges]] = MappingProxyType(
    {"misassigned": _misassigned, "wrong_beliefs": _wrong_beliefs, "disagreements": _disagreements, "age": _age}
)


def _of_user(function: Callable[[Any], Any], result: Result) -> StepChanges:
    """Yield the changes that a function of a user returns: (time in s, new value), in order of time."""
    expected = "a quantity should return pairs (time in s, new value), in order of time, the first at time 0"
    answer: Any = function(result)
    try:
        pairs = [(real(time, "a time"), real(value, "a value")) for time, value in answer]
    except (TypeError, ValueError) as error:
        raise wrong_answer(f"{expected} ({error})", answer, function) from error
    times = [time for time, _ in pairs]
    if not pairs or times[0] != 0.0 or any(later < earlier for earlier, later in pairwise(times)):
        raise wrong_answer(expected, answer, function)
    yield from ((nanoseconds(time), value) for time, value in pairs)


def pieces_of(conditions: Sequence[Condition], result: Result) -> Iterator[PropertyPiece]:
    """Yield the pieces of a run for some conditions; one pass over the changes of their quantities.

    Values that last for no time do not count.

    Raises:
        ValueError: if the trace lacks positions or messages that a quantity needs.
        AnswerError: if a function of a user returns no step function.
    """
    comparisons = [comparison for condition in conditions for comparison in condition.comparisons]
    tallied = _tallied(result, {key_of(comparison) for comparison in comparisons if comparison.quantity in WATCHED})

    def changes_in_order(k: int, comparison: QuantityComparison) -> Iterator[tuple[int, int, float]]:
        if comparison.of is not None:
            steps = _of_user(comparison.of, result)
        elif comparison.quantity in WATCHED:
            steps = iter(tallied[key_of(comparison)])
        else:
            steps = _OF_TRACE[comparison.quantity](result)
        yield from ((t, k, value) for t, value in steps)

    levels, end, now = [Level(0, 0.0) for _ in comparisons], ended(result).t, 0
    for t, k, value in heapq.merge(*starmap(changes_in_order, enumerate(comparisons)), key=itemgetter(0)):
        if t >= end:
            break
        if t > now:
            yield from cut(conditions, levels, now, t)
            now = t
        levels[k] = Level(t, value, comparisons[k].quantity in RISING)
    if end > now:
        yield from cut(conditions, levels, now, end)


def key_of(comparison: QuantityComparison) -> QuantityKey:
    """Return the name and the evader of the quantity of a comparison."""
    return comparison.quantity, comparison.evader


def cut(conditions: Sequence[Condition], levels: Sequence[Level], begin: int, end: int) -> Iterator[PropertyPiece]:
    """Yield the pieces between two successive changes (ns) of quantities, given the level of each comparison.

    A new piece begins where a rising quantity reaches the number with which it is compared.
    """
    comparisons = [comparison for condition in conditions for comparison in condition.comparisons]
    instants = {begin, end}
    for comparison, level in zip(comparisons, levels, strict=True):
        if level.rises:
            reached = level.since + round((comparison.number - level.value) * SECOND)
            if begin < reached < end:
                instants.add(reached)
    for first, last in pairwise(sorted(instants)):
        # A single iterator: each condition takes the margins of its comparisons from it.
        margins = (
            _least_margin(comparison, level, first, last) for comparison, level in zip(comparisons, levels, strict=True)
        )
        yield PropertyPiece(
            first, last, tuple(min(islice(margins, len(condition.comparisons))) for condition in conditions)
        )


def _least_margin(comparison: QuantityComparison, level: Level, begin: int, end: int) -> float:
    """Return the least margin of a comparison from `begin` to `end` (ns), where it holds throughout or not at all."""
    if not level.rises:
        return comparison.margin(level.value)
    first, middle, last = (level.value + seconds(t - level.since) for t in (begin, (begin + end) // 2, end))
    least, holds = min(comparison.margin(first), comparison.margin(last)), comparison.holds(middle)
    if (least >= 0.0) != holds:  # by rounding, at an end where the quantity reaches the number: the margin there is 0
        return 0.0 if holds else JUST_BELOW_0
    return least
