"""What tests of protocols that talk have in common."""

from desim.kernel.events import Sent


def bodies(result, kind):
    """Return the messages whose body is of a kind."""
    return [sent for sent in result.trace.of(Sent) if isinstance(sent.body, kind)]


class Storm:
    """Independent losses until a time, s; then none."""

    def __init__(self, p, until):
        self._p, self._until = p, until

    def __call__(self, hops, rng):
        return rng.random(len(hops.dst)) < (self._p if hops.now < self._until else 0.0)
