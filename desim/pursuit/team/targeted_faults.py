"""Faults that depend on the run: they concern the pursuers that chase when they begin, or the messages that are news.

A fault of a fixed pursuer seldom hits the pursuer that matters. These faults find it, as the targeted faults of
fault-injection tests of distributed systems do.
"""

from collections.abc import Mapping, Sequence
from math import inf
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from desim.config.model import Extent, Flag, Time
from desim.kernel.models.faults import Crash, Fault, FaultSite, Partition, Undo
from desim.kernel.transport.frames import Segment, carried
from desim.pursuit.team.announcements import Forwarded, announced_action


class TargetedFault(Fault):
    """Base of the faults of pursuers that chase; if none chases when it starts, such a fault has no effect.

    The trace records this fault, and each fault that it causes.
    """

    chasers: Annotated[int, Field(ge=1, strict=True)] = 1
    """The greatest number of pursuers that it concerns: those that would capture first.

    If in doubt, use 1: the relay pursuer.
    """

    def begin(self, site: FaultSite) -> Undo:
        """Begin the faults that it causes for the pursuers that chase now."""
        nodes = tuple(site.targets())[: self.chasers]
        undos = [site.begin(fault) for fault in self.faults_of(nodes)] if nodes else []

        def end() -> None:
            for undo in undos:
                undo()

        return end

    def faults_of(self, nodes: tuple[int, ...]) -> list[Fault]:
        """Return the faults that it causes for some pursuers, at least one."""
        raise NotImplementedError


class ChaserCrash(TargetedFault):
    """Chasing pursuers crash, and recover if the fault ends."""

    kind: Literal["chaser_crash"] = "chaser_crash"
    scope: Literal["radio", "robot"] = "robot"
    """radio: the pursuer neither sends nor receives; robot: it does not move or decide either."""
    memory: Flag = True
    """Whether it keeps its beliefs; see `Crash.memory`."""

    breaks: ClassVar[frozenset[str]] = Crash.breaks

    @property
    def messages_only(self) -> bool:
        """Whether only the radio is down."""
        return self.scope == "radio"

    def faults_of(self, nodes: tuple[int, ...]) -> list[Fault]:
        """Return a crash of each pursuer."""
        return [
            Crash(start=self.start, end=self.end, node=node, scope=self.scope, memory=self.memory) for node in nodes
        ]


class ChaserCut(TargetedFault):
    """Chasing pursuers are cut off: they go on, but no message passes between one of them and any other pursuer."""

    kind: Literal["chaser_cut"] = "chaser_cut"

    breaks: ClassVar[frozenset[str]] = Partition.breaks

    def faults_of(self, nodes: tuple[int, ...]) -> list[Fault]:
        """Return a partition that separates each pursuer from all others."""
        return [Partition(start=self.start, end=self.end, groups=tuple((node,) for node in nodes))]


class NewsFault(Fault):
    """The first message after each change of its sender's action is lost, or arrives late; the next messages are not.

    The first message of each pursuer after the start of the fault counts as news, too.
    """

    kind: Literal["news_fault"] = "news_fault"
    start: Time = 0.0
    """Start time, s."""
    delay: Extent = inf
    """Time by which the message is late, s; inf: it is lost.

    If in doubt, use inf, or a little more than the time-out of beliefs (`announce.belief_timeout`).
    """
    changes: Annotated[int, Field(ge=1, strict=True)] | None = None
    """The greatest number of changes that it concerns, of all pursuers together; None = all."""

    def begin(self, site: FaultSite) -> Undo:
        """Intercept the messages that are news."""
        announced: dict[int, int] = {}
        changes_left = inf if self.changes is None else self.changes

        def delays(src: int, receivers: Sequence[int], body: Any) -> Mapping[int, float]:
            nonlocal changes_left
            action = _told_action(src, body)
            if action is None or announced.get(src) == action:
                return {}
            announced[src], changes_left = action, changes_left - 1
            return dict.fromkeys(receivers, self.delay) if changes_left >= 0 else {}

        return site.intercept(delays)

    @property
    def label(self) -> str:
        """What becomes of the messages."""
        return f"news {'lost' if self.delay == inf else 'late'}"


def _told_action(src: int, body: Any) -> int | None:
    """Return the action of its sender that a message tells, perhaps in a record that it relays; None: no action.

    A repetition by a transport tells none: it may be older than the last news.
    """
    if isinstance(body, Segment) and body.attempt > 1:
        return None
    message = carried(body)
    if not isinstance(message, Forwarded):
        return announced_action(message)
    of_sender = [record for record in message.records if record.src == src]
    return announced_action(max(of_sender, key=attrgetter("seq")).body) if of_sender else None


TARGETED: tuple[type[Fault], ...] = (ChaserCrash, ChaserCut, NewsFault)
"""The faults that depend on the run."""
