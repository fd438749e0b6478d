"""An episode: a run that stops at each turn of a pursuer and waits for its action.

The run is performed in a greenlet, a coroutine with a stack of its own. Where a rule would yield an action, the played
rule switches to the caller. No schedule needs to know of this: the turns have the same order as in a run.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from threading import get_ident
from typing import Any, cast

from greenlet import GreenletExit, getcurrent, greenlet

from desim.config.answers import name_and_place
from desim.pursuit.team.agent import Agent
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, Simulation, run_observed
from protocols.rule import Rule

TURNS = "turns"
"""The attribute of a played rule that connects it with its episode; no key of a scenario."""


class _Turns:
    """The state that the two sides of an episode share: the run in its greenlet, and the caller.

    The run refers to this object and not to the episode: greenlets keep the objects to which their stacks refer, and
    the garbage collector does not look into stacks.
    """

    def __init__(self) -> None:
        self.simulation: Simulation | None = None
        self.is_closed = False

    def ask(self, me: Agent) -> int:
        """Return the action of a pursuer at its turn; if the episode was closed, its present action."""
        if not self.is_closed:
            try:
                action: int | None = getcurrent().parent.switch(me)
            except GreenletExit:  # nobody refers to the episode any more
                action = None
            if action is not None:
                return action
            self.is_closed = True
            if self.simulation is not None:
                self.simulation.stop()
        return me.action


class Episode:
    """A run that waits at each turn of a pursuer.

    An episode is waiting for the action of `turn`, or over. `act` continues it. A copy or an unpickled episode performs
    the run again up to the same instant.

    Args:
        scenario: the experiment; its protocol, a `Rule`, determines when pursuers take their turns.
        seed: the seed of the run.

    Attributes:
        turn: the pursuer whose action is awaited; None if the episode is over.
        result: the run; None as long as it lasts.

    Raises:
        TypeError: if the protocol has no turns of pursuers.
    """

    def __init__(self, scenario: Scenario, seed: int):
        self._scenario, self._seed, self._turns = scenario, seed, _Turns()
        self._actions: list[int] = []
        self._is_closed, self._has_failed, self._thread = False, False, get_ident()
        played = with_protocol(scenario, played_rule(rule_of(scenario), self._turns))
        self._run = greenlet(_perform)
        self.turn: Agent | None = None
        self.result: Result | None = None
        self._continue(played, seed, self._turns)

    @property
    def simulation(self) -> Simulation:
        """The agents, the state of the world, and the events so far."""
        assert self._turns.simulation is not None
        return self._turns.simulation

    def act(self, action: int) -> None:
        """Let the pursuer whose turn it is take an action, and continue to the next turn.

        Raises:
            ValueError: if there is no such action.
            RuntimeError: if another thread began the episode, or the run has failed.
        """
        self.check()
        self._actions.append(action)
        self._continue(action)

    def close(self) -> None:
        """End the run at this instant; later calls have no effect.

        A run that another thread began cannot be continued here, so the episode only forgets it.
        """
        if self.turn is not None:
            self._is_closed = True
            if self._thread == get_ident():
                self._continue(None)
            else:
                self.turn, self._run = None, None

    def check(self) -> None:
        """Raise `RuntimeError` if the episode cannot go on here."""
        if self._has_failed:
            raise RuntimeError("the run of this episode has failed: call reset()")
        if self.turn is not None and self._thread != get_ident():
            raise RuntimeError("another thread began this episode: call reset() in the thread that calls step()")

    def _continue(self, *values: Any) -> None:
        """Continue the run with some values until its next turn, or its result."""
        self._run.parent = getcurrent()  # the greenlet that calls may be another one than at the last turn
        try:
            answer: Agent | Result = self._run.switch(*values)
        except BaseException:
            self.turn, self._has_failed = None, True
            raise
        if isinstance(answer, Result):
            self.turn, self.result = None, Result(self._scenario, self._seed, answer.trace)
        else:
            self.turn = answer

    def __reduce__(self) -> tuple[Any, ...]:
        return _replayed, (self._scenario, self._seed, tuple(self._actions), self._is_closed)


def _replayed(scenario: Scenario, seed: int, actions: Sequence[int], is_closed: bool) -> Episode:
    """Return a new episode in which the given actions have been taken."""
    episode = Episode(scenario, seed)
    for action in actions:
        episode.act(action)
    if is_closed:
        episode.close()
    return episode


def _perform(scenario: Scenario, seed: int, turns: _Turns) -> Result:
    """Perform the run of an episode."""

    def begin(simulation: Simulation) -> None:
        turns.simulation = simulation

    return run_observed(scenario, seed, (), begin)


def rule_of(scenario: Scenario) -> Rule:
    """Return the protocol of a scenario.

    Raises:
        TypeError: if the protocol is not a rule, so that it has no turns at which an action could be asked for.
    """
    rule: Any = scenario.protocol
    if scenario.protocol_traits.schedule is None or not hasattr(rule, "actions"):
        raise TypeError(
            f"the protocol {name_and_place(rule)} has no turns at which an action could be asked for: choose a rule,"
            ' which has a schedule, for example scenario.with_({"protocol.kind": "sap"})'
        )
    return cast("Rule", rule)


def played_rule(protocol: Rule, turns: _Turns) -> Rule:
    """Return a rule whose actions the caller of the episode chooses.

    All else is as in the given rule: its schedule, whether pursuers without a choice take their turns, the size of its
    messages.
    """
    values = {name: getattr(protocol, name) for name in type(protocol).model_fields}
    played = _played_kind(type(protocol)).model_construct(**values)
    played.__dict__[TURNS] = turns
    return played


@lru_cache(maxsize=64)
def _played_kind(kind: type[Rule]) -> type[Rule]:
    """Return the class of the played rules of a kind; see `played_rule`."""

    def actions(self: Rule, me: Agent) -> Iterator[int]:
        turns: _Turns = self.__dict__[TURNS]
        while True:
            yield turns.ask(me)

    return type(f"Played{kind.__name__}", (kind,), {"actions": actions, "__module__": __name__})


def with_protocol(scenario: Scenario, protocol: Rule) -> Scenario:
    """Return a copy of a valid scenario with another protocol; nothing is validated again."""
    copy = scenario.model_copy()
    copy.__dict__["protocol"] = protocol
    return copy
