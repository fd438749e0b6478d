"""Invariants of radio and sight among walls: nothing is received or seen through an opaque wall."""

from bisect import bisect_right
from collections import deque
from math import inf

import numpy as np

from desim.config.arrays import Floats
from desim.kernel.core.events import LOST, Broadcast, Event, Lost, Sent
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.models.clock_skew import is_skewed
from desim.kernel.walls.crossings import Segments, crossings
from desim.kernel.walls.wall import blocking
from desim.pursuit.core.events import Sampled, Started
from desim.pursuit.sensing.sensing import Sighting
from desim.scenario.scenario import Scenario

ROUNDING = 1e-6
"""Tolerance for rounding errors, m."""
KEPT = 512
"""Number of samples that are kept: a sighting may be reported later."""


class OpacityWatcher:
    """A watcher that checks that nothing is received or seen through a wall that is opaque.

    - A message is not received if an opaque wall is between its sender and its receiver when their range is checked: at
      transmission, or on arrival (`network.range_check`).
    - A pursuer does not report that it has seen an evader itself, without noise, when a wall that blocks sight was
      between them. Reports of tracks, and those that relay sightings of others, are not judged.

    Positions are known at samples. After a sample, each player is within the distance that it can have moved. The
    watcher raises an error only if a wall is between two players wherever they are within these distances.

    Args:
        scenario: the scenario of the run.

    Attributes:
        judged: the number of receptions and sightings that were compared, among opaque walls.
    """

    def __init__(self, scenario: Scenario):
        opaque = [wall for wall in scenario.wall if wall.decibels == inf]
        self._radio, self._sight = blocking(opaque, "radio"), blocking(scenario.wall, "sight")
        self._check = scenario.network.range_check
        relays = scenario.team.relays
        pursuers = [relays[j].top_speed if j in relays else v for j, v in enumerate(scenario.team.all_speeds())]
        evaders = [evader.speed if evader.record is None else evader.record.top_speed for evader in scenario.evaders]
        self._speeds = np.array([*pursuers, *evaders]) + scenario.environment.top_speed
        if scenario.motion.static:
            self._speeds[:] = 0.0
        # A relayed report is of another pursuer's sighting, a skewed clock shows another time, and the team of an
        # omniscient protocol has no sensors.
        judges_sight = not (scenario.sensing.relay or is_skewed(scenario.fault) or scenario.protocol_traits.omniscient)
        self._judges_sight = bool(self._sight) and judges_sight
        self._size = scenario.team.count
        self._samples: deque[tuple[int, Floats]] = deque(maxlen=KEPT)
        self._flying: dict[tuple[int, int], tuple[int, int]] = {}
        """By transmission and receiver, for messages judged on arrival: the sender, and the time of arrival, ns."""
        self.judged = 0

    def __call__(self, event: Event) -> None:
        """Process an event."""
        if not (self._radio or self._judges_sight):
            return
        if isinstance(event, Started | Sampled):
            self._samples.append((event.t, np.array([*event.pursuers, *event.evaders])))
            self._judge_arrived(event.t)
        elif isinstance(event, Broadcast | Sent):
            self._judge_transmission(event)
            self._judge_sightings(event)
        elif isinstance(event, Lost):
            self._flying.pop((event.transmission, event.dst), None)

    def _judge_transmission(self, event: Broadcast | Sent) -> None:
        arrivals = {dst: arrival for dst, arrival in event.fates() if arrival != LOST} if self._radio else {}
        if arrivals and self._check != "delivery":
            self._judge_receptions(event.t, event.src, [*arrivals])
        if self._check != "send":
            self._flying |= {(event.transmission, dst): (event.src, arrival) for dst, arrival in arrivals.items()}

    def _judge_arrived(self, now: int) -> None:
        """Judge the messages that have arrived, and were not lost."""
        for key, (src, arrival) in [*self._flying.items()]:
            if arrival < now:
                del self._flying[key]
                self._judge_receptions(arrival, src, [key[1]])

    def _judge_receptions(self, t: int, src: int, receivers: list[int]) -> None:
        """Judge the receptions of a message of the node `src` by some nodes at a time, ns."""
        self.judged += len(receivers)
        for dst in self._behind(t, src, receivers, self._radio):
            raise AssertionError(
                f"nothing is received through an opaque wall: {seconds(t)} s, pursuer {src} to {dst}, at"
                f" {self._place(t, src)} and {self._place(t, dst)} just before"
            )

    def _judge_sightings(self, event: Broadcast | Sent) -> None:
        """Judge the sightings that a pursuer reports."""
        body = event.body if self._judges_sight and isinstance(event.body, tuple) else ()
        if not all(isinstance(item, Sighting) for item in body):
            return
        for sighting in body:
            t = nanoseconds(sighting.seen)
            self.judged += 1
            for evader in self._behind(t, event.src, [self._size + sighting.evader - 1], self._sight):
                raise AssertionError(
                    f"nothing is seen through a wall: pursuer {event.src} reports evader {sighting.evader}, seen at"
                    f" {sighting.seen} s, at {self._place(t, event.src)} and {self._place(t, evader)} just before"
                )

    def _behind(self, t: int, player: int, others: list[int], segments: Segments) -> list[int]:
        """Return the players that are certainly behind a wall, as seen from another one, at a time, ns."""
        sample = self._last_sample(t)
        if sample is None:
            return []
        when, places = sample
        margin = self._speeds[[player, *others]].max() * seconds(abs(t - when)) + ROUNDING
        behind = np.asarray(crossings(places[[player]], places[others], segments, margin).any(axis=1))
        return [other for other, is_behind in zip(others, behind.tolist(), strict=True) if is_behind]

    def _last_sample(self, t: int) -> tuple[int, Floats] | None:
        """Return the last sample up to a time, ns; None if it is no longer kept."""
        index = bisect_right(self._samples, t, key=lambda sample: sample[0])
        return self._samples[index - 1] if index else None

    def _place(self, t: int, player: int) -> list[float]:
        sample = self._last_sample(t)
        assert sample is not None
        return [round(coordinate, 3) for coordinate in sample[1][player].tolist()]
