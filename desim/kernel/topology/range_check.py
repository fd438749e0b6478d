"""The range check: which messages reach their receivers, given the distances between sender and receiver.

Kept equal to a comparison of each distance with the range by
`tests/kernel/test_topology.py::test_a_disk_holds_just_those_whose_distance_is_at_most_the_range`.
"""

from math import inf

import numpy as np

from desim.config.answers import wrong_answer
from desim.config.arrays import Bools, Floats, Integers, array_of
from desim.config.python_numbers import real
from desim.config.traits import is_ours
from desim.kernel.core.positions import Nodes
from desim.kernel.core.seeds import ROOM, pair_draw, pair_uniform
from desim.kernel.models.coherence import ChannelState
from desim.kernel.models.reception import Disk, ReceptionModel, bound
from desim.kernel.models.traits import ReceptionTraits


class RangeCheck:
    """Decides which nodes a message reaches, given their distances from its sender.

    Args:
        reception: the probability of reception as a function of distance; a disk if None.
        range: the communication range of every node, m.
        per_link: whether random reception is drawn once per pair of nodes; if not, it is drawn for every message.
        seed: the seed of the random draws.
        size: number of nodes.

    The arguments of its methods, for k receivers, are the sender `src` (one for all or (k,)), the receivers `dst` (k,),
    their `distances` (k,) in m, and the number of the `message` (one for all or (k,)). If fading is per message and
    there is no number, a message is received where the probability is at least 1/2.
    """

    def __init__(self, reception: ReceptionModel | None, range: float, per_link: bool, seed: int, size: int):  # noqa: A002
        self._reception, self._range, self._per_link = Disk() if reception is None else reception, range, per_link
        self._seed, self._size = seed, size
        self._is_certain, self._is_ours = type(self._reception) is Disk, is_ours(type(self._reception))
        traits = ReceptionTraits.of(self._reception)
        self._one, self._border = traits.one, traits.border
        self.exponent = traits.exponent
        """The path loss exponent n by which walls shorten the range."""
        self._drawn: dict[int, Floats] = {}
        """By sender, the draws of its pairs with all nodes; `ROOM` draws at most."""

    @property
    def bound(self) -> float:
        """The distance, m, beyond which nothing is received; inf if there is none."""
        return bound(self._reception, self._range)

    @property
    def has_border(self) -> bool:
        """Whether each link has a distance up to which all messages are received, and none beyond; see `border`."""
        return self._is_certain or (self._per_link and self._border is not None)

    def border(self, src: int, dst: Nodes) -> float | Floats:
        """Return the distances, m, up to which messages are received: one for all of the nodes `dst`, or (k,)."""
        return self._range if self._border is None else self._border(self._draws(src, dst, None), self._range)

    def __call__(self, src: int | Nodes, dst: Nodes, distances: Floats, message: int | Integers | None) -> Bools:
        """Return (k,) booleans: which of the nodes `dst` receive a message."""
        if self._is_certain:
            return distances <= self._range
        probability = self._reception(distances, self._range)
        if not self._is_ours:
            probability = _probabilities(probability, len(distances), self._reception)
        return self._draws(src, dst, message) <= probability

    def through(self, channel: ChannelState, distances: Floats) -> Bools:
        """Return (k,) which messages are received in the present states of their channels, at (k,) distances, m.

        Raises:
            ValueError: if the model has no method `received`, or this returns no boolean for each link.
        """
        received = ReceptionTraits.of(self._reception).received
        if received is None:
            raise wrong_answer("a model of reception should have a method received", self._reception, self._reception)
        booleans = array_of(answer := received(distances, self._range, channel))
        if booleans.dtype != bool or booleans.shape != distances.shape:
            raise wrong_answer(
                f"received should return a boolean for each of {len(distances)} links", answer, self._reception
            )
        return booleans

    def one(self, src: int, dst: int, distance: float, message: int) -> bool:
        """Return whether one node receives a message.

        Kept equal to the receivers among several nodes by
        `tests/kernel/test_topology.py::test_several_messages_reach_what_each_of_them_reaches`.
        """
        if self._is_certain:
            return distance <= self._range
        probability = self._probability(distance)
        if self._per_link:
            draws = self._drawn.get(src)
            draw = pair_draw(self._seed, "fading", src, dst) if draws is None else draws.item(dst)
        else:
            draw = pair_draw(self._seed, "fading", src, dst, message, symmetric=False)
        return draw <= probability

    def _probability(self, distance: float) -> float:
        """Return the probability of reception at a distance, m."""
        if self._one is not None:
            return real(self._one(distance, self._range), "a probability of reception")
        probability = self._reception(np.array([distance]), self._range)
        if not self._is_ours:
            probability = np.broadcast_to(_probabilities(probability, 1, self._reception), 1)
        return float(probability[0])

    def _draws(self, src: int | Nodes, dst: Nodes, message: int | Integers | None) -> Floats:
        """Return (k,) uniform draws in (0, 1), one for each pair of a sender and a receiver.

        Kept equal to numbers computed at each use by
        `tests/kernel/test_topology.py::test_pair_uniforms_are_the_same_with_and_without_caching`.
        """
        if not self._per_link:
            if message is None:
                return np.full(len(dst), 0.5)
            return pair_uniform(self._seed, "fading", src, dst, message, symmetric=False)
        if not isinstance(src, int):
            return pair_uniform(self._seed, "fading", src, dst)
        if src not in self._drawn and (len(self._drawn) + 1) * self._size <= ROOM:
            self._drawn[src] = pair_uniform(self._seed, "fading", src, np.arange(self._size))
        draws = self._drawn.get(src)
        return pair_uniform(self._seed, "fading", src, dst) if draws is None else draws[dst]


class WalledRangeCheck(RangeCheck):
    """A range check among walls: distances are stretched by walls, and infinite where a wall is opaque."""

    def __call__(self, src: int | Nodes, dst: Nodes, distances: Floats, message: int | Integers | None) -> Bools:
        """Return (k,) booleans: which of the nodes `dst` receive a message."""
        if self._is_certain and self._range < inf:
            return distances <= self._range
        audible: Bools = distances < inf
        if self._range == inf:
            return audible
        received = np.zeros(len(dst), dtype=bool)
        if audible.any():
            sources = src if isinstance(src, int) else src[audible]
            numbers = message if message is None or isinstance(message, int) else message[audible]
            received[audible] = super().__call__(sources, dst[audible], distances[audible], numbers)
        return received

    def through(self, channel: ChannelState, distances: Floats) -> Bools:
        """Return (k,) which messages are received in the present states of their channels, at (k,) distances, m."""
        audible: Bools = distances < inf
        return audible & super().through(channel, np.where(audible, distances, 1.0))


def _probabilities(answer: object, count: int, model: ReceptionModel) -> Floats:
    """Return the probabilities of reception that a user's model returned for `count` links.

    Raises:
        ValueError: if they are neither one number in [0, 1] nor one for each link.
    """
    probabilities = array_of(answer)
    is_numeric = probabilities.dtype.kind in "biuf" and probabilities.shape in {(), (count,)}
    if is_numeric and ((probabilities >= 0.0) & (probabilities <= 1.0)).all():
        return probabilities
    expected = f"a model of reception should return a probability in [0, 1] for each of {count} links"
    raise wrong_answer(expected, answer, model)
