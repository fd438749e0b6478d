"""The optional attributes of protocols, schedules, utilities, disseminations and evaders' strategies.

A protocol, schedule, ... may be a frozen model, an object of a user's class or a function. Attributes that it lacks
have the defaults given here.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import inf
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.model import Flag, Positive, Time, Value
from desim.config.python_numbers import as_python
from desim.config.traits import Follows, Parameter, Traits

AssumptionName = Literal[
    "undivided",
    "connected",
    "everyone_heard",
    "component_heard",
    "messages_get_through",
    "announcements_repeated",
    "one_at_a_time",
    "rounds",
    "no_crashes",
    "equal_clocks",
    "equal_speeds",
    "host_in_range",
    "times_known",
    "positions_known",
]
"""The names of the assumptions, which are functions in `desim.scenario.assumptions`."""


class Assuming(Traits):
    """The optional attributes (traits) that protocols, schedules, utilities and disseminations have in common."""

    assumes: Annotated[tuple[AssumptionName, ...], Follows("__call__", "actions")] = ()
    """Names of its assumptions about the scenario (`desim.scenario.assumptions`); a violated one gives a warning."""


class ProtocolTraits(Assuming):
    """The optional attributes of a protocol, in addition to `__call__`."""

    announces: Literal[True, False, "unseen"] = True
    """Whether pursuers announce their actions; "unseen": only if positions are not sensed."""
    omniscient: Flag = False
    """Whether pursuers see the evaders at any distance, whatever `sensing.radius` is."""
    embodied: Flag = True
    """Whether the process of a pursuer runs on its robot. If so, the process stops while the robot is broken down, and
    uses the clock of the robot, which may have an error."""
    reckons: Flag = False
    """Whether the protocol extrapolates announced positions, whatever `announce.payload` is."""
    claim_size: Callable[[int, int], int] | None = None
    """`claim_size(pursuers, evaders)` returns the size of an announcement, bytes, given the numbers of both; None: the
    size of `announce.payload`."""
    at_once: Flag = False
    """Whether pursuers decide at the same instants, for a protocol without a schedule."""
    assumes_plane: Annotated[Flag, Follows("__call__", "actions")] = False
    """Whether the protocol takes straight lines for shortest paths; it is refused if walls block motion."""
    check_game: Annotated[Callable[[int, int], None] | None, Follows("__call__", "actions")] = None
    """`check_game(pursuers, evaders)` raises KeyedError if the protocol does not fit a game with these numbers of
    players; None: it fits any."""
    host: Annotated[Annotated[int, Field(ge=0)] | None, Parameter(int)] = None
    """The pursuer that hosts the server of the protocol; a scenario without this pursuer is invalid."""
    slot: Annotated[Positive | None, Parameter(int, float)] = None
    """Time between two decisions, s."""
    period: Annotated[Positive | None, Parameter(int, float)] = None
    """Time between two decisions, s, if there is no `slot`."""
    schedule: Annotated[Callable[..., Any] | None, Parameter(Callable)] = None
    """The schedule, which determines when pursuers revise; see `ScheduleTraits`."""
    utility: Annotated[Callable[..., Any] | None, Parameter(Callable)] = None
    """The utility of an action; see `UtilityTraits`."""


def size_by(function: Callable[[int, int], Any], *numbers: int) -> int:
    """Return the size that a protocol or a schedule gives for its messages (`claim_size`, `message_size`), bytes.

    Raises:
        AnswerError: if it is not an integer of at least 0.
    """
    answer = function(*numbers)
    size = as_python(answer)
    if type(size) is not int or size < 0:
        raise wrong_answer("the size of a message should be a number of bytes, an integer >= 0", answer, function)
    return size


class ScheduleTraits(Assuming):
    """The optional attributes of a schedule, in addition to `__call__` and `mean_slot`."""

    at_once: Flag = False
    """Whether several pursuers may revise at the same instant."""
    spreads_to: Literal["all", "neighbours"] | None = None
    """The pursuers to which the schedule's own messages, such as a token, repeatedly carry actions, so that these
    pursuers need no announcements of the actions; None: its messages carry no actions."""
    message_size: Callable[[int, int], int] | None = None
    """`message_size(pursuers, announcement)` returns the size of its longest message, bytes, given the number of
    pursuers and the size of an announcement; None: it sends no messages."""
    absentee_size: Annotated[int, Field(ge=0, strict=True)] = 0
    """By how many bytes each pursuer that does not answer makes this message longer, at most N - 2 of them."""
    without_serial_decisions: Annotated[Callable[[], dict[str, Any]] | None, Follows("__call__")] = None
    """`without_serial_decisions()` returns the table, as in a scenario file, of a similar schedule without turns: no
    decision waits for those of teammates. It is for `desim explain`. None: the schedule has no turns."""
    for_all: Annotated[Callable[[], Any] | None, Follows("__call__")] = None
    """`for_all()` returns a similar schedule in which all pursuers decide together, for `desim.learning`; None: rounds
    take the place of the schedule there."""
    warnings: Annotated[Callable[[float], Iterator[tuple[str, str]]] | None, Follows("__call__")] = None
    """`warnings(step)` yields (key, reason) for each parameter that is problematic with a motion step of `step` s."""


class UtilityTraits(Assuming):
    """The attributes of a utility, in addition to `__call__`; `scope` is required."""

    scope: Literal["heard", "neighbours", "component"] = "heard"
    """The pursuers whose actions count: those whose announcements are known, those in range, or those connected."""
    twins: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({"expected": ("__call__",)})
    expected: Annotated[
        Callable[[float, Sequence[float], Sequence[float], float], float] | None, Follows("__call__")
    ] = None
    """`expected(own_time, other_times, chances, reward)` returns the mean gain, s, from being active if each of the
    other pursuers is independently active with its probability in `chances`."""


class DisseminationTraits(Assuming):
    """The optional attributes of a dissemination, in addition to `__call__` and `broadcast`."""

    hops: Annotated[float, Field(ge=1, strict=True)] = inf
    """Largest number of hops that an announcement travels."""
    forwarding_jitter: Time | None = None
    """Longest random delay between the arrival of an announcement and its rebroadcast, s; None: no rebroadcast."""
    retransmits: Flag = False
    """Whether an announcement is transmitted again to each of its first receivers until it is acknowledged, or a newer
    one replaces it."""
    transport: Value | None = None
    """The transport that carries announcements as messages; None: they are published, or `network.transport` carries
    them."""

    @property
    def relays(self) -> bool:
        """Whether announcements travel over several hops."""
        return self.hops > 1


class StrategyTraits(Traits):
    """The optional attributes of an evader's strategy, in addition to `__call__`."""

    listens: Flag = False
    """Whether the strategy overhears the pursuers' radio. If no strategy in the run does, `state.handover` is
    always False."""
    assumes_plane: Annotated[Flag, Follows("__call__")] = False
    """Whether the strategy takes straight lines for shortest paths; it is refused if walls block motion."""
    turns_at_once: Annotated[Flag, Follows("__call__")] = True
    """Whether the evader may take an entirely new heading from one instant to the next, unless its dynamics forbid
    it."""
