"""The optional attributes of models of links; a user's model may have any of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import inf
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from desim.config.answers import wrong_answer
from desim.config.arrays import Floats
from desim.config.model import Flag, Limit
from desim.config.traits import Follows, Traits, attributes, is_ours, name_of, positions
from desim.kernel.core.link_context import LinkContext
from desim.kernel.models.coherence import ChannelState, Variation

Exponent = Annotated[float, Field(gt=0, le=20, strict=True)]
"""A path loss exponent."""


class LinkTraits(Traits):
    """The optional methods of a latency or loss model, in addition to `__call__`."""

    start_run: Annotated[Callable[[int], Any] | None, Follows("__call__", "quantile", "is_lost", not_above="draw")] = (
        None
    )
    """`start_run(size)` returns the model of one run of `size` nodes; for models with state."""
    draw: Annotated[
        Callable[[int, np.random.Generator], NDArray[Any]] | None, Follows("__call__", "quantile", not_above="__call__")
    ] = None
    """`draw(count, rng)` returns (count,) draws that do not depend on the link; the network then draws in blocks, and
    does not call the model."""
    quantile: Annotated[Callable[[Floats], Floats] | None, Follows("__call__", not_above="draw")] = None
    """`quantile(u)` returns the u-quantiles of the latency, s; the base latency of `per_pair` needs it."""
    mean_latency: Annotated[
        Callable[[], float | None] | None, Follows("__call__", "quantile", "start_run", not_above="draw")
    ] = None
    """`mean_latency()` returns the mean latency, s, or None if it is not known; `desim check` compares it with the
    horizon."""
    cause: Annotated[str, Field(min_length=1)] = "loss"
    """The cause of the losses that a loss model draws, in traces and counts; see `events.CAUSES`."""
    is_lost: Callable[[LinkContext], Any] | None = None
    """`is_lost(context)` returns (k,) booleans, or one for all: which messages a latency model loses. Their latencies
    have no effect."""
    time_span: Limit | None = None
    """For a latency that is a function of time: the duration from time 0, s, whose mean latency is typical."""
    check_links: Annotated[
        Callable[[int, Iterable[tuple[int, int]]], object] | None, Follows("__call__", "start_run", not_above="draw")
    ] = None
    """`check_links(size, links)` raises ValueError if the model does not apply to some links (sender, receiver) of a
    network of `size` nodes."""

    @classmethod
    def check(cls, value: Any) -> None:
        """Check the traits of a model, see `Traits.check`, and that `start_run` makes a model with its own methods.

        If `start_run` of a user made another model, methods that a class overrides or wraps would have no effect in a
        run. Only `__call__` of a built-in model has the state of the run, see `LinkContext.of_run`.
        """
        super().check(value)
        kind: type = type(value)
        if "start_run" in cls.passed_on(value) and (start_run := getattr(value, "start_run", None)) is not None:
            inner = getattr(start_run, "__self__", None)
            if not is_ours(type(inner)) and start_run(1) is not inner:  # the wrapped model has state
                raise ValueError(
                    f"{name_of(value)} passes on start_run of {name_of(inner)}, which makes another model for each run,"
                    f" and its own __call__ knows only the one without state: {NEEDED}"
                )
        if "start_run" not in cls.outdated(kind):  # no method is overridden below it
            return
        starter = _definer(kind, "start_run")
        method = next(name for name in DRAWING if _is_newer(kind, name, "start_run"))
        function = getattr(kind, method)
        # A function with `super()` has the free variable `__class__`. The built-in `draw` and `quantile` know no links,
        # so they have no state. A method that does not call them needs none, so a run may use the model itself.
        calls_super = "__class__" in getattr(getattr(function, "__code__", None), "co_freevars", ())
        loses_state = not is_ours(starter) or (calls_super and method in {"draw", "quantile"})
        if loses_state and not isinstance(value.start_run(1), kind):
            raise ValueError(
                f"{name_of(value)} has its own {method}, and start_run of {starter.__name__} makes another model for"
                f" each run, which keeps the state of the links: {NEEDED}"
            )


DRAWING = ("__call__", "draw", "quantile", "is_lost")
"""The methods that decide what becomes of a message."""
NEEDED = (
    "it should have its own start_run(size), too, which returns the model of one run of `size` nodes (itself if it has"
    " no state)"
)
"""The end of the error about a model whose `start_run` makes a model of another class."""


def link_trait(model: Any, name: str) -> Any:
    """Return an optional method of a latency or loss model, or None; faster than `LinkTraits.of` if there is none."""
    return getattr(LinkTraits.of(model), name) if attributes(model, [name]) else None


def model_of_run(model: Any, size: int) -> Any:
    """Return the model of one run: a stateful model starts with fresh state, any other is returned unchanged.

    If a user's class overrides only `draw` or `quantile`, the model of the run draws with that method.
    """
    start_run = LinkTraits.of(model).start_run
    if start_run is not None:
        started = start_run(size)
        if not callable(started):
            raise wrong_answer("start_run(size) should return the model of a run (itself if it can)", started, model)
        return started
    kind: type = type(model)
    # An inherited `start_run` that keeps the class keeps the overriding methods, too.
    if "start_run" in LinkTraits.outdated(kind) and isinstance(run_model := model.start_run(size), kind):
        return run_model
    if is_ours(kind):
        return model
    if (draw := LinkTraits.of(model).draw) is not None and _is_newer(kind, "draw", "__call__"):
        return _DrawnOnly(model, draw)
    # A user's class that overrides only `quantile` should change all draws, but the inherited `__call__` may not use
    # it.
    drawing = [name for name in ("__call__", "draw") if positions(kind, name)]
    is_inherited = all(_is_newer(kind, "quantile", name) and is_ours(_definer(kind, name)) for name in drawing)
    if is_inherited and "__call__" in drawing and len(positions(kind, "quantile")) > 1:
        return _DrawnOnly(model, lambda count, rng: model.quantile(rng.random(count)))
    return model


def _is_newer(kind: type, method: str, other: str) -> bool:
    """Return whether the definition of `method` that a class uses is in a more derived class than that of `other`."""
    return min(positions(kind, method), default=inf) < min(positions(kind, other), default=inf)


def _definer(kind: type, method: str) -> type:
    """Return the class, in the method resolution order of `kind`, whose definition of a method `kind` uses."""
    return kind.__mro__[positions(kind, method)[0]]


class _DrawnOnly:
    """A model of a user in one run that is defined by its draws alone.

    Attributes:
        draw: as in `LinkTraits`; so are `quantile`, `is_lost` and `time_span`.
    """

    def __init__(self, model: Any, draw: Callable[[int, np.random.Generator], NDArray[Any]]):
        traits = LinkTraits.of(model)
        self.draw, self.quantile, self.is_lost, self.time_span = draw, traits.quantile, traits.is_lost, traits.time_span

    def __call__(self, context: LinkContext, rng: np.random.Generator) -> NDArray[Any]:
        """Return (k,) draws, one per receiver."""
        return self.draw(len(context.dst), rng)


class MediumTraits(Traits):
    """The attributes of a medium that must be valid, and its optional method, in addition to `__call__`."""

    shared: Flag = False
    """Whether one message at a time is transmitted in the whole network."""
    half_duplex: Flag = False
    """Whether a node that transmits does not receive."""
    queue_limit: Limit = inf
    """Largest number of transmissions that wait at a node; inf: any number."""
    airtime: Annotated[Callable[[int, int], float] | None, Follows("__call__")] = None
    """`airtime(size, node)` returns the airtime, s, of a message of `size` bytes that a node transmits; None: that of
    `__call__`, for all nodes alike."""


class InterferenceTraits(Traits):
    """The attributes of a model of interference, in addition to `__call__`; a model must have the first two."""

    needs_positions: Flag = False
    """Whether it depends on the positions of nodes."""
    has_noise: Annotated[Flag, Follows("__call__")] = True
    """Whether a frame may be lost although no other overlaps it."""
    cause: Annotated[str, Field(min_length=1)] = "collision"
    """The cause of the loss of a frame that others overlap, in traces and counts; see `events.CAUSES`."""
    varies: Annotated[tuple[Variation, ...], Follows("__call__")] = ()
    """Why the power of a frame at a distance is random: "fading", "shadowing" or both."""
    lock: Flag = False
    """Whether a receiver locks on to the first frame that it hears, see `interference.CaptureEffect`."""
    exponent: Exponent = 3.0
    """The path loss exponent n, by which walls stretch distances, as in `ReceptionTraits`."""


class ReceptionTraits(Traits):
    """The optional methods of a reception model, in addition to `__call__`."""

    twins: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType(
        dict.fromkeys(("one", "border", "bound"), ("__call__",))
    )
    bound: Annotated[Callable[[float], float] | None, Follows("__call__")] = None
    """`bound(range)` returns the distance, m, beyond which no message is received; None: there is no such distance."""
    received: Annotated[Callable[[Floats, float, ChannelState], Any] | None, Follows("__call__")] = None
    """`received(distances, range, channel)` returns (k,) booleans: which messages are received at (k,) distances, m, in
    the present states of the channels; `fading = "correlated"` needs it."""
    varies: Annotated[tuple[Variation, ...], Follows("__call__")] = ()
    """Why reception at a distance is random: "fading", "shadowing" or both."""
    one: Annotated[Callable[[float, float], float] | None, Follows("__call__")] = None
    """`one(distance, range)` returns the probability at one distance, m, faster than `__call__`; None: `__call__`."""
    border: Annotated[Callable[[Floats, float], Floats] | None, Follows("__call__")] = None
    """`border(draws, range)` returns the (k,) distances, m, up to which the probability of reception is at least as
    large as each of (k,) numbers in (0, 1); None: `__call__` is asked at each distance."""
    exponent: Exponent = 3.0
    """The path loss exponent n: a wall of A dB has the effect of a distance that is 10^(A / (10 n)) times as long."""


class FaultTraits(Traits):
    """The optional attributes of a fault, or of a plan of faults, in addition to `__call__`."""

    cause: Annotated[str, Field(min_length=1)] | None = None
    """The cause of the losses by a fault, in traces and counts, see `events.CAUSES`; None: its kind or class."""
    named: Callable[[], Mapping[str, Sequence[int]]] | None = None
    """`named()` returns the nodes that it names, by key; an error about a node that does not exist states the key."""
    breaks: frozenset[str] = frozenset()
    """The assumptions of protocols (`assumes`) that it breaks, such as "no_crashes"."""
    messages_only: Flag = False
    """Whether it only loses or delays messages, so that a run with a perfect network leaves it out; true for a `Fault`
    by default."""
    is_scheduled: Annotated[Flag, Follows("begin", "separates")] = False
    """Whether its fields and the seed determine when it begins and what it does, so that the processes of a live run
    agree on it."""
    memory: Flag = True
    """Whether the nodes that it takes down keep their memory."""
