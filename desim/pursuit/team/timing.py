"""The events for which the protocol of a pursuer waits: times on its local clock, and arriving messages."""

from collections.abc import Callable
from functools import partial
from typing import Any

import simpy

from desim.config.arguments import value_text
from desim.config.calls import check_action
from desim.config.python_numbers import real
from desim.config.traits import OURS, module_of
from desim.kernel.core.clock import Clock, Instant, NodeClock, Phase
from desim.kernel.network import Network
from desim.kernel.state.inbox import Inbox, Message

RETURN_HINT = " (a protocol that has nothing left to wait for should return)"
"""Hint in error messages about an infinite, nan or negative waiting time."""
MAX_AT_ONE_INSTANT = 100_000
"""Number of times that a pursuer may wait for the same instant; one time more raises `StandstillError`."""


class StandstillError(RuntimeError):
    """A pursuer waits for the present instant again and again, so that time does not go on."""


class Timing:
    """Creates the events for which one pursuer waits; see `desim.pursuit.team.agent.Agent`.

    A protocol waits by yielding an event that `at`, `sleep`, `arrival`, `listen` or `after_decisions` returns. No
    method waits when it is called. Simultaneous events are ordered by phase, and events of one phase by pursuer id.

    Attributes:
        id: its id.
        restarts: number of restarts without memory after a crash.

    Args:
        pursuer: its id.
        env: the clock of the simulation.
        clock: its local clock.
        network: the network that delivers its messages.
    """

    def __init__(self, pursuer: int, env: Clock, clock: NodeClock, network: Network):
        self.id = pursuer
        self.restarts = 0
        self._env, self._clock, self._network = env, clock, network
        self._checked: set[tuple[Any, type]] = set()
        """The codes and the types of the functions of `after` that can be called; those of others are checked anew."""
        self._instant, self._waits = -1, 0
        """The last instant at which it waited for the present, ns, and how often it did so then."""
        self._resumed, self._resumptions = -1, 0
        """The last instant at which its protocol went on, ns, and how often it did so then."""
        self._listening: list[Inbox] = []
        """The inboxes whose messages go to functions."""
        self._may_ignore = True
        """Whether `listen` ignores messages; False in the runs of `desim.testing` that must take every message."""
        self._has_ignores = False
        """Whether a call of `listen` named messages to ignore."""

    def at(self, time: float, phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event at a time (s) on the local clock, rounded to nanoseconds; a time in the past counts as now.

        Raises:
            ValueError: if the time is infinite, nan or not a number.
            StandstillError: if it waits for the present without end.
        """
        if type(time) is not float:
            time = real(time, f"pursuer {self.id}: at: the time")
        try:
            due = max(self._clock.when(time), self._env.now)
            return self._event(due, phase)
        except (OverflowError, ValueError) as error:
            raise ValueError(f"pursuer {self.id}: at({time}): the time should be finite, s{RETURN_HINT}") from error

    def sleep(self, duration: float, phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event that happens after a duration (s) on the local clock.

        Raises:
            ValueError: if the duration is negative, infinite, nan or not a number.
            StandstillError: if it waits for the present without end.
        """
        return self._event_after(duration, phase, "sleep")

    def _event_after(self, duration: float, phase: Phase, method: str) -> Instant:
        """Return the event of this pursuer after a duration, s, that was given to a method; see `sleep`."""
        if type(duration) is not float:
            duration = real(duration, f"pursuer {self.id}: {method}: the duration")
        try:
            if duration < 0.0:  # also one that rounds to 0 ns
                raise ValueError(duration)
            return self._event(self._env.now + self._clock.span(duration), phase)
        except (OverflowError, ValueError) as error:
            text = f"{method}({duration}): the duration should be finite and at least 0 s{RETURN_HINT}"
            raise ValueError(f"pursuer {self.id}: {text}") from error

    def _event(self, due: int, phase: Phase) -> Instant:
        """Return the event of this pursuer at a time, ns."""
        self._check_phase(phase)
        if due == self._env.now:
            self._waits = self._waits + 1 if due == self._instant else 1
            self._instant = due
            if self._waits > MAX_AT_ONE_INSTANT:
                raise self._standstill("wait for longer, as in yield me.sleep(0.1)")
        return Instant(self._env, due, phase + self.id)

    def _check_phase(self, phase: Any) -> None:
        """Raise TypeError if a phase is no `Phase`: for example a time-out."""
        if not isinstance(phase, Phase):
            raise TypeError(
                f"pursuer {self.id}: a phase should be one of desim.kernel.core.clock.Phase (got {value_text(phase)})"
            )

    def resume(self) -> None:
        """Count that its protocol goes on at the present instant.

        Raises:
            StandstillError: if it goes on without end at one instant.
        """
        if (now := self._env.now) != self._resumed:
            self._resumed, self._resumptions = now, 1
            return
        self._resumptions += 1
        if self._resumptions > MAX_AT_ONE_INSTANT:
            raise self._standstill(
                "does it wait again for an event that has happened (write yield me.sleep(0.1) anew for each wait),"
                " leave messages of the port unread that me.arrival() then finds again, or answer messages that take no"
                " time?"
            )

    def _standstill(self, advice: str) -> StandstillError:
        return StandstillError(
            f"pursuer {self.id} has waited {MAX_AT_ONE_INSTANT:,} times for the same instant, {self._clock.now:.9g} s:"
            f" time stands still; {advice}"
        )

    def after(self, duration: float, act: Callable[[], object], phase: Phase = Phase.DECISION) -> None:
        """Call a function after a duration (s) on the local clock, unless the pursuer restarts without memory before.

        Raises:
            ValueError: if the duration is negative, infinite, nan or not a number, or `act` is no function that can be
                called without arguments and then does its work.
        """
        if not callable(act):
            raise ValueError(f"pursuer {self.id}: after: act should be a function (got {value_text(act)})")
        code = getattr(act, "__code__", None)
        if (code, type(act)) not in self._checked:  # a protocol may call `after` for each message
            if module_of(act.func if isinstance(act, partial) else act).partition(".")[0] not in OURS:
                check_action(act, (), f"pursuer {self.id}: after: act")
            if code is not None:
                self._checked.add((code, type(act)))
        restarts_before = self.restarts

        def happen(_: simpy.Event) -> None:
            if self.restarts == restarts_before:
                act()

        self._event_after(duration, phase, "after").callbacks.append(happen)

    def after_decisions(self) -> simpy.Event:
        """Return an event that happens at the present instant, after all decisions of this instant."""
        return self.sleep(0.0, Phase.HEARTBEAT)

    def arrival(self, port: str = "", phase: Phase = Phase.DECISION) -> simpy.Event:
        """Return an event that happens as soon as the inbox of a port is not empty; `Agent.mail` returns the messages.

        Raises:
            ValueError: if the port is no text.
        """
        self._check_phase(phase)
        return self._network.inbox(self.id, port).arrival(phase + self.id)

    def listen(
        self,
        act: Callable[[list[Message]], object],
        port: str = "",
        phase: Phase = Phase.DECISION,
        ignores: Callable[[Message], bool] | None = None,
    ) -> simpy.Event:
        """Call a function with the messages of a port as they arrive, and return an event that never happens.

        A process that only handles messages yields the event: `yield me.listen(take)`. This takes half of the time of a
        loop with `arrival` and `mail`. A call has all messages that arrive at one instant. Calls end with the next
        `listen` at this port, or when the pursuer restarts without memory; its new process then listens anew.

        If in doubt, leave out `ignores`. If it ignores most messages, a flood takes an eighth less time. It is called
        when a message is sent, and returns whether `act` would do nothing with this message, for example with a copy of
        a message that has arrived. An ignored message must stay without effect until it arrives, unless the pursuer
        restarts without memory, so the data that `ignores` reads may only grow. `ignores` must change nothing. The
        checks `check_protocol` and `check_dissemination` of `desim.testing` compare with runs without it.

        Kept equal to a process that waits for each arrival by
        `tests/protocols/test_dissemination.py::test_flooding_by_a_function_is_flooding_by_a_process`.

        Raises:
            ValueError: if the port is no text, or `act` or `ignores` is no function.
        """
        self._check_phase(phase)
        if not callable(act):
            raise ValueError(f"pursuer {self.id}: listen: act should be a function of messages (got {value_text(act)})")
        if ignores is not None and not callable(ignores):
            raise ValueError(
                f"pursuer {self.id}: listen: ignores should be a function of a message (got {value_text(ignores)})"
            )
        for function, takes, name in ((act, ("messages",), "act"), (ignores, ("message",), "ignores")):
            if function is not None and module_of(function).partition(".")[0] not in OURS:
                check_action(function, takes, f"pursuer {self.id}: listen: {name}")

        def take(messages: list[Message]) -> None:
            self.resume()
            act(messages)

        inbox = self._network.inbox(self.id, port)
        inbox.listen(phase + self.id, take, ignores if self._may_ignore else None)
        self._has_ignores |= ignores is not None
        self._listening.append(inbox)
        return simpy.Event(self._env)

    def _stop_listening(self) -> None:
        """Let the messages of all ports wait, because the pursuer restarts without memory."""
        for inbox in self._listening:
            inbox.stop()
        self._listening.clear()
