"""Checks of protocols, schedules and disseminations."""

import inspect
import os
import subprocess
import sys
from functools import cached_property, partial
from math import inf
from typing import Any

import cloudpickle

from desim.config.arguments import naming_arguments
from desim.kernel.core.events import Broadcast, Event, Queued, Sent
from desim.kernel.core.units import seconds
from desim.kernel.models.faults import Crash
from desim.kernel.models.latency import Uniform
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Decided, Started
from desim.pursuit.core.traits import ProtocolTraits
from desim.pursuit.sensing.sensing import Sensing
from desim.pursuit.team.agent import Agent, Process
from desim.pursuit.team.announcements import DISSEMINATIONS, Announcements
from desim.scenario.players import Evader, Team
from desim.scenario.scenario import PROTOCOLS, Recording, Scenario
from desim.simulation.restartable import RestartableProcess
from desim.simulation.run import Result, Simulation, run, run_observed
from desim.testing.judging import SEED, Subject, require_equal, subject, twice
from protocols.best_response import BestResponse
from protocols.rule import SCHEDULES
from protocols.schedules.periodic import slot_length

HORIZON = 1.0
"""Length of a run, s; too short for a capture."""
SITUATIONS: dict[str, dict[str, Any]] = {
    "a run of one pursuer": {"team": Team(count=1, speeds=2.0)},
    "a run of two pursuers": {"team": Team(count=2, speeds=2.0)},
    "a run of two evaders": {"evader": Evader(count=2)},
    "a run in which no message arrives": {"network": Links(loss=1.0)},
    "a run in which messages arrive late and out of order": {"network": Links(latency=Uniform(low=0.0, high=1.0))},
    "a run in which every message arrives twice": {"network": Links(latency=0.01, duplicate=1.0)},
    "a run in which a pursuer crashes": {"fault": (Crash(node=1, start=0.2, end=0.5),)},
    "a run in which a pursuer crashes and loses its memory": {
        "fault": (Crash(node=0, start=0.2, end=0.5, memory=False),)
    },
    "a run in which pursuers see 3 m": {"sensing": Sensing(radius=3.0)},
    "a run in which positions are announced": {"announce": Announcements(payload="state")},
}
"""Scenarios of five pursuers that differ from the default in one or two keys."""
SHARED = (
    "changes the attributes of the object, which all pursuers share, so that they know of each other without a message:"
    " keep what a pursuer remembers in local variables of the generator"
)
"""The complaint about an object that remembers something."""
SLOW = "if it is meant to be slower, check it with a shorter period"
"""The advice about a model that is right, but too slow for the runs of a check."""


def _scenario(protocol: Any, parts: dict[str, Any], dissemination: Any = None) -> Scenario:
    # Without heartbeats, which would announce an action that the protocol does not announce.
    announce = Announcements(trigger="change")
    team = Team(count=5, speeds=2.0)
    usual = {"horizon": HORIZON, "team": team, "announce": announce, "record": Recording(messages=True)}
    scenario = Scenario(**usual | {"protocol": protocol} | parts)
    return scenario if dissemination is None else scenario.with_({"announce.dissemination": dissemination})


@naming_arguments
def check_protocol(protocol: Any, *, limit: float = 10.0, hash_seeds: bool = False) -> None:
    """Check a protocol; if you are unsure whether yours is right, run this.

    It runs small scenarios: with one, two and five pursuers and with two evaders, with messages that are lost, late or
    doubled, with crashes, with sensors of short range, and with another content of announcements. No run may raise an
    error, break an invariant of messages or motion (`watched`), or go on without end; and two runs of one scenario and
    seed are equal. It also checks that the protocol draws from no global random generator; that pursuers decide, each
    for itself; that they announce what they decide; that the protocol object remembers nothing, since all pursuers
    share it; that a message which `ignores` of `me.listen` drops would have had no effect; and that the protocol can be
    sent to the workers of a sweep. The runs last 1 s: if pursuers decide more rarely, check the protocol with a faster
    schedule.

    Args:
        protocol: a function or object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each run may take, s of wall time.
        hash_seeds: whether a run is also repeated in two other processes with different values of `PYTHONHASHSEED`,
            which takes some seconds; if in doubt, True if the protocol has sets.

    Raises:
        ContractError: an AssertionError; if the protocol is wrong, with the situation and what is expected.
    """
    tested = subject(protocol, PROTOCOLS, "protocol")
    _check_runs(tested, tested.model, limit)
    if hash_seeds:
        _check_hash_seeds(tested, _scenario(tested.model, {}))


@naming_arguments
def check_schedule(schedule: Any, *, limit: float = 10.0) -> None:
    """Check a schedule; if you are unsure whether yours is right, run this.

    It runs the protocol `best_response` with the schedule as `check_protocol` does, for 1 s, and compares
    `mean_slot(me)` with the mean time between two turns of the team in 10 s. Check a slower schedule with a shorter
    period.

    Args:
        schedule: an object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each run may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the schedule is wrong, with the situation and what is expected.
    """
    tested = subject(schedule, SCHEDULES, "schedule")
    _check_slots(tested, limit)
    _check_runs(tested, BestResponse(schedule=tested.model), limit)


@naming_arguments
def check_dissemination(dissemination: Any, *, limit: float = 10.0) -> None:
    """Check a dissemination; if you are unsure whether yours is right, run this.

    It runs the protocol `best_response` with the dissemination as `check_protocol` does. It also checks that
    announcements reach a teammate, and that the object remembers nothing, since all pursuers share it.

    Args:
        dissemination: an object, a class that needs no parameters, a kind, or "module:name".
        limit: the time that each run may take, s of wall time.

    Raises:
        ContractError: an AssertionError; if the dissemination is wrong, with the situation and what is expected.
    """
    tested = subject(dissemination, DISSEMINATIONS, "dissemination")
    _check_reach(tested, limit)
    _check_runs(tested, BestResponse(), limit, tested.model)


def _check_reach(tested: Subject, limit: float) -> None:
    """Require that announcements reach a teammate, and that the run does not change the dissemination."""
    where = f"a run of {HORIZON:g} s without losses"
    reached: set[tuple[int, int]] = set()
    at_start: list[tuple[Any, bytes | None]] = []
    """The dissemination that the pursuers share, and its memory."""

    def listens(me: Agent) -> Process:
        while True:
            yield me.sleep(0.1)
            me.assign(1 - me.action)
            me.announce()
            reached.update((me.id, source) for source in me.latest_records() if source != me.id)

    def begins(simulation: Simulation) -> None:
        shared = simulation.agents[0]._announcements.dissemination
        at_start.append((shared, _memory_of(shared)))

    with tested.judged(where, limit):
        run_observed(_scenario(listens, {}, tested.model), SEED, (), begins)
    tested.require(
        reached,
        f"{where} ends, and no pursuer has a record of another: expected broadcast(me, announcement) to send or publish"
        " it, and the process of a receiver to call me.merge_records(records)",
    )
    ((shared, memory),) = at_start
    tested.require(_memory_of(shared) == memory, f"{where} {SHARED}")


def _check_runs(tested: Subject, protocol: Any, limit: float, dissemination: Any = None) -> None:
    """Check the runs of a protocol in all situations, and require that pursuers decide in one of them."""
    watchers: list[_Decisions] = []

    def watcher() -> _Decisions:
        watchers.append(_Decisions(tested, ProtocolTraits.of(protocol)))
        return watchers[-1]

    decided, may_ignore = 0, True
    situations: dict[str, dict[str, Any]] = {"a run of five pursuers": {}, **SITUATIONS}
    for where, parts in situations.items():
        scenario = partial(_scenario, protocol, parts, dissemination)
        result = twice(tested, where, scenario, limit=limit, watchers=[watcher])
        watchers[-1].judge(where)
        decided += watchers[-1].decided
        if may_ignore:  # a protocol that ignores no message in one run is not compared in the next ones
            may_ignore = _check_ignored(tested, where, scenario(), result, limit)
    tested.require(
        decided,
        f"no pursuer decides within {HORIZON:g} s: expected me.assign(action), and then me.announce(); {SLOW}",
    )


def _check_ignored(tested: Subject, where: str, scenario: Scenario, result: Result, limit: float) -> bool:
    """Require that a run is the same if no message is ignored; return whether a pursuer uses `ignores` of `listen`."""
    agents: list[Agent] = []

    def begins(simulation: Simulation) -> None:
        agents.extend(simulation.agents)
        for agent in agents:
            agent._may_ignore = False

    with tested.judged(where, limit):
        without_ignoring = run_observed(scenario, SEED, (), begins)
    require_equal(
        tested,
        f"{where} is another one if no message is ignored",
        [result, without_ignoring],
        "`ignores` of me.listen should be true only of messages with which the function does nothing, now or later",
    )
    return any(agent._has_ignores for agent in agents)


class _Decisions:
    """A watcher of the decisions of a run: who makes them, and whether they are announced.

    Attributes:
        decided: the number of decisions.
    """

    def __init__(self, tested: Subject, traits: ProtocolTraits):
        self._tested, self._traits = tested, traits
        self.decided = 0
        self._actions: list[int] = []
        self._untold: dict[int, int] = {}
        """By pursuer that has sent nothing since its last change of action: the time of the change, ns."""
        self._protocol: Any = None
        self._memory: bytes | None = None

    def __call__(self, event: Event) -> None:
        """Check an event."""
        if isinstance(event, Started):
            self._actions = list(event.active)
        elif isinstance(event, Broadcast | Sent | Queued):
            self._untold.pop(event.src, None)
        elif isinstance(event, Decided):
            self.decided += 1
            self._check_decision(event)

    def _check_decision(self, event: Decided) -> None:
        pursuer, protocol = _process()
        if self._protocol is None and protocol is not None:
            self._protocol, self._memory = protocol, _memory_of(protocol)
        if pursuer is not None and pursuer != event.pursuer and not self._traits.omniscient:
            self._tested.fail(
                f"pursuer {pursuer} sets the action of pursuer {event.pursuer} at {seconds(event.t):g} s: each decides"
                " for itself with me.assign(action), unless the protocol has omniscient = True"
            )
        if event.active == self._actions[event.pursuer]:
            return
        self._actions[event.pursuer] = event.active
        last_change = self._untold.get(event.pursuer)
        must_announce = self._traits.announces is True and len(self._actions) > 1
        if (
            must_announce and last_change is not None and last_change < event.t
        ):  # one message announces simultaneous changes
            self._tested.fail(
                f"pursuer {event.pursuer} changes its action at {seconds(last_change):g} s and again at"
                f" {seconds(event.t):g} s, and sends no message between: call me.announce() after me.assign(action), or"
                " set announces = False"
            )
        self._untold[event.pursuer] = event.t

    def judge(self, where: str) -> None:
        """Require that the protocol object is as it was at the first decision."""
        self._tested.require(
            self._protocol is None or _memory_of(self._protocol) == self._memory,
            f"{where} {SHARED}",
        )


def _process() -> tuple[int | None, Any]:
    """Return the pursuer whose process is running, and its protocol; (None, None) if no process is running."""
    frame = inspect.currentframe()
    while frame is not None and frame.f_code is not RestartableProcess._behave.__code__:
        frame = frame.f_back
    return (None, None) if frame is None else (frame.f_locals["agent"].id, frame.f_locals["protocol"])


def _memory_of(protocol: Any) -> bytes | None:
    """Return the attributes of an object except cached properties, as bytes; None if they cannot be pickled."""
    attributes = getattr(protocol, "__dict__", {})
    cached = {name for name in attributes if isinstance(getattr(type(protocol), name, None), cached_property)}
    try:
        return bytes(cloudpickle.dumps({name: value for name, value in attributes.items() if name not in cached}))
    except Exception:  # code of an object may raise anything
        return None


def _check_slots(tested: Subject, limit: float) -> None:
    """Compare the mean slot of a schedule with its turns."""
    horizon, schedule = 10.0, tested.model
    turns: list[float] = []
    slots: list[float] = []

    def counts(me: Agent) -> Process:
        def revise() -> None:
            turns.append(me.now)
            me.assign(1 - me.action)  # a schedule may depend on actions: half of the team is active on average

        slots.append(slot_length(schedule, me))
        yield from schedule(me, revise)

    with tested.judged("a run of 10 s", limit):
        run(_scenario(counts, {"horizon": horizon}), SEED)
    last = max(turns, default=0.0)
    slot, instants = slots[0] if slots else inf, len(set(turns))
    expected = last / slot
    tested.require(turns, f"no pursuer has a turn within {horizon:g} s: call revise() and then me.announce(); {SLOW}")
    # Simultaneous turns of several pursuers may count as one turn of the team or as several.
    tested.require(
        instants <= 2.0 * expected + 5.0 and len(turns) >= expected / 2.0 - 5.0,
        f"mean_slot(me) of a team of 5 returns {slot:.4g} s, and it has {len(turns)} turns at {instants} instants in"
        f" {last:.4g} s: expected the mean time between two turns of the team",
    )


_PRINT_DIGEST = """
import sys, cloudpickle
from hashlib import sha256
scenario, seed = cloudpickle.loads(sys.stdin.buffer.read())
from desim import run
from desim.kernel.core.trace_file import line_of
print(sha256("".join(map(line_of, run(scenario, seed).trace)).encode()).hexdigest())
"""


def _check_hash_seeds(tested: Subject, scenario: Scenario) -> None:
    """Require that a run is the same in processes with different hash seeds."""
    request = cloudpickle.dumps((scenario, SEED))
    digests = set()
    for hash_seed in ("1", "2"):
        environment = os.environ | {"PYTHONHASHSEED": hash_seed, "PYTHONPATH": os.pathsep.join(sys.path)}
        with tested.judged(f"a process with PYTHONHASHSEED={hash_seed}", 120.0):
            ended = subprocess.run(
                [sys.executable, "-c", _PRINT_DIGEST], input=request, capture_output=True, env=environment, check=False
            )
        tested.require(not ended.returncode, f"a run in another process fails: {ended.stderr.decode()[-300:]}")
        digests.add(ended.stdout)
    tested.require(
        len(digests) == 1,
        "runs under PYTHONHASHSEED=1 and =2 differ: sort sets before you go through or draw from them",
    )
