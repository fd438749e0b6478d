"""Dissemination: how the announcement of one pursuer becomes known to the others.

A dissemination is called with an agent and is the process that passes word on; `tell` is how a pursuer begins to spread
word of its own.

Paper: Flooding: whoever hears something new says it once more, after a random delay (Ni, Tseng, Chen & Sheu 1999, "The
    Broadcast Storm Problem"). Gossip: everybody tells all it knows (anti-entropy of Demers et al. 1987).
Parameters: hops (how far word is flooded), jitter (longest random delay).
Assumes: nothing; one hop is enough where everybody hears everybody.
Messages: per announcement one broadcast; flooded, up to one per pursuer; gossip's are as long as all that is known.
Robust to loss: with heartbeats. Flooding also where there are several paths.
"""

from functools import partial
from typing import Annotated, Any, Literal, Protocol

from pydantic import Field

from desim.config.model import Time, Value
from desim.pursuit.agent import Agent, Process
from desim.pursuit.announcements import Forwarded

PORT = "word"
"""Where word that is passed on comes in."""


class Dissemination(Protocol):
    """How word spreads."""

    def broadcast(self, me: Agent, news: Any) -> None:
        """Begin to spread an announcement of one's own."""
        ...

    def __call__(self, me: Agent) -> Process:
        """Pass on the word of others."""
        ...


class OneHop(Value):
    """Whoever is in reach hears it; nobody passes it on."""

    kind: Literal["one_hop"] = "one_hop"

    def broadcast(self, me: Agent, news: Any) -> None:
        """Publish it."""
        me.publish(news)

    def __call__(self, me: Agent) -> Process:
        """Do nothing."""
        yield from ()


class Flooding(Value):
    """Whoever hears something new says it once more, up to a number of hops; duplicates are dropped.

    A copy that may travel farther than the first is no duplicate.
    Robust to loss: where there are several paths. Messages: up to one transmission per pursuer and announcement.
    """

    kind: Literal["flooding"] = "flooding"
    hops: Annotated[int, Field(ge=1, strict=True)] = 5
    """Most hops that word travels."""
    jitter: Time = 0.005
    """Longest random delay J before something is said once more, s; it keeps neighbours from speaking at once."""

    def broadcast(self, me: Agent, news: Any) -> None:
        """Send it to the neighbours."""
        me.send(None, Forwarded((me.record(news),), self.hops), PORT)

    def __call__(self, me: Agent) -> Process:
        """Pass on what is new after a random delay."""
        rng = me.stream("flooding")
        passed_on: dict[int, tuple[int, int]] = {}  # by source: sequence number and hops of the last word
        while True:
            yield me.arrival(PORT)
            for message in me.mail(PORT):
                (record,), hops = message.body
                me.merge_records([record])
                if hops > 1 and record.src != me.id and (record.seq, hops) > passed_on.get(record.src, (0, 0)):
                    passed_on[record.src] = (record.seq, hops)
                    again = partial(me.send, None, Forwarded((record,), hops - 1), PORT)
                    me.after(rng.uniform(0.0, self.jitter), again)


class Gossip(Value):
    """Whenever a pursuer announces its action, it tells all it knows of others, too; who hears it merges by the newest.

    Robust to loss: yes, with heartbeats, which say everything again. Messages: long ones.
    """

    kind: Literal["gossip"] = "gossip"

    def broadcast(self, me: Agent, news: Any) -> None:
        """Send it with all that is known."""
        known = [record for _, record in me.latest_records().values()]
        me.send(None, Forwarded((me.record(news), *known)), PORT)

    def __call__(self, me: Agent) -> Process:
        """Merge what comes in."""
        while True:
            yield me.arrival(PORT)
            for message in me.mail(PORT):
                me.merge_records(message.body.records)
