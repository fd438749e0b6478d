"""Invariants of pursuits: watchers that raise AssertionError if an invariant is broken in a run.

    result = watched(scenario, seed)
    result = run(scenario, seed, MotionWatcher(scenario), PotentialWatcher(scenario))

A watcher is a function called with each event of a run (`desim.kernel.core.events.Watcher`). It can also be called with
the events of a finished trace. A new watcher is needed for each run. The invariants of messages are in
`desim.testing.messages`.
"""

from cmath import phase
from math import fsum
from typing import TYPE_CHECKING, TypeGuard

import numpy as np
from numpy.typing import NDArray

from desim.analysis.metrics import active_time, energy
from desim.analysis.timeline import RelativePlaces
from desim.config.arguments import naming_arguments, scenario_argument
from desim.config.traits import inherits, overrides, positions
from desim.kernel.core.events import Event, Watcher
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Ended, Sampled, Started
from desim.pursuit.core.state import complex_points, lengths
from desim.pursuit.game.game import welfare
from desim.pursuit.motion.capture import RadialTime
from desim.pursuit.motion.dynamics import Limited, coasts
from desim.pursuit.motion.flow import is_uniform
from desim.pursuit.motion.guidance import ConstantBearing, apollonius_disc
from desim.scenario.scenario import Scenario
from desim.simulation.run import Result, run
from desim.testing.messages import Conservation, DeliveredOnce
from desim.testing.opacity import OpacityWatcher
from desim.testing.paths import PathWatcher

if TYPE_CHECKING:
    from desim.config.arrays import Points

ROUNDING = 1e-9
"""Tolerance for rounding errors, absolute (in m, s or m^2/s) and, except for the potential, relative."""


@naming_arguments
def watched(scenario: Scenario, seed: int | None = None, *watchers: Watcher) -> Result:
    """Run a scenario as `run` does, with the watchers whose invariants hold in every run, and return the result.

    These watchers are `Conservation`, `DeliveredOnce`, `ActiveTimeWatcher`, `MotionWatcher`, `InertiaWatcher`,
    `PathWatcher`, `OpacityWatcher` and, if its assumptions hold, `ApolloniusWatcher`. `watchers` are added to them. Use
    this function in tests of a protocol or a model.

    Raises:
        TypeError: if `scenario` is no scenario.
        AssertionError: if an invariant is broken.
    """
    scenario_argument(Scenario).check(scenario, "watched")
    stopwatches = ActiveTimeWatcher()
    standard: list[Watcher] = [
        Conservation(),
        DeliveredOnce(),
        stopwatches,
        MotionWatcher(scenario),
        InertiaWatcher(scenario),
        PathWatcher(scenario),
        OpacityWatcher(scenario),
    ]
    standard += [ApolloniusWatcher(scenario)] if ApolloniusWatcher.applies(scenario) else []
    result = run(scenario, seed, *standard, *watchers)
    stopwatches.judge(result)
    return result


class ActiveTimeWatcher:
    """A watcher that measures the active time of each pursuer with a stopwatch.

    After the run, `judge` compares the metrics of active time and energy with the stopwatches.

    Attributes:
        profile: (N,) actions of the pursuers, as in `Decided`.
        end: time of the end of the run, ns; 0 before it.
    """

    def __init__(self) -> None:
        self.profile: list[int] = []
        self._speeds: tuple[float, ...] = ()
        self._stopped: list[int] = []
        """(N,) active time of each pursuer before its present action, ns."""
        self._since: list[int] = []
        """(N,) start of the present action, ns."""
        self.end = 0

    def __call__(self, event: Event) -> None:
        """Process an event."""
        if isinstance(event, Started):
            self.profile, self._speeds = list(event.active), event.speeds
            self._stopped, self._since = [0] * len(self.profile), [event.t] * len(self.profile)
        elif isinstance(event, Decided):
            self._change(event, event.pursuer, event.active)
        elif isinstance(event, BrokeDown):
            self._change(event, event.pursuer, 0)
        elif isinstance(event, Captured):
            for pursuer, action in enumerate(self.profile):
                if action == event.evader:
                    self._change(event, pursuer, 0)
        elif isinstance(event, Ended):
            self.end = event.t

    def until(self, t: int) -> NDArray[np.int64]:
        """Return the (N,) active times, ns, of the pursuers up to time t (ns), which is not before the last event."""
        running = np.array(self.profile) > 0
        return np.array(self._stopped) + np.where(running, t - np.array(self._since), 0)

    def judge(self, result: Result) -> None:
        """Raise AssertionError if the active time or the energy of the run differs from the stopwatches."""
        active_times = self.until(self.end) / SECOND
        _require_same("active time", active_time(result), float(active_times.sum()))
        _require_same("energy", energy(result), fsum(np.square(self._speeds) * active_times))

    def _change(self, event: Event, pursuer: int, action: int) -> None:
        if self.profile[pursuer]:
            self._stopped[pursuer] += event.t - self._since[pursuer]
        self.profile[pursuer], self._since[pursuer] = action, event.t


class MotionWatcher:
    """A watcher of the positions of all players, at every sample of the trajectory (`record.trajectory`).

    The invariant is that positions are continuous and no player exceeds its speed. Between two samples a pursuer moves
    at most v_i times the time for which it was active, a relay at most the top speed of its record times the elapsed
    time, and an evader at most v_e times the time for which it was at large. A player that coasts, for instance brakes
    with a limited acceleration, also moves when it is inactive or captured. In a static game no player moves. In a flow
    that is the same everywhere, the motion relative to the flow is checked; in any other flow, the top speed of the
    flow is added to all speeds.

    Args:
        scenario: the scenario of the run.
    """

    def __init__(self, scenario: Scenario):
        self._evader_speeds = np.array([evader.speed for evader in scenario.evaders])
        self._capture_times = np.full(len(self._evader_speeds), np.inf)  # ns; inf while free
        self._moves = not scenario.motion.static
        self._relays = scenario.team.relays
        self._active = ActiveTimeWatcher()
        self._last: tuple[int, Points, NDArray[np.int64]] | None = None
        self._places, self._environment = RelativePlaces(scenario), scenario.environment
        dynamics = [*[scenario.team.dynamics] * scenario.team.count, *(evader.dynamics for evader in scenario.evaders)]
        self._coasting = [player for player, body in enumerate(dynamics) if coasts(body)]

    def __call__(self, event: Event) -> None:
        """Process an event."""
        self._active(event)
        if isinstance(event, Started):
            self._speeds = np.array([*event.speeds, *self._evader_speeds])
            self._speeds[[*self._relays]] = [motion.top_speed for motion in self._relays.values()]
            self._check_positions(event)
        elif isinstance(event, Sampled):
            self._check_positions(event)
        elif isinstance(event, Captured):
            self._capture_times[event.evader - 1] = event.t

    def _check_positions(self, event: Started | Sampled) -> None:
        places = self._places(event)
        motion_times = np.concatenate([self._active.until(event.t), np.minimum(event.t, self._capture_times)])
        motion_times[[*self._relays, *self._coasting]] = event.t
        if self._last is not None:
            last_t, last_places, last_motion_times = self._last
            bound = self._moves * self._speeds * (motion_times - last_motion_times) / SECOND
            if not is_uniform(self._environment.flow) and event.t > last_t:
                bound = bound + self._environment.top_speed * seconds(event.t - last_t)
            distance = lengths(places - last_places)
            # Coordinates far from the origin are rounded more, and so are places relative to the flow.
            tolerance = ROUNDING * (1.0 + bound) + 1e-12 * lengths(places) + 2.0 * self._places.error
            fast = np.flatnonzero(~(distance <= bound + tolerance))
            if len(fast):
                player = fast[0]
                raise AssertionError(
                    f"no player exceeds its speed: from {seconds(last_t)} to {seconds(event.t)} s player {player} (the"
                    f" {len(event.pursuers)} pursuers come first) moved {distance[player]} m, but can move at"
                    f" most {bound[player]} m"
                )
        self._last = event.t, places, motion_times


class InertiaWatcher:
    """A watcher of the accelerations and the turn rates of players with inertia, at the samples of the trajectory.

    With a limited acceleration a, positions p, p' and p'' at three samples, h apart, satisfy |p'' - 2 p' + p| <= a h^2.
    With a limited turn rate omega, the directions of two successive displacements differ by at most omega times the
    whole time. At full speed the bound is omega times the time between the middles of the displacements, with a
    relative error of about the square of this angle. Positions are relative to the flow. Dynamics of your own are
    compared if they say what they limit (`desim.pursuit.motion.dynamics.Limited`).

    Args:
        scenario: the scenario of the run.

    Attributes:
        judged: the number of pairs of displacements compared.
    """

    def __init__(self, scenario: Scenario):
        self._places = RelativePlaces(scenario)
        dynamics = [*[scenario.team.dynamics] * scenario.team.count, *(evader.dynamics for evader in scenario.evaders)]
        self._limited = {
            player: model
            for player, model in enumerate(dynamics)
            if _has_known_limit(model) and player not in scenario.team.relays and self._places.are_known[player]
        }
        self._evader_speeds = [evader.speed for evader in scenario.evaders]
        self._samples: list[tuple[int, Points]] = []
        self.judged = 0

    def __call__(self, event: Event) -> None:
        """Process an event."""
        if not (self._limited and isinstance(event, Started | Sampled)):
            return
        if isinstance(event, Started):
            self._speeds = [*event.speeds, *self._evader_speeds]
        self._samples = [*self._samples[-2:], (event.t, self._places(event))]
        if len(self._samples) < 3 or not self._samples[0][0] < self._samples[1][0] < self._samples[2][0]:
            return
        (begin, p), (middle, q), (end, r) = self._samples
        steps = seconds(middle - begin), seconds(end - middle)
        for player, dynamics in self._limited.items():
            self._check(player, dynamics, q.item(player) - p.item(player), r.item(player) - q.item(player), steps)

    def _check(
        self,
        player: int,
        dynamics: Limited,
        first: complex,
        second: complex,
        steps: tuple[float, float],
    ) -> None:
        """Compare two successive displacements (m) of a player, and the times (s) that they take."""
        tolerance, duration = 10.0 * (ROUNDING + self._places.error), (steps[0] + steps[1]) / 2.0
        quantity = dynamics.limits
        if quantity == "acceleration":
            if abs(steps[0] - steps[1]) > ROUNDING:  # the formula is one of equal steps
                return
            rate, tolerance = abs(second - first) / duration**2, tolerance / duration**2
        else:
            shortest = min(abs(first), abs(second))
            if shortest <= tolerance or dynamics.limit * duration >= 1.0:  # no direction, or too large an angle
                return
            rate, share = abs(phase(second / first)) / duration, (dynamics.limit * duration) ** 2
            at_full_speed = min(abs(first) / steps[0], abs(second) / steps[1]) >= self._speeds[player] * (1.0 - share)
            rate *= 1.0 if at_full_speed else 0.5
            tolerance = tolerance / shortest / duration + dynamics.limit * share
        self.judged += 1
        if not rate <= dynamics.limit + tolerance:
            raise AssertionError(
                f"no player exceeds its {quantity}: player {player} (the pursuers come first) {rate} > {dynamics.limit}"
            )


def _has_known_limit(dynamics: object) -> TypeGuard[Limited]:
    """Return whether dynamics say what they limit; an inherited limit does not hold for an overridden `__call__`."""
    if not (isinstance(dynamics, Limited) and dynamics.limits in {"acceleration", "turn rate"}):
        return False
    defined = positions(type(dynamics), "limits")
    return not (defined and overrides(type(dynamics), "__call__", defined[0]))


class ApolloniusWatcher:
    """A watcher that checks that a pursuer confines the evader that it chases, if its assumptions hold (`applies`).

    The Apollonius disc of a pursuer and an evader contains the points that the evader reaches first
    (`desim.pursuit.motion.guidance.apollonius_disc`). While a faster pursuer chases with the guidance
    `constant_bearing`, each disc contains the next one: the evader is captured in the first disc whatever it does.
    This holds if the motion of all players is simple, the medium is at rest, the evader moves first in each motion step
    (`motion.order`), and the pursuer sees it exactly. The discs are compared at the samples of the trajectory.

    Args:
        scenario: the scenario of the run.

    Attributes:
        judged: the number of pairs of discs compared.
    """

    def __init__(self, scenario: Scenario):
        self._evader_speeds = [evader.speed for evader in scenario.evaders]
        self._speeds = scenario.team.all_speeds()
        self._active = ActiveTimeWatcher()
        self._discs: dict[int, tuple[int, complex, float]] = {}
        """By pursuer: the evader that it has chased since the last sample, and the disc at that sample."""
        self.judged = 0

    @staticmethod
    def applies(scenario: Scenario) -> bool:
        """Return whether the assumptions hold in a scenario."""
        has_inertia = scenario.team.has_inertia or any(evader.has_inertia for evader in scenario.evaders)
        return (
            inherits(scenario.team.guidance, ConstantBearing)
            and not has_inertia
            and scenario.environment.is_still
            and scenario.space.is_open
            and scenario.motion.order == "evader_first"
            and scenario.sight_is_perfect
        )

    def __call__(self, event: Event) -> None:
        """Process an event."""
        self._active(event)
        if isinstance(event, Decided | BrokeDown | Captured):
            profile = self._active.profile
            self._discs = {j: disc for j, disc in self._discs.items() if profile[j] == disc[0]}
        elif isinstance(event, Started | Sampled):
            self._compare(event)

    def _compare(self, event: Started | Sampled) -> None:
        """Compare the disc of each chase with that at the last sample."""
        for pursuer, evader in enumerate(self._active.profile):
            if not evader or not self._speeds[pursuer] > self._evader_speeds[evader - 1]:
                continue
            places = complex(*event.evaders[evader - 1]), complex(*event.pursuers[pursuer])
            centre, radius = apollonius_disc(*places, self._evader_speeds[evader - 1], self._speeds[pursuer])
            if pursuer in self._discs:
                _, last_centre, last_radius = self._discs[pursuer]
                reach = abs(centre - last_centre) + radius
                if not reach <= last_radius + ROUNDING * (1.0 + abs(centre)):
                    raise AssertionError(
                        f"a chase confines the evader: at {seconds(event.t)} s the Apollonius disc of pursuer {pursuer}"
                        f" leaves the one before by {reach - last_radius} m"
                    )
                self.judged += 1
            self._discs[pursuer] = evader, centre, radius


class PotentialWatcher:
    """A watcher that checks that no decision lowers the potential; use it only under the assumptions below.

    The potential is the global utility Phi of the profile (the actions of all pursuers), with the capture times and the
    time left at the instant of the decision (`desim.pursuit.game.game.welfare`). In a static game, the time left
    is always the whole horizon. With the utility `mean` of the paper, a change of action changes the pursuer's utility
    and Phi by the same amount. So no decision lowers Phi if

    - each decision is a best or better reply: `best_response`, `better_reply`, or log-linear learning as tau -> 0;
    - pursuers decide one at a time, so the schedule is neither `synchronous` nor `rounds`;
    - the beliefs of pursuers are true: an ideal complete network, initial actions that are known or announced
      (`announce.start`), every change announced, no time-out of beliefs, no faults, exact clocks, and all players
      sensed (`announce.payload` is "action" or, in a static game, any payload);
    - capture times depend on distances alone: the motion of pursuers is simple or the game is static, and no flow
      changes distances.

    Players may move, because positions do not change during a decision; the potential may fall between decisions. In a
    static game all decisions are judged, otherwise only the decisions at the instant of a sample of the trajectory.

    Args:
        scenario: the scenario of the run.

    Attributes:
        judged: the number of decisions judged.
    """

    def __init__(self, scenario: Scenario):
        self._evader_speeds = [evader.speed for evader in scenario.evaders]
        self._radius, self._static = scenario.capture.radius, scenario.motion.static
        self._horizon, self._space = nanoseconds(scenario.horizon), scenario.space
        self._active = ActiveTimeWatcher()
        self._pending: list[tuple[Decided, list[int], list[int]]] = []
        """(decision, profile before, profile after) of each decision since positions were last known."""
        self.judged = 0

    def __call__(self, event: Event) -> None:
        """Process an event."""
        profile_before = self._active.profile.copy()
        self._active(event)
        if isinstance(event, Decided):
            self._pending.append((event, profile_before, self._active.profile.copy()))
        elif isinstance(event, Started):
            self._speeds = np.array(event.speeds)
        if isinstance(event, Started | Sampled):
            pursuers = complex_points(event.pursuers)
            self._phi = np.column_stack(
                [
                    RadialTime(self._speeds, speed, self._radius)(self._space.distances(pursuers, complex(*place)))
                    for place, speed in zip(event.evaders, self._evader_speeds, strict=True)
                ]
            )
        if self._static or isinstance(event, Sampled):
            self._judge(event.t)

    def _judge(self, t: int) -> None:
        """Judge the pending decisions made at time t (ns), at which positions are known; discard earlier decisions."""
        left = seconds(self._horizon - (0 if self._static else t))
        for event, before, after in self._pending:
            if event.t == t:
                fall = welfare(self._phi, before, left) - welfare(self._phi, after, left)
                if not fall <= ROUNDING:
                    raise AssertionError(f"no decision lowers the potential: {event} does, by {fall} s")
                self.judged += 1
        self._pending.clear()


def _require_same(name: str, metric: float, stopwatches: float) -> None:
    if not abs(metric - stopwatches) <= ROUNDING * (1.0 + abs(stopwatches)):
        raise AssertionError(f"the {name} of the metric, {metric}, differs from that of the stopwatches, {stopwatches}")
