"""Processes of pursuers that survive crashes of their robots."""

import re
from collections.abc import Iterator
from inspect import iscoroutine
from typing import cast

import simpy

from desim.config.answers import wrong_answer
from desim.config.arguments import HintedItems, arguments_of, missing_attribute, value_text, with_article
from desim.config.traits import is_ours
from desim.kernel.core.clock import Clock, Phase
from desim.pursuit.team.agent import Agent, Behaviour, Process

PROCESS = "a protocol, or another process of a pursuer,"
"""The name of a behaviour in error messages."""


class RestartableProcess(simpy.Process):
    """A process of a pursuer that runs a behaviour (its protocol or dissemination) and survives crashes of the robot.

    The process is running, suspended (the robot is down) or finished. After a recovery with memory it waits for the
    same event, or continues at the instant of the recovery if the event has happened meanwhile. After a recovery
    without memory it starts the behaviour anew. A process that finished before the crash stays finished.
    """

    def __init__(self, env: Clock, agent: Agent, protocol: Behaviour, phase: Phase):
        self.behaviour: Process | None = None
        self._agent = agent
        super().__init__(env, self._behave(agent, protocol, phase))

    def close(self) -> None:
        """End the behaviour at the end of the run: its `finally` runs.

        A behaviour that goes on after that, as with a bare `except`, is left to Python.

        Raises:
            Exception: any exception of the behaviour, with the notes of one that it raises during the run.
        """
        try:
            self._close_behaviour()
        except RuntimeError:
            if getattr(self.behaviour, "gi_frame", None) is None:
                raise

    def _close_behaviour(self) -> None:
        end = getattr(self.behaviour, "close", None)  # an iterator of a user needs none
        try:
            if end is not None:
                end()
        except (Exception, SystemExit) as error:
            _add_notes(error, self._agent.id, self._agent)
            raise

    def _behave(self, agent: Agent, protocol: Behaviour, phase: Phase) -> Process:
        """Yield the events of the behaviour; pursuers start at time 0 in the order of ids, not of creation.

        Raises:
            AnswerError: if the behaviour is no generator, or yields anything but an event.
            AttributeError: if the behaviour has changed the id of its agent.
            Exception: any exception of the behaviour, with a note that names the pursuer and the time of its clock.
        """
        pursuer = agent.id
        awaited: simpy.Event = agent.at(agent.now, phase)  # what the behaviour waits for, or when it (re)starts
        missed: simpy.Event | None = None  # the awaited event, if it happened while the robot was down
        while True:
            try:
                value = yield awaited
            except simpy.Interrupt as crash:
                # The cause of the interrupt is the recovery, an event whose value is whether the robot kept its memory.
                remembers = yield cast("simpy.Event", crash.cause)
                if remembers:
                    # If the robot crashed again before it resumed, `missed` stays the event that the behaviour awaits.
                    if missed is None and awaited.processed:
                        missed = awaited
                elif self.behaviour is not None:
                    self._close_behaviour()  # runs its `finally`
                    self.behaviour = missed = None
                if self.behaviour is None or awaited.processed:
                    awaited = agent.at(agent.now, phase)  # resume in its phase, after the arrivals of this instant
                continue
            if missed is not None:
                value, missed = missed.value, None
            try:
                agent.resume()
                if self.behaviour is None:
                    self.behaviour = _start_behaviour(protocol, agent)
                    awaited = next(self.behaviour)
                else:
                    awaited = self.behaviour.send(value)
                if not isinstance(awaited, simpy.Event):
                    raise wrong_answer(f"{PROCESS} should yield events such as me.sleep(0.1)", awaited, protocol)
                if agent.id != pursuer:  # checked here: a read-only `id` would slow down each use
                    raise _restored_id_error(agent, pursuer)
            except StopIteration:
                if agent.id != pursuer:
                    raise _restored_id_error(agent, pursuer) from None
                return
            except (Exception, SystemExit) as error:
                _add_notes(error, pursuer, agent)
                raise


def _add_notes(error: BaseException, pursuer: int, agent: Agent) -> None:
    """Add to an exception of a behaviour its pursuer and the time of its clock, and advice if there is any."""
    error.add_note(f"(pursuer {pursuer}, at {agent.now:g} s of its clock)")
    if isinstance(error, TypeError | AttributeError) and (advice := _advice(error)):
        error.add_note(advice)


def _restored_id_error(agent: Agent, pursuer: int) -> AttributeError:
    """Restore the id of an agent, and return the error for the protocol that has changed it."""
    agent.id, other = pursuer, agent.id
    return AttributeError(
        f"pursuer {pursuer}: the protocol has set me.id to {value_text(other)}; the id of an agent stays"
    )


METHOD_AS_VALUE = re.compile(r"'(?:method|function)' object|operand .*'(?:method|function)'")
"""Matches Python's message about a method that was used as a value."""
EVENT_CLASSES = {"Event", "Instant"}
"""The classes that Python's message names if a behaviour writes `yield from` before an event."""
NOT_ITERABLE = re.compile(r"'(\w+)' object is not iterable")
WRONG_CALL = re.compile(r"(\w+)\.([^\W_]\w*)\(\) ")
"""Matches Python's message about wrong arguments; its groups are the class and the name of the public method called."""


def _advice(error: TypeError | AttributeError) -> str:
    """Return what to write in a protocol instead of the code that raised an error; "" for an unknown mistake."""
    message, owner, name = str(error), getattr(error, "obj", None), getattr(error, "name", None)
    if isinstance(owner, HintedItems) and isinstance(name, str) and not hasattr(type(owner), name):
        return str(missing_attribute(owner, name))
    has_advice = hasattr(type(owner), "_instead_of")  # such a class words its own advice
    if owner is not None and is_ours(type(owner)) and not has_advice:
        names = sorted(name for name in set(dir(owner)) - set(dir(tuple)) if not name.startswith("_"))
        return f"{with_article(type(owner).__name__)} has {', '.join(names)}"
    if METHOD_AS_VALUE.search(message):
        return "a method of a pursuer is called, me.position() for instance"
    if re.search("'complex'|complex object", message):
        return "a position is a complex number: its x is .real, its y is .imag, and abs(a - b) is a distance"
    if (kind := NOT_ITERABLE.search(message)) and kind[1] in EVENT_CLASSES:
        return "an event is waited for with yield: `yield me.sleep(0.1)`, not `yield from`"
    call = WRONG_CALL.match(message)
    method = getattr(Agent, call[2], None) if call and call[1] in (kind.__name__ for kind in Agent.__mro__) else None
    if call is None or method is None:
        return ""
    return f"it is me.{call[2]}{arguments_of(method)}: {(method.__doc__ or '').partition(chr(10))[0]}"


def _start_behaviour(protocol: Behaviour, agent: Agent) -> Process:
    """Create the generator that runs a behaviour for a pursuer.

    Raises:
        AnswerError: if the behaviour returns no generator.
    """
    behaviour = protocol(agent)
    coroutine: object = behaviour
    if iscoroutine(coroutine):
        coroutine.close()
        why = f"{PROCESS} should have `def` and `yield` in place of `async def` and `await`"
        raise wrong_answer(why, behaviour, protocol)
    if not isinstance(behaviour, Iterator):
        raise wrong_answer(f"{PROCESS} should be a generator that yields the events it waits for", behaviour, protocol)
    if hasattr(behaviour, "send"):
        return behaviour
    return (event for event in behaviour)  # an iterator of a list has no `send`
