"""The optional attributes of models of links; a user's model may have any of them."""

from collections.abc import Callable, Iterable
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from desim.config.arrays import Floats
from desim.config.model import Flag
from desim.config.traits import Traits, attributes
from desim.kernel.link_context import LinkContext


class LinkTraits(Traits):
    """The optional methods of a latency or loss model, in addition to `__call__`."""

    start_run: Callable[[int], Any] | None = None
    """`start_run(size)` returns the model of one run of `size` nodes; for models with state."""
    draw: Callable[[int, np.random.Generator], NDArray[Any]] | None = None
    """`draw(count, rng)` returns (count,) draws that do not depend on the link; the network then draws in blocks."""
    quantile: Callable[[Floats], Floats] | None = None
    """`quantile(u)` returns the u-quantiles of the latency, s; the base latency of `per_pair` needs it."""
    is_lost: Callable[[LinkContext], Any] | None = None
    """`is_lost(context)` returns (k,) booleans, or one for all: which messages a latency model loses. Their latencies
    have no effect."""
    time_span: Annotated[float, Field(ge=0)] | None = None
    """For a latency that is a function of time: the time from 0, s, whose mean latency is typical."""
    check_links: Callable[[int, Iterable[tuple[int, int]]], object] | None = None
    """`check_links(size, links)` raises ValueError if the model does not apply to some links (sender, receiver) of a
    network of `size` nodes."""


def link_trait(model: Any, name: str) -> Any:
    """Return an optional method of a latency or loss model; None, sooner than from `LinkTraits.of`, if it lacks it."""
    return getattr(LinkTraits.of(model), name) if attributes(model, [name]) else None


def model_of_run(model: Any, size: int) -> Any:
    """Return the model of one run: a stateful model starts with fresh state, any other is returned unchanged."""
    start_run = LinkTraits.of(model).start_run
    return start_run(size) if start_run is not None else model


class InterferenceTraits(Traits):
    """The optional attribute of a model of interference, in addition to `__call__`."""

    lock: Flag = False
    """Whether a receiver locks on to the first frame that it hears, see `desim.kernel.interference.CaptureEffect`."""


class ReceptionTraits(Traits):
    """The optional method of a reception model, in addition to `__call__`."""

    bound: Callable[[float], float] | None = None
    """`bound(range)` returns the distance, m, beyond which no message is received; None: there is no such distance."""
