"""The check of faults: `check_fault`."""

from typing import Any

import numpy as np

from desim.config.arguments import naming_arguments, value_text
from desim.kernel.core.events import Event, Lost
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.models.clock_skew import ClockSkew
from desim.kernel.models.faults import Fault, Window, nodes_of
from desim.kernel.models.links import Links
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted, traced
from desim.pursuit.byzantine.lies import PURSUER_FAULTS, ByzantineFault
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import Recording, Scenario
from desim.testing.judging import Subject, subject, twice

HORIZON = 1.0
"""Length of a run, s."""
START, END = 0.3, 0.6
"""Start and end, s, at which each fault is tried."""
SIZES = (1, 2, 5)
"""Numbers of nodes for which a plan is called."""


@naming_arguments
def check_fault(fault: Any, *, limit: float = 10.0) -> None:
    """Check a fault, or a plan of faults; if you are unsure whether yours is right, run this.

    It checks that a plan draws valid faults, only from the generator given; that a fault names nodes that exist, and
    that a page can draw it. Each fault then begins and ends in a run of five or more pursuers: after the end no message
    is lost, also if two faults of its kind overlap; and two runs of one scenario and seed are equal.

    Args:
        fault: an object, a class that needs no parameters besides its start, a plan, a kind, a table or "module:name".
        limit: the time that each run may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the fault is wrong, with the call, the input and what is expected.
    """
    if isinstance(fault, type) and issubclass(fault, Window):
        fault = fault(start=START, end=END)
    tested = subject(fault, PURSUER_FAULTS, "fault")
    if isinstance(tested.model, ClockSkew):  # lasts for the whole run, and draws no faults
        _check_runs(tested, (tested.model,), "a run with it", limit)
        return
    drawn = _drawn(tested, limit)
    _check_runs(tested, (tested.model,), "a run with it", limit)
    by_type = {type(window): window for window in drawn}
    for window in by_type.values():
        first = window.model_copy(update={"start": START, "end": END})
        second = window.model_copy(update={"start": (START + END) / 2.0, "end": END + 0.1})
        name = type(window).__name__
        _check_runs(tested, (first,), f"a run in which {name} lasts from {START:g} to {END:g} s", limit)
        _check_runs(tested, (first, second), f"a run in which two faults {name} overlap", limit)


def _drawn(tested: Subject, limit: float) -> list[Window]:
    """Return faults that the model draws; require that each call draws valid ones from its generator."""
    faults: list[Window] = []
    for size in SIZES:
        for seed in range(3):
            call = f"the plan, called with size = {size}, horizon = 10"
            with tested.judged(call, limit):
                first, second = ([*_call(tested, call, size, seed)] for _ in range(2))
            tested.require(
                first == second,
                f"{call} draws {first} and, for an equal rng, {second}: draw from rng only, and remember nothing",
            )
            for window in first:  # a fault that is no plan is not told the number of nodes
                _check_drawn(tested, window, None if isinstance(tested.model, Window) else size, call)
            faults += first
    return faults


def _call(tested: Subject, call: str, size: int, seed: int) -> list[Any]:
    with tested.fresh() as plan:
        answer: Any = plan(size, 10.0, np.random.default_rng(seed))
    try:
        planned = [*answer]
    except TypeError:
        tested.fail(f"{call} returns {value_text(answer)}, expected faults, as a list or from a generator")
    for window in planned:
        if not isinstance(window, Fault | ByzantineFault):
            tested.fail(
                f"{call} draws {value_text(window)}, expected faults: objects of classes derived from desim.Fault"
            )
    return planned


def _check_drawn(tested: Subject, window: Window, size: int | None, call: str) -> None:
    """Check the description of a fault; with a size, also that the nodes that it names exist."""
    with tested.judged("named() and sketch()"):
        named = nodes_of(window)
        if isinstance(window, Fault):
            traced(window)
    if size is None:
        return
    for key, nodes in named.items():
        for node in nodes:
            tested.require(
                0 <= node < size,
                f"{call} draws {value_text(window)}, whose {key} names node {node}: expected nodes 0 .. size - 1",
            )


def _check_runs(tested: Subject, faults: tuple[Any, ...], where: str, limit: float) -> None:
    """Run a scenario with faults twice; require that no message is lost when no fault is active."""
    highest = max((node for fault in faults for nodes in nodes_of(fault).values() for node in nodes), default=0)

    def scenario() -> Scenario:
        return Scenario(
            horizon=HORIZON,
            team=Team(count=max(5, highest + 1)),
            evader=Evader(position=(200.0, 200.0)),
            announce=Announcements(heartbeat=0.05, payload="state"),
            network=Links(latency=0.001),
            record=Recording(messages=True),
            fault=faults,
        )

    twice(tested, where, scenario, limit=limit, watchers=[lambda: _Ends(tested, where)])


class _Ends:
    """A watcher that requires that no message is lost later than 2 ms after the last active fault has ended."""

    def __init__(self, tested: Subject, where: str):
        self._tested, self._where = tested, where
        self._active, self._since = 0, 0

    def __call__(self, event: Event) -> None:
        if isinstance(event, FaultStarted):
            self._active += 1
        elif isinstance(event, FaultEnded):
            self._active -= 1
            self._since = event.t
        elif isinstance(event, Lost) and not self._active:
            self._tested.require(
                event.t <= self._since + nanoseconds(0.002),
                f"{self._where} loses a message from {event.src} to {event.dst} at {seconds(event.t):g} s (cause"
                f" {value_text(event.cause)}), when no fault is active: the function that begin(site) returns should"
                " end all that it has begun",
            )
