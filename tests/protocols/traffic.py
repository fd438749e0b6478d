"""What tests of protocols that talk have in common."""

from desim import Scenario
from desim.kernel.core.events import Sent
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.pursuit.core.events import Decided
from desim.pursuit.team.announcements import Announcements
from desim.scenario.players import Team
from desim.scenario.scenario import Motion

SECOND = 1_000_000_000


def standing(protocol, *, count, horizon=10.0, latency=0.0, faults=(), trigger="never", **links):
    """Return a game that stands still, negotiated by a protocol."""
    model = Constant(value=latency) if isinstance(latency, float) else latency
    return Scenario(
        horizon=horizon,
        team=Team(count=count, speeds=2.0),
        motion=Motion(static=True),
        protocol=protocol,
        network=Links(latency=model, **links),
        announce=Announcements(trigger=trigger, start="known"),
        fault=faults,
        record={"trajectory": 0.0, "messages": True},
    )


def flips(schedule, log=None, links=None):
    """Return the protocol that decides by a coin, and logs what it believed of the others and what is true.

    Of all others or, given the links of the network, of its neighbours only.
    """
    truth = {}

    def protocol(me):
        truth.setdefault(me.id, me.action)

        def revise():
            if log is not None:
                others = (set(truth) if links is None else set(links[me.id])) - {me.id}
                log.append((set(me.believed_active()) & others, {j for j in others if truth[j]}))
            me.assign(me.rng.random() < 0.5)
            truth[me.id] = me.action

        yield from schedule(me, revise)

    return protocol


def decided(result, since=0.0, until=float("inf")):
    """Return the decisions from one time to another, s."""
    return [d for d in result.trace.of(Decided) if since * SECOND <= d.t < until * SECOND]


def bodies(result, kind):
    """Return the messages whose body is of a kind."""
    return [sent for sent in result.trace.of(Sent) if isinstance(sent.body, kind)]


class Storm:
    """Independent losses until a time, s; then none."""

    def __init__(self, p, until):
        self._p, self._until = p, until

    def __call__(self, context, rng):
        return rng.random(len(context.dst)) < (self._p if context.now < self._until else 0.0)
