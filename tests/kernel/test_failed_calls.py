"""A call of a stepped network that raises has changed nothing, or the network refuses to go on.

It changes nothing if an argument is wrong. If a part of the user raises, such as a watcher or a model of the links, the
message may be counted and not sent, whatever the type of the exception.
"""

import copy
import pickle
from math import inf
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from desim import (
    Bitrate,
    Coded,
    Fault,
    Links,
    LogDistance,
    Lognormal,
    Reliable,
    SteppedNetwork,
    SteppedNetworks,
)
from desim.config.model import Value
from desim.kernel.core.events import Trace

SIZE = 4
PLACES = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0], [4.0, 4.0]])
DRAWN = Links(latency=Lognormal(mean=0.05, cv=0.5), loss=0.2, range=6.0, reception=LogDistance(), fading="message")
"""Links whose draws depend on the number of each message."""
BODY = (1.0, 2.0)
FUSE = SimpleNamespace(error=None)
"""The exception that the parts of the user raise; None: none."""


def burn(answer=None):
    if FUSE.error is not None:
        raise FUSE.error
    return answer


class Late(Value):
    def __call__(self, context, rng):
        return burn(0.05)


class Lossy(Value):
    def __call__(self, context, rng):
        return burn(np.zeros(len(context.dst), dtype=bool))


class Heard(Value):
    def __call__(self, distances, range):  # noqa: A002
        return burn(np.ones(len(distances)))


class Slow(Value):
    shared: ClassVar[bool] = False
    half_duplex: ClassVar[bool] = False
    queue_limit: ClassVar[float] = inf

    def __call__(self, size):
        return burn(0.01)


class Cut(Fault):
    def begin(self, site):
        return site.block(lambda *_: burn(False))


class Catch(Fault):
    def begin(self, site):
        return site.intercept(lambda *_: burn({}))


class Begin(Fault):
    def begin(self, site):
        burn()
        return burn


class Body:
    """A body with parts of the user; a receiver that gets a copy of it reads these."""

    def __init__(self, part):
        self.part = part

    def __deepcopy__(self, memo):
        return Body(burn(self.part) if self.part == "copied" else self.part)

    def plain(self):
        return burn(self.part) if self.part == "measured" else self.part


def with_links(**arguments):
    return lambda: {"links": Links(**arguments)}


PARTS = {
    "watcher": lambda: {"trace": Trace([lambda _: burn()]), "can_leave": True},
    "latency": with_links(latency=Late()),
    "latency, to one": with_links(latency=Late(), order="fifo"),
    "processing": with_links(processing={"sender": Late()}),
    "loss": with_links(loss=Lossy()),
    "duplicate": with_links(duplicate=Lossy()),
    "reception": with_links(range=9.0, reception=Heard()),
    "reception on arrival": with_links(range=9.0, reception=Heard(), range_check="delivery"),
    "reception of a transport": with_links(range=9.0, reception=Heard(), transport=Reliable()),
    "medium": with_links(medium=Slow()),
    "cut": lambda: {"faults": [Cut(start=0.05)]},
    "interception": lambda: {"faults": [Catch(start=0.05)]},
    "beginning": lambda: {"faults": [Begin(start=0.25)]},
    "loss of frames": with_links(loss=Lossy(), transport=Reliable()),
    "loss of pieces": with_links(loss=Lossy(), transport=Coded(pieces=3, needed=2)),
}
"""The arguments of a network with one part that may raise."""
CALLS = {
    "send": lambda network: network.send(0, None, BODY),
    "send to one": lambda network: network.send(0, 1, BODY),
    "publish": lambda network: network.publish(0, BODY),
    "step": lambda network: network.step(0.1),
    "send and step": lambda network: (network.send(1, 2, BODY), network.step(0.1)),
    "latest": lambda network: network.latest(1),
    "ages": lambda network: network.ages(),
    "counts": lambda network: network.counts(),
    "transport_counts": lambda network: network.transport_counts(),
    "lost": lambda network: network.lost(),
    "neighbours": lambda network: network.neighbours(1),
    "leave": lambda network: network.leave(2),
    "join": lambda network: network.join(3),
    "reset": lambda network: network.reset(5),
}
RAISED = [ValueError, ArithmeticError, KeyboardInterrupt]


def begun(make):
    """Return a network in which messages are in flight and node 3 has left, if nodes may."""
    FUSE.error = None
    arguments = {"trace": Trace()} | make()
    network = SteppedNetwork(SIZE, seed=3, positions=PLACES, **arguments)
    if arguments.get("can_leave"):
        network.leave(3)
    for node in range(2):
        network.send(node, None, (node,))
        network.publish(node, (node,))
    network.step(0.2)
    network.publish(0, "without latency, it arrives now")
    return network


def rest(network):
    """Return all that is observed from now on, and the trace."""
    observed = []
    for k in range(5):
        for node in range(SIZE):
            network.send(node, None, (node, k))
            network.publish(node, (node, k))
        observed += network.step(0.1), network.lost(), network.ages().tolist(), network.counts()
    return observed, network.transport_counts(), network.trace and [*network.trace]


def refuses(network):
    """Return whether each call says that the network has failed, until it is reset."""
    for call in [call for name, call in CALLS.items() if name != "reset"]:
        with pytest.raises(RuntimeError, match="a call has failed"):
            call(network)
    with pytest.raises(TypeError, match="before its first message and step"):
        copy.copy(network)
    return True


def outcome(make, call, error):
    """Let a part raise in a call; return "failed", "unchanged" or "not raised", or fail if it is none of these."""
    network, twin = begun(make), begun(make)
    FUSE.error = error("of a part")
    try:
        CALLS[call](network)
        return "not raised"
    except error:
        pass
    finally:
        FUSE.error = None
    if not network._problem:
        assert repr(rest(network)) == repr(rest(twin))
        return "unchanged"
    assert refuses(network)
    network.reset(8)
    fresh = SteppedNetwork(SIZE, seed=8, positions=PLACES, **{**make(), "trace": None})
    assert repr(rest(network)) == repr(rest(fresh))
    return "failed"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "error"), [*((part, ValueError) for part in PARTS), *(("loss", error) for error in RAISED[1:])]
)
def test_a_part_that_raises_leaves_a_network_that_refuses_or_is_unchanged(part, error):
    """Without a trace the outcomes of some arrivals are decided when they are read."""
    outcomes = set()
    for call in CALLS:
        makes = [PARTS[part]] if part == "watcher" else [PARTS[part], lambda: {**PARTS[part](), "trace": None}]
        possible = call not in {"leave", "join"} or part == "watcher"
        outcomes |= {outcome(make, call, error) for make in makes if possible}
    assert "failed" in outcomes


@pytest.mark.parametrize("error", RAISED[:2])
@pytest.mark.parametrize("call", ["send", "publish"])
@pytest.mark.parametrize("part", ["copied", "measured"])
def test_a_body_that_cannot_be_copied_or_measured_changes_nothing(part, call, error):
    def make():
        return {"links": DRAWN.model_copy(update={"medium": Bitrate(bitrate=1e6)})}

    network, twin = begun(make), begun(make)
    FUSE.error = error("of a body")
    with pytest.raises((ValueError, error), match="of a body"):
        getattr(network, call)(0, *[None][: call == "send"], Body(part))
    FUSE.error = None
    assert repr(rest(network)) == repr(rest(twin))


@pytest.mark.parametrize("call", ["send", "publish"])
def test_a_copy_for_a_receiver_that_raises_is_a_failure(call):
    """The body can be copied once, when it is sent, and not again, for the receiver."""
    network, body = begun(dict), Once()
    FUSE.copies = 1
    if call == "publish":
        network.publish(0, body, size=9)
    with pytest.raises(ArithmeticError):
        network.send(0, 1, body, size=9) if call == "send" else network.latest(1)
    assert refuses(network)


@pytest.mark.parametrize("call", ["send", "publish"])
def test_a_loss_that_raises_in_a_call_is_a_failure(call):
    network = begun(PARTS["loss"])
    FUSE.error = ValueError("of the loss")
    with pytest.raises(ValueError, match="of the loss"):
        CALLS[call](network)
    FUSE.error = None
    assert refuses(network)


class Once:
    """It is copied as often as `FUSE.copies` says."""

    def __deepcopy__(self, memo):
        FUSE.copies -= 1
        if FUSE.copies < 0:
            raise ArithmeticError("of a copy")
        return Once()


WRONG = {
    "sender": (lambda network: network.send(9, None, BODY), "there is no node 9"),
    "sender without number": (lambda network: network.send("0", None, BODY), "a node should be an integer"),
    "receiver": (lambda network: network.send(0, 9, BODY), "there is no node 9"),
    "itself": (lambda network: network.send(0, 0, BODY), "messages to itself"),
    "port": (lambda network: network.send(0, 1, BODY, 3), "a port should be a text"),
    "transport": (lambda network: network.send(0, 1, BODY, transport="reliable"), "transport should be"),
    "another transport": (
        lambda network: network.send(0, 1, BODY, "mail", transport=Reliable(window=7)),
        "a port has one transport",
    ),
    "negative size": (lambda network: network.send(0, None, BODY, size=-1), "at least 0 bytes"),
    "broken size": (lambda network: network.send(0, 1, BODY, size=1.5), "the size of a message"),
    "huge size": (lambda network: network.send(0, 1, BODY, "mail", size=2**60, transport=Reliable()), "at most"),
    "no size": (lambda network: network.send(0, None, len), "has no size"),
    "no copy": (lambda network: network.send(0, 1, (k for k in BODY)), "cannot be sent"),
    "no size of a frame": (lambda network: network.send(0, 1, len, "mail", transport=Reliable()), "has no size"),
    "sender that is away": (lambda network: network.send(3, None, BODY, size=-1), "at least 0 bytes"),
    "body of a sender that is away": (lambda network: network.publish(3, len), "has no size"),
    "source": (lambda network: network.publish(-1, BODY), "there is no node -1"),
    "size of a state": (lambda network: network.publish(0, BODY, size=-1), "at least 0 bytes"),
    "state without size": (lambda network: network.publish(0, len), "has no size"),
    "state without copy": (lambda network: network.publish(0, (k for k in BODY)), "cannot be sent"),
    "no time": (lambda network: network.step(0.0), "dt should be"),
    "no positions": (lambda network: network.step(0.1, [[0.0, 0.0]]), "positions should be"),
    "reader": (lambda network: network.latest(9), "there is no node 9"),
    "node": (lambda network: network.neighbours("a"), "a node should be an integer"),
    "node that leaves": (lambda network: network.leave(9), "there is no node 9"),
    "node that is away": (lambda network: network.leave(3), "is away already"),
    "node that is there": (lambda network: network.join(1), "is not away"),
    "seed": (lambda network: network.reset(-1), "seed"),
    "positions of a reset": (lambda network: network.reset(1, positions=[[0.0, 0.0]]), "positions should be"),
    "trace": (lambda network: network.reset(1, trace=network.trace), "trace "),
}
"""Calls with a wrong argument, and what is said about it."""


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_argument_counts_nothing_and_changes_no_draw(wrong):
    def make():
        return {"links": DRAWN.model_copy(update={"medium": Bitrate(bitrate=1e6)}), "can_leave": True}

    networks = begun(make), begun(make)
    for network in networks:
        network.send(0, 1, BODY, "mail", transport=Reliable())
    call, why = WRONG[wrong]
    with pytest.raises(ValueError, match=why):
        call(networks[0])
    changed, unchanged = map(rest, networks)
    assert repr(changed) == repr(unchanged)


@pytest.mark.parametrize("wrong", [name for name in WRONG if name not in {"node that is away", "another transport"}])
def test_a_network_that_refused_a_wrong_argument_is_still_unused(wrong):
    network = SteppedNetwork(SIZE, Links(medium=Bitrate(bitrate=1e6)), can_leave=True, trace=Trace())
    call, why = WRONG[wrong]
    with pytest.raises(ValueError, match=why):
        call(network)
    assert pickle.loads(pickle.dumps(network)).step(0.1) == []


def test_the_comparison_detects_a_message_that_was_counted():
    """The control of the comparisons above."""
    networks = begun(lambda: {"links": DRAWN}), begun(lambda: {"links": DRAWN})
    networks[0].send(3, None, BODY)
    changed, unchanged = map(rest, networks)
    assert repr(changed) != repr(unchanged)


def test_networks_that_are_stepped_together_do_not_go_on_without_one_that_has_failed():
    FUSE.error = None
    networks = SteppedNetworks(3, 2, Links(loss=Lossy()))
    FUSE.error = ValueError("of the loss")
    with pytest.raises(ValueError, match="of the loss"):
        networks[1].send(0, 1, BODY)
    FUSE.error = None
    bodies = np.zeros((3, 2))
    for call in (lambda: networks.step(0.1), lambda: networks.send(bodies), lambda: networks.publish(bodies)):
        with pytest.raises(RuntimeError, match="a call has failed"):
            call()
    assert [networks[0].now, networks[0].counts().sent, networks[2].now] == [0.0, 0, 0.0]
    networks.reset(1)
    assert networks.step(0.1) == [[], [], []]


def test_a_network_without_positions_for_its_range_can_still_be_given_some():
    network = SteppedNetwork(2, Links(range=5.0))
    for call in (lambda: network.send(0, 1, BODY), lambda: network.publish(0, BODY)):
        with pytest.raises(ValueError, match="depends on the positions"):
            call()
    network.step(0.1, np.zeros((2, 2)))
    network.send(0, 1, BODY)
    assert [message.body for message in network.step(0.1)] == [BODY]
    assert network.counts().sent == 1


# Traces.


def test_a_trace_is_of_one_network():
    trace = Trace()
    network = SteppedNetwork(2, trace=trace)
    for wrong in (lambda: SteppedNetwork(2, trace=trace), lambda: network.reset(1, trace=trace)):
        with pytest.raises(ValueError, match=r"trace belongs to another network.*give a new Trace\(\)"):
            wrong()
    network.send(0, 1, BODY)
    network.step(0.1)
    assert network.counts().sent == 1
    with pytest.raises(ValueError, match="seed"):
        SteppedNetwork(2, trace=(free := Trace()), seed=-1)
    SteppedNetwork(2, trace=free)  # the one that was refused has not taken it


class Seen(list):
    """A watcher that keeps what it sees."""

    def __call__(self, event):
        self.append(event)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_a_copy_of_a_network_has_a_trace_of_its_own(copied):
    seen = Seen()
    network = SteppedNetwork(2, trace=Trace([seen]))
    other = copied(network)
    assert other.trace is not network.trace
    other.send(0, 1, BODY)
    other.step(0.1)
    assert (len(network.trace), len(other.trace), len(seen)) == (0, 1, 0)
    network.send(0, 1, BODY)
    network.step(0.1)
    assert (len(network.trace), len(other.trace), len(seen)) == (1, 1, 1)


def test_final_counts_that_a_watcher_refuses_are_appended_once():
    FUSE.error = None
    network = SteppedNetwork(2, trace=(trace := Trace([lambda _: burn()])))
    FUSE.error = ValueError("of a watcher")
    with pytest.raises(ValueError, match="of a watcher"):
        network.close()
    network.close()
    assert len(trace) == 1


@pytest.mark.parametrize("outer", ["send", "send to one", "publish", "step", "leave"])
@pytest.mark.parametrize("inner", [*CALLS, "close"])
def test_a_watcher_cannot_call_the_network_that_it_watches(outer, inner):
    """A step inside of a send would let time pass before the message leaves."""
    told: list[str] = []

    def intrude(event):
        if armed and not told:
            told.append("")
            try:
                (network.close if inner == "close" else lambda: CALLS[inner](network))()
            except RuntimeError as error:
                told[0] = str(error)

    def network_of(watchers):
        crash = {"kind": "crash", "node": 3, "start": 0.05, "end": 0.5}
        trace = Trace(watchers)
        made = SteppedNetwork(SIZE, DRAWN, faults=[crash], positions=PLACES, trace=trace, can_leave=True)
        made.send(1, None, BODY)
        return made

    armed = False
    network, other = network_of([intrude]), network_of([])
    armed = True
    for each in (network, other):
        CALLS[outer](each)
    assert "a call is under way" in told[0]
    assert network.step(1.0) == other.step(1.0)
    assert network.counts() == other.counts()
