"""A class that derives from a built-in model is simulated with the methods that it overrides, or it is refused.

The property is tested over all kinds of all families, so that a new kind is covered, too. An override is compared with
the same function without a base class.
"""

import re
from collections.abc import Callable
from functools import cached_property
from types import FunctionType
from typing import Any, NamedTuple, get_args
from unittest.mock import Mock
from warnings import catch_warnings

import numpy as np
import pytest

import protocols
from desim import Announcements, Environment, Evader, Links, Motion, Recording, Scenario, Sensing, Team, run
from desim.analysis.hindsight import _latency
from desim.analysis.properties import judge
from desim.config.choice import OneOf, choices_of
from desim.config.errors import KeyedError
from desim.config.model import Value
from desim.config.traits import is_ours, positions
from desim.kernel.clock_sync import CLOCK_SYNCS
from desim.kernel.core import link_context
from desim.kernel.core.clock import Phase
from desim.kernel.core.events import MessageCounts
from desim.kernel.core.link_context import CalledModels
from desim.kernel.measured.models import LatencyTrace, LossTrace, SignalTrace
from desim.kernel.models.access import ACCESSES, Aloha
from desim.kernel.models.fault_plans import FAULTS
from desim.kernel.models.faults import Crash, Partition
from desim.kernel.models.graphs import GRAPHS, Edges, Link
from desim.kernel.models.interference import INTERFERENCES
from desim.kernel.models.latency import BASES, JITTERS, Lognormal, mean_latency
from desim.kernel.models.latency_by_link import LATENCIES, LatencyMatrix, PerPair
from desim.kernel.models.loss import LOSSES, GilbertElliott
from desim.kernel.models.medium import MEDIA, Bitrate, LoRa
from desim.kernel.models.netem import Netem
from desim.kernel.models.reception import RECEPTION_MODELS
from desim.kernel.models.transport import TRANSPORTS
from desim.pursuit.byzantine.falsehoods import FALSE_POSITIONS, FALSE_TIMES
from desim.pursuit.byzantine.lies import PURSUER_FAULTS, Liar, RandomLies, Silent
from desim.pursuit.core.traits import ProtocolTraits
from desim.pursuit.evaders.evasion import STRATEGIES, Listener
from desim.pursuit.evaders.recorded import RecordedMotion, RelayNode
from desim.pursuit.game.utility import UTILITIES
from desim.pursuit.motion.dynamics import DYNAMICS, Course, Piece
from desim.pursuit.motion.flow import FLOWS, NoFlow, SteadyFlow
from desim.pursuit.sensing.noise import NOISES
from desim.pursuit.sensing.tracking import ESTIMATORS
from desim.pursuit.team.announcements import DISSEMINATIONS
from desim.pursuit.team.trust import TRUSTS
from desim.scenario.checks import warnings
from desim.scenario.properties import KINDS as PROPERTIES
from desim.scenario.scenario import PROTOCOLS
from desim.scenario.sweep_table import Sweep
from desim.view.formats.export import EXPORTERS
from desim.view.pictures.link_traces import link_traces
from protocols import BestResponse
from protocols.rule import SCHEDULES
from protocols.temperature import TEMPERATURES
from tests.models import NEEDED

TABLE = "t,value\n0,0\n1,0\n"
PARAMETERS: dict[str, dict[str, Any]] = {
    "Empirical": {"values": (0.1, 0.2)},
    "LatencyMatrix": {"values": [[0.1] * 6] * 6},
    "LatencyTrace": {"table": TABLE},
    "LossTrace": {"table": TABLE},
    "SignalTrace": {"table": TABLE},
    "MessageFault": {"messages": (1,)},
    "Netem": {"correlation": 0.5},
    "Bitrate": {"bitrate": 1e5},
    "VoronoiVertex": {"arena": (0.0, 20.0)},
    "RecordedMotion": {"waypoints": ((0.0, 9.0, 8.0), (5.0, 11.0, 8.0))},
    "SteadyFlow": {"velocity": (0.1, 0.0)},
    "HarmonicFlow": {"amplitude": (0.1, 0.0), "period": 1.0},
    "RecordedFlow": {"velocities": ((0.0, 0.1, 0.0), (1.0, 0.2, 0.0))},
    "GyreFlow": {"speed": 0.1, "size": 5.0},
    "Crash": {"node": 0, "start": 0.1},
    "Partition": {"groups": ((0,),), "start": 0.1},
    "Jamming": {"centre": (5.0, 5.0), "radius": 1.0, "start": 0.1},
    "ConstantPosition": {"value": (1.0, 1.0)},
}
"""The parameters that a kind needs, and those that make it run."""


def talk(me):
    """Chase, and send to one pursuer and to all, ten times per second."""
    while True:
        me.assign(1)
        me.send((me.id + 1) % me.team_size, 1)
        me.send(None, 2)
        me.announce()
        yield me.sleep(0.1)


def scenario(**parts):
    usual = {
        "team": Team(count=4, speeds=3.0),
        "evader": Evader(position=(9.0, 8.0)),
        "horizon": 0.6,
        "protocol": talk,
        "announce": Announcements(heartbeat=0.2),
        "record": Recording(messages=True),
    }
    return Scenario(**usual | parts)


def linked(**links):
    return scenario(network=Links(**links))


def edged(name):
    """Return a function that creates a scenario with a model on one edge of the graph."""

    def made(model):
        graph = Edges(edges=tuple({"src": a, "dst": b} for a in range(4) for b in range(a)))

        def with_attribute(size):
            found = graph(size)
            found.edges[0, 1][name] = model
            return found

        return linked(graph=with_attribute)

    return made


def stays(me, revise):
    """Revise every 0.05 s."""
    while True:
        yield me.sleep(0.05)
        revise()
        me.announce()


def repeats(me):
    """Forward each announcement that arrives as a message once, to pursuer 0."""
    while True:
        yield me.arrival("announcements", Phase.RELAY)
        for _ in me.mail("announcements"):
            me.send((me.id + 1) % me.team_size, 3)


def crashes(size, horizon, rng):
    yield Crash(node=1, start=0.1, end=0.4)


def chases(me):
    """Chase for as long as it has run an even number of tenths."""
    while True:
        me.assign(int(me.now * 10) % 2)
        me.announce()
        yield me.sleep(0.1)


def straight(position, course, command):
    """Move at half of the speed that is commanded."""
    return Piece(position, Course(command / 2.0, course.heading))


def near(distances, range):  # noqa: A002
    """Return a reception that depends on whether the distance is less than 3 m."""
    return np.where(distances < 3.0, 1.0, 0.25)


def ring(size):
    import networkx as nx

    return nx.cycle_graph(size)


class Noisy:
    """An interference that only receiver 1 survives, also alone."""

    needs_positions = True
    has_noise = True

    def __call__(self, overlap):
        return overlap.receivers == 1


def field(model, name):
    """Return the choice of models of a field."""
    (found,) = choices_of(model.model_fields[name])
    return found


class Family(NamedTuple):
    """A family of models that are called, and a scenario with a model of it."""

    choice: OneOf
    function: Callable[..., Any]
    with_model: Callable[[Any], Scenario]
    beside: tuple[str, ...] = ()
    """The attributes that a model without a base class needs, too; those of the kind that is overridden."""
    refused: str | None = None
    """What the refusal of a kind says that does not call the method."""


def still(**network):
    """Return a scenario of the kernel alone: nobody moves."""
    return scenario(network=Links(**network), motion=Motion(static=True))


def contending(model):
    return linked(medium=LoRa(access=Aloha(), reception=model))


def from_record(model):
    return {} if isinstance(model, RecordedMotion) else {"position": (9.0, 8.0)}


def learning(**parts):
    return scenario(protocol=protocols.SpatialAdaptivePlay(**parts), evader=Evader(position=(12.0, 8.0), speed=0.5))


FAMILIES = {
    "latency": Family(LATENCIES, lambda context, rng: 0.025, lambda model: linked(latency=model)),
    "latency of each link": Family(
        LATENCIES, lambda context, rng: rng.random(len(context.dst)) / 9, lambda model: linked(latency=model)
    ),
    "latency in order": Family(
        LATENCIES, lambda context, rng: context.now % 0.07, lambda model: linked(latency=model, order="fifo")
    ),
    "latency in a static game": Family(LATENCIES, lambda context, rng: 0.025, lambda model: still(latency=model)),
    "latency of one link": Family(
        LATENCIES, lambda context, rng: 0.025, lambda model: linked(link=(Link(src=0, dst=1, latency=model),))
    ),
    "latency of an edge": Family(LATENCIES, lambda context, rng: 0.025, edged("latency")),
    "jitter": Family(
        JITTERS, lambda context, rng: 0.025, lambda model: linked(latency=PerPair(base=0.01, jitter=model))
    ),
    "loss": Family(LOSSES, lambda context, rng: context.dst == 2, lambda model: linked(loss=model)),
    "loss in a static game": Family(LOSSES, lambda context, rng: context.dst == 2, lambda model: still(loss=model)),
    "loss of one link": Family(
        LOSSES, lambda context, rng: True, lambda model: linked(link=(Link(src=0, dst=1, loss=model),))
    ),
    "loss of an edge": Family(LOSSES, lambda context, rng: True, edged("loss")),
    "duplicate": Family(LOSSES, lambda context, rng: context.dst == 2, lambda model: linked(duplicate=model)),
    "reception": Family(RECEPTION_MODELS, near, lambda model: linked(range=2.0, reception=model)),
    "reception in a static game": Family(RECEPTION_MODELS, near, lambda model: still(range=2.0, reception=model)),
    "reception at delivery": Family(
        RECEPTION_MODELS, near, lambda model: linked(range=2.0, reception=model, latency=0.1, range_check="both")
    ),
    "medium": Family(
        MEDIA, lambda size: 0.02, lambda model: linked(medium=model), ("shared", "half_duplex", "queue_limit")
    ),
    "interference": Family(INTERFERENCES, Noisy(), contending),
    "graph": Family(GRAPHS, ring, lambda model: linked(graph=model)),
    "fault": Family(FAULTS, crashes, lambda model: scenario(fault=(model,)), refused="never calls"),
    "guidance": Family(
        field(Team, "guidance"),
        lambda gaps, aims, evader_velocity, speeds: 0.5j * speeds,
        lambda model: scenario(team=Team(count=4, speeds=3.0, guidance=model)),
    ),
    "guidance of many": Family(
        field(Team, "guidance"),
        lambda gaps, aims, evader_velocity, speeds: 0.5j * speeds,
        lambda model: scenario(team=Team(count=20, speeds=3.0, guidance=model), horizon=0.1),
    ),
    "strategy": Family(
        STRATEGIES, lambda state, rng: 0.5j, lambda model: scenario(evader=Evader(strategy=model, **from_record(model)))
    ),
    "strategy of a listener": Family(
        field(Listener, "normally"),
        lambda state, rng: 0.5j,
        lambda model: scenario(evader=Evader(position=(9.0, 8.0), strategy=Listener(normally=model))),
    ),
    "strategy at a handover": Family(
        field(Listener, "during_handover"),
        lambda state, rng: 0.5j,
        lambda model: scenario(
            evader=Evader(position=(9.0, 8.0), strategy=Listener(during_handover=model)),
            network=Links(latency=0.2),
            protocol=chases,
        ),
    ),
    "dynamics of pursuers": Family(
        DYNAMICS,
        straight,
        lambda model: scenario(team=Team(count=4, speeds=3.0, dynamics=model)),
        ("is_simple", "headings", "steered", "capture_times"),
        refused="is_simple",
    ),
    "dynamics of an evader": Family(
        DYNAMICS,
        straight,
        lambda model: scenario(evader=Evader(position=(9.0, 8.0), dynamics=model)),
        ("is_simple", "headings", "steered", "capture_times"),
        refused="is_simple",
    ),
    "flow": Family(FLOWS, lambda places, t: 0.1j * places, lambda model: scenario(environment=Environment(flow=model))),
    "flow on pursuers": Family(
        FLOWS,
        lambda places, t: 0.1j * places,
        lambda model: scenario(protocol="sap", environment=Environment(flow=model, on="pursuers")),
    ),
    "utility": Family(
        UTILITIES, lambda own, others, reward: 1.0 - len(others), lambda model: learning(utility=model), ("scope",)
    ),
    "utility of fictitious play": Family(
        UTILITIES,
        lambda own, others, reward: 1.0 - len(others),
        lambda model: scenario(protocol=protocols.JointStrategyFictitiousPlay(utility=model)),
        ("scope",),
    ),
    "schedule": Family(SCHEDULES, stays, lambda model: learning(schedule=model), ("mean_slot",)),
    "temperature": Family(TEMPERATURES, lambda eta: 0.0, lambda model: learning(tau=model)),
    "cooling": Family(
        field(protocols.AdaptiveTau, "cooling"),
        lambda eta: 0.0,
        lambda model: learning(tau=protocols.AdaptiveTau(cooling=model)),
    ),
    "protocol": Family(PROTOCOLS, chases, lambda model: scenario(protocol=model), tuple(ProtocolTraits.names())),
    "dissemination": Family(
        DISSEMINATIONS,
        repeats,
        lambda model: scenario(announce=Announcements(heartbeat=0.2, dissemination=model)),
        ("broadcast", "hops", "retransmits"),
    ),
    "false capture time": Family(
        FALSE_TIMES,
        lambda truth, least, rng: 0.125,
        lambda model: scenario(
            fault=(Liar(node=1, start=0.0, phi=model),), announce=Announcements(heartbeat=0.2, payload="time")
        ),
    ),
    "false position": Family(
        FALSE_POSITIONS,
        lambda truth, rng: 3.0 + 4.0j,
        lambda model: scenario(
            fault=(Liar(node=1, start=0.0, position=model),), announce=Announcements(heartbeat=0.2, payload="state")
        ),
    ),
    "noise": Family(
        NOISES,
        lambda offset, first, second: offset + 1.0,
        lambda model: scenario(sensing=Sensing(noise=model, estimate="hold")),
        ("covariance",),
        refused="never calls",
    ),
    "relay": Family(
        field(RelayNode, "motion"),
        lambda state, rng: 0.5j,
        lambda model: scenario(team=Team(count=4, speeds=3.0, relay=(RelayNode(pursuer=1, motion=model),))),
        refused="velocity",
    ),
}
CASES = [
    (name, kind.__name__)
    for name, family in FAMILIES.items()
    for kind in dict.fromkeys(family.choice.choices().values())
]


def kind_of(name, kind):
    return next(model for model in FAMILIES[name].choice.choices().values() if model.__name__ == kind)


def derived(kind, /, **body):
    """Return a model of a class that derives from a kind."""
    parameters = PARAMETERS.get(kind.__name__, {})
    return type(kind)("Theirs", (kind,), {"__module__": "theirs"} | body)(**parameters)


def plain(kind, function, names):
    """Return a function as a model without a base class, with some attributes of a kind."""
    if not names:
        return function
    base = kind(**PARAMETERS.get(kind.__name__, {}))
    body = {name: getattr(base, name) for name in names if hasattr(base, name)}
    made = type("Plain", (), {"__call__": lambda _, *given: function(*given)})()
    vars(made).update(body)
    return made


def is_refused(kind):
    """Return whether a kind does not call its models, takes commands at once, or moves relays."""
    return not positions(kind, "__call__") or kind.__name__ in {"Simple", "RecordedMotion"}


def events(experiment):
    """Return the events of a run as text, in which nan equals nan."""
    return list(map(repr, run(experiment, seed=1).trace))


@pytest.mark.parametrize("wrap", [staticmethod, lambda function: classmethod(lambda _, *given: function(*given))])
@pytest.mark.parametrize("name", ["latency", "loss", "reception", "strategy", "guidance"])
def test_an_overridden_call_may_be_static_or_of_the_class(name, wrap):
    family = FAMILIES[name]
    kind = next(kind for kind in family.choice.choices().values() if not is_refused(kind))
    theirs = family.with_model(derived(kind, __call__=wrap(family.function)))
    assert events(theirs) == events(family.with_model(plain(kind, family.function, family.beside)))


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_an_overridden_call_is_that_of_the_run(name, kind):
    family, model = FAMILIES[name], kind_of(name, kind)
    body = {"__call__": lambda _, *given: family.function(*given)}
    if family.refused is not None and is_refused(model):
        with pytest.raises(KeyedError, match=family.refused):
            family.with_model(derived(model, **body))
        return
    theirs = family.with_model(derived(model, **body))
    assert events(theirs) == events(family.with_model(plain(model, family.function, family.beside)))


class Passing:
    """A wrapper that passes on what it lacks from a model, as people write them."""

    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_the_call_of_a_wrapper_is_that_of_the_run(name, kind):
    """Or it is refused; the fast ways of the model that it wraps do not count."""
    family, model = FAMILIES[name], kind_of(name, kind)
    body = {"__call__": lambda _, *given: family.function(*given)}
    inner = model(**PARAMETERS.get(kind, {}))
    try:
        theirs = family.with_model(type("Theirs", (Passing,), body)(inner))
    except (KeyedError, ValueError) as error:
        assert re.search(r"own start_run|passes on|should have covariance|velocity\(", str(error))  # noqa: PT017
        return
    assert events(theirs) == events(family.with_model(plain(model, family.function, family.beside)))


def test_each_family_that_is_called_is_covered():
    """`BASES` of per_pair are asked for quantiles; exporters are no part of a run; a plan of lies is compared below."""
    PROTOCOLS.choices(), DISSEMINATIONS.choices()
    found, models = [], [Value]
    for model in models:
        models += model.__subclasses__()
        if is_ours(model):
            found += [choice for info in model.model_fields.values() for choice in choices_of(info)]
    called = [each for each in found if any(positions(kind, "__call__") for kind in each.choices().values())]
    known = [family.choice for family in FAMILIES.values()]
    inner = field(protocols.Synchronous, "schedule")  # of which only `mean_slot` is called
    assert all(any(each is other for other in (*known, BASES, EXPORTERS, PURSUER_FAULTS, inner)) for each in called)


TABLES = {
    "": lambda kind: kind(horizon=2.0),
    "team": lambda kind: scenario(team=kind(count=3)),
    "team.speeds": lambda kind: scenario(team=Team(count=3, speeds=kind(default=3.0, last=2.0))),
    "team.relay.0": lambda kind: scenario(
        team=Team(count=4, relay=(kind(pursuer=1, motion=RecordedMotion(waypoints=((0.0, 1.0, 1.0),))),))
    ),
    "evader.0": lambda kind: scenario(evader=(kind(position=(9.0, 8.0)),)),
    "sensing": lambda kind: scenario(sensing=kind()),
    "capture": lambda kind: scenario(capture=kind()),
    "motion": lambda kind: scenario(motion=kind()),
    "environment": lambda kind: scenario(environment=kind()),
    "wall.0": lambda kind: scenario(wall=(kind(line=((5.0, 5.0), (6.0, 5.0))),)),
    "announce": lambda kind: scenario(announce=kind()),
    "network": lambda kind: scenario(network=kind()),
    "network.coherence": lambda kind: linked(coherence=kind()),
    "network.processing": lambda kind: linked(processing=kind()),
    "network.link.0": lambda kind: linked(link=(kind(src=0, dst=1, loss=1.0),)),
    "clocks": lambda kind: scenario(clocks=kind()),
    "record": lambda kind: scenario(record=kind()),
    "sweep": lambda kind: scenario(sweep=kind()),
    "sweep.design": lambda kind: scenario(sweep=Sweep(grid={"horizon": "0.1:0.2"}, design=kind(size=2))),
}
"""A scenario with a table of some class, by the key of the table."""


def tables(model, place=()):
    """Yield the key and the class of each table in a scenario."""
    yield ".".join(place), model
    for name, field in model.model_fields.items():
        annotation = field.annotation
        inner = [annotation, *get_args(annotation), *(each for part in get_args(annotation) for each in get_args(part))]
        values = dict.fromkeys(each for each in inner if isinstance(each, type) and issubclass(each, Value))
        for kind in (value for value in values if "kind" not in value.model_fields):
            yield from tables(kind, (*place, name, *(["0"] if tuple[kind, ...] in inner else [])))


@pytest.mark.parametrize(("key", "table"), [*tables(Scenario)])
def test_a_table_whose_class_overrides_something_is_refused(key, table):
    """It would be a table of the usual class again where its keys are written and read, as in a sweep."""
    (name, field), *_ = table.model_fields.items()
    default = {} if field.is_required() else {name: field.get_default(call_default_factory=True)}
    bodies = {name: {"__annotations__": {name: Any}} | default}
    bodies |= {method: {method: vars(base)[method]} for method, base in [*methods_of(table).items()][:1]}
    for name, body in bodies.items():
        derived_table = type(table)("Theirs", (table,), {"__module__": "theirs"} | body)
        with pytest.raises(KeyedError, match=rf"{key}: Theirs has its own {name}"):
            TABLES[key](derived_table)
    TABLES[key](type(table)("Theirs", (table,), {"__module__": "theirs", "a_helper": lambda _: 3}))


def test_an_overridden_plan_of_lies_is_that_of_the_run():
    """As the same liar without a plan."""
    liar = Liar(node=1, start=0.0, phi=0.125)
    said = {"payload": "time", "heartbeat": 0.2}
    planned = derived(RandomLies, __call__=lambda *_: iter([liar]))
    one, other = (scenario(fault=(fault,), announce=Announcements(**said)) for fault in (planned, liar))
    assert events(one) == events(other)


LATENCY_KINDS = list(LATENCIES.choices().values())
LOSS_KINDS = list(LOSSES.choices().values())


@pytest.mark.slow_but_one
@pytest.mark.parametrize("where", ["all", "link"])
@pytest.mark.parametrize("kind", [*LATENCY_KINDS, *LOSS_KINDS], ids=lambda kind: kind.__name__)
def test_an_overridden_draw_alone_is_that_of_the_run(kind, where):
    """All links draw the same, so that blocks of draws make no difference."""
    name = "latency" if kind in LATENCY_KINDS else "loss"
    value = 0.025 if name == "latency" else True
    theirs = derived(kind, draw=lambda _, count, rng: np.full(count, value))
    one, other = (
        linked(**{name: model} if where == "all" else {"link": (Link(src=0, dst=1, **{name: model}),)})
        for model in (theirs, lambda context, rng: np.full(len(context.dst), value))
    )
    assert events(one) == events(other)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("kind", BASES.choices().values(), ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("where", ["all", "base"])
def test_an_overridden_quantile_alone_is_that_of_the_run(kind, where):
    theirs = derived(kind, quantile=lambda _, u: np.full_like(u, 0.025))
    if where == "base":
        one, other = linked(latency=PerPair(base=theirs)), linked(latency=PerPair(base=0.025))
    else:
        one, other = linked(latency=theirs), linked(latency=lambda context, rng: np.full(len(context.dst), 0.025))
    assert events(one) == events(other)


@pytest.mark.parametrize("method", ["__call__", "draw"])
@pytest.mark.parametrize("kind", BASES.choices().values(), ids=lambda kind: kind.__name__)
def test_an_inherited_quantile_is_not_the_base_of_pairs(kind, method):
    theirs = derived(kind, **{method: lambda _, *given: np.full(4, 0.025)})
    with pytest.raises(KeyedError, match=r"quantile\(u\) of its own"):
        PerPair(base=theirs)


@pytest.mark.parametrize("method", ["__call__", "draw", "quantile", "start_run"])
@pytest.mark.parametrize("kind", LATENCY_KINDS, ids=lambda kind: kind.__name__)
def test_an_inherited_mean_is_not_that_of_what_is_overridden(kind, method):
    """Only if the method is overridden: a kind without this method is not changed by a new one of `start_run`."""
    assert mean_latency(derived(kind)) == mean_latency(kind(**PARAMETERS.get(kind.__name__, {})))
    if positions(kind, method):
        assert mean_latency(derived(kind, **{method: lambda _, *given: None})) is None


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Lognormal, GilbertElliott])
def test_the_class_below_and_a_class_mixed_in_override_as_well(kind):
    def late(_, context, rng):
        return 0.025 if kind is Lognormal else True

    name = "latency" if kind is Lognormal else "loss"
    below = type("Below", (type(derived(kind, draw=lambda *_: 1 / 0)),), {"__call__": late, "__module__": "theirs"})
    above = type("Above", (type(derived(kind, __call__=late)),), {"__module__": "theirs"})
    mixed = type("Mixed", (type("Mixin", (), {"__call__": late}), kind), {"__module__": "theirs"})
    function = lambda context, rng: late(None, context, rng)  # noqa: E731
    first, *others = (events(linked(**{name: model})) for model in (function, below(), above(), mixed()))
    assert others == [first] * 3


STATES: dict[str, dict[str, Any]] = {
    "Netem": {"jitter": 0.05, "correlation": 0.9},
    "PerPair": {"jitter": Netem(jitter=0.05, correlation=0.9)},
    "LatencyMatrix": {"values": [[0.1] * 4] * 4, "jitter": Netem(jitter=0.05, correlation=0.9)},
    "LatencyTrace": {"table": "t,value\n0,0.01\n0.3,0.05\n", "start": "random"},
    "GilbertElliott": {"share": 0.4, "burst": 4.0},
    "ByDistance": {"distance": 20.0},
    "Correlated": {"p": 0.5, "correlation": 0.9},
    "FourState": {"p13": 0.2},
    "LossTrace": {"table": "t,value\n0,0.2\n0.3,0.5\n", "start": "random"},
    "SignalTrace": {"table": "t,value\n0,-80\n0.3,-90\n", "start": "random"},
}
"""Parameters of the kinds with a model of a run, so that each message depends on the last one or on its time."""
CALLERS = {
    "super": lambda kind, parameters: _calling_super(kind)(**parameters),
    "object": lambda kind, parameters: _Calling(kind(**parameters)),
    "wrapper": lambda kind, parameters: type("Theirs", (Passing, _Calling), {})(kind(**parameters)),
    "function": lambda kind, parameters: _function_of(kind(**parameters)),
}


def _function_of(model):
    return lambda context, rng: model(context, rng)


def _calling_super(kind):
    class Theirs(kind):
        def __call__(self, context, rng):
            return super().__call__(context, rng)

    return Theirs


class _Calling:
    def __init__(self, inner):
        self.inner = inner

    def __call__(self, context, rng):
        return self.inner(context, rng)


@pytest.mark.slow_but_one
@pytest.mark.parametrize("way", CALLERS)
@pytest.mark.parametrize("kind", [kind for kind in (*LATENCY_KINDS, *LOSS_KINDS) if positions(kind, "start_run")])
def test_a_model_that_another_model_calls_has_the_state_of_the_run(kind, way):
    """For all links, for one link, and for duplicates of messages; two runs are the same."""
    parameters = STATES[kind.__name__]
    theirs, model = CALLERS[way](kind, parameters), kind(**parameters)
    name = "latency" if kind in LATENCY_KINDS else "loss"
    assert events(linked(**{name: theirs})) == events(linked(**{name: model})) == events(linked(**{name: theirs}))
    one, other = (linked(link=(Link(src=0, dst=1, **{name: each}),)) for each in (theirs, model))
    assert events(one) == events(other)
    if name == "loss":
        assert events(linked(loss=theirs, duplicate=theirs)) == events(linked(loss=model, duplicate=model))


class _CallingTrace(_Calling):
    def is_lost(self, context):
        return self.inner.is_lost(context)


@pytest.mark.parametrize("calling", [lambda trace: _calling_super(LatencyTrace)(table=trace.table), _CallingTrace])
def test_a_latency_that_calls_a_trace_loses_the_messages_of_rows_without_a_value(calling):
    trace = LatencyTrace(table="t,value\n0,0.01\n0.2,\n0.4,0.05\n")
    lost = events(linked(latency=trace))
    assert any("Lost" in each for each in lost)
    assert events(linked(latency=calling(trace))) == lost


def test_only_so_many_called_models_are_kept(monkeypatch):
    """A run keeps the models that it calls often, also if it creates others meanwhile."""
    monkeypatch.setattr(link_context, "MOST", 5)
    called, rng = CalledModels(4), np.random.default_rng(0)
    often = GilbertElliott()
    first = called.of_run(often, GilbertElliott.start_run, rng)
    for _ in range(20):
        called.of_run(GilbertElliott(), GilbertElliott.start_run, rng)
        assert called.of_run(often, GilbertElliott.start_run, rng) is first
    assert len(called._started) == 5


UNCALLED = [
    (kind, method)
    for kind in dict.fromkeys(RECEPTION_MODELS.choices().values())
    for method in ("bound", "received")
    if positions(kind, method)
]


@pytest.mark.parametrize(("kind", "method"), UNCALLED)
def test_a_reception_that_overrides_what_a_run_need_not_call_is_refused(kind, method):
    own = {method: lambda _, *given: 0.0}
    with pytest.raises(KeyedError, match=f"Theirs has its own {method}, .*: it should have its own __call__, too"):
        linked(range=2.0, reception=derived(kind, **own))
    linked(range=2.0, reception=derived(kind, **own, __call__=lambda _, *given: near(*given)))


@pytest.mark.parametrize("method", ["draw", "quantile"])
def test_an_inherited_method_that_knows_no_links_needs_a_start_run(method):
    """The draws and quantiles of a kind are without the state of the links."""

    class Draws(Netem):
        def draw(self, count, rng):
            return 2.0 * super().draw(count, rng)

    class Quantiles(Netem):
        def quantile(self, u):
            return 2.0 * super().quantile(u)

    with pytest.raises(KeyedError, match="should have its own start_run"):
        Links(latency={"draw": Draws, "quantile": Quantiles}[method](jitter=0.05, correlation=0.9))


def test_a_model_that_is_copied_for_each_run_keeps_its_overrides():
    class Counting:
        def start_run(self, size):
            made = type(self)()
            made.count = 0
            return made

        def __call__(self, context, rng):
            self.count += 1
            return 0.01 * self.count

    class Faster(Counting):
        def __call__(self, context, rng):
            return super().__call__(context, rng) / 2.0

    assert events(linked(latency=Faster())) == events(linked(latency=Faster()))
    assert events(linked(latency=Faster())) != events(linked(latency=Counting()))


def test_a_subclass_with_other_defaults_is_as_fast_and_as_exact_as_its_kind():
    """Its displacement is known in closed form, and it carries all players alike."""

    class Current(SteadyFlow):
        velocity: tuple[float, float] = (0.5, 0.25)

    one, other = (
        scenario(environment=Environment(flow=flow)) for flow in (Current(), SteadyFlow(velocity=(0.5, 0.25)))
    )
    assert one.environment.keeps_distances
    assert events(one) == events(other)


@pytest.mark.parametrize("kind", [SteadyFlow, NoFlow], ids=lambda kind: kind.__name__)
def test_an_overridden_velocity_of_a_uniform_flow_is_that_of_the_run(kind):
    """The integral of the inherited velocity is not used: the flow is integrated as that of a function is."""
    theirs = derived(kind, velocity_at=lambda _, t: 0.5 + 0.25j)
    one, other = (
        scenario(environment=Environment(flow=flow))
        for flow in (theirs, lambda places, t: np.full(len(places), 0.5 + 0.25j))
    )
    assert events(one) == events(other)


@pytest.mark.parametrize("name", ["latency", "loss", "reception", "strategy", "guidance", "flow", "protocol"])
def test_a_built_in_class_whose_method_is_replaced_is_refused(name, monkeypatch):
    """As tests do with a mock; the run of a kind that it knows need not call the method."""
    family = FAMILIES[name]
    for replaced in (lambda self, *given: 0.0, Mock(return_value=0.0)):
        for kind in dict.fromkeys(family.choice.choices().values()):
            model = kind(**PARAMETERS.get(kind.__name__, {}))
            with monkeypatch.context() as patched:
                patched.setattr(kind, "__call__", replaced)
                with pytest.raises(KeyedError, match=f"__call__ of {kind.__name__} has been replaced in the class"):
                    family.with_model(model)


@pytest.mark.parametrize("kind", [*LATENCY_KINDS, type("Theirs", (), {"__call__": lambda *_: 0.1})])
def test_a_call_that_is_an_attribute_of_the_object_is_refused(kind):
    model = kind(**PARAMETERS.get(kind.__name__, {}))
    vars(model)["__call__"] = lambda context, rng: 0.1
    with pytest.raises(KeyedError, match="has __call__ as an attribute of the object"):
        linked(latency=model)


def test_checks_do_not_describe_the_kind_that_is_overridden():
    class Instant(Lognormal):
        def __call__(self, context, rng):
            return 0.0

    class Solo(BestResponse):
        def actions(self, me):
            while True:
                yield 1

    assert "network.latency" in dict(warnings(Scenario(network=Links(latency=Lognormal(mean=20.0)))))
    assert "network.latency" not in dict(warnings(Scenario(network=Links(latency=Instant(mean=20.0)))))
    assert ProtocolTraits.of(BestResponse()).assumes == BestResponse.assumes
    assert "one_at_a_time" not in ProtocolTraits.of(Solo()).assumes


TRACES = [LatencyTrace, LossTrace, SignalTrace]
NAMED = "t,src,dst,value\n0,a,b,0\n1,a,b,0\n0,b,a,0\n1,b,a,0\n"


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRACES)
def test_a_table_is_described_unless_what_replays_it_is_overridden(kind):
    """By the figure of the measurements, the warning about its end, and the check of its links."""

    def with_model(**body):
        model = type(kind)("Theirs", (kind,), {"__module__": "theirs"} | body)(table=NAMED, after="error")
        return {"latency" if kind is LatencyTrace else "loss": model}

    end = f"network.{'latency' if kind is LatencyTrace else 'loss'}.after"
    pair = Team(count=2)
    followed = Scenario(team=pair, network=Links(**with_model(scaled=lambda _, values: values + 0.5)))
    assert end in dict(warnings(followed))
    assert len(link_traces(followed).axes) == 1
    with pytest.raises(KeyedError, match="has no row for the link"):
        linked(**with_model(scaled=lambda _, values: values))
    for method in ("__call__", "start_run", "draw"):
        theirs = Scenario(team=pair, network=Links(**with_model(**{method: lambda *_: None})))
        assert end not in dict(warnings(theirs))
        with pytest.raises(ValueError, match="no link follows measurements"):
            link_traces(theirs)
        linked(**with_model(**{method: lambda *_: None}))


@pytest.mark.parametrize("method", ["__call__", "start_run", "draw"])
def test_a_matrix_need_not_have_the_links_of_a_latency_that_overrides_it(method):
    small = {"values": [[0.0, 0.1], [0.1, 0.0]]}
    with pytest.raises(KeyedError, match="should have a row for each of 4 nodes"):
        linked(latency=LatencyMatrix(**small))
    linked(latency=type("Theirs", (LatencyMatrix,), {"__module__": "theirs", method: lambda *_: None})(**small))


@pytest.mark.slow_but_one
@pytest.mark.parametrize("kind", LOSS_KINDS, ids=lambda kind: kind.__name__)
def test_a_loss_that_overrides_a_kind_loses_all_that_is_sent(kind):
    counts = run(linked(loss=derived(kind, __call__=lambda _, context, rng: True)), seed=1).trace.of(MessageCounts)[0]
    assert counts.sent == counts.lost > 0


def test_an_airtime_of_a_node_is_that_of_the_run():
    class Slow(Bitrate):
        def airtime(self, size, node):
            return 0.3 if node == 0 else super().airtime(size, node)

    counts = [run(linked(medium=kind(bitrate=1e6)), seed=1).trace for kind in (Slow, Bitrate)]
    slow, plain = (trace.of(MessageCounts)[0] for trace in counts)
    assert slow.delivered < plain.delivered


def test_an_overridden_separation_is_that_of_the_run():
    """As a partition that only cuts node 0 off, told by `separates`."""

    class OneNode(Partition):
        def separates(self, src, dst):
            return 0 in (src, dst)

    lost = [
        run(scenario(fault=(kind(groups=((k,),), start=0.1),)), seed=1).trace.of(MessageCounts)[0].lost
        for kind, k in ((OneNode, 1), (Partition, 0), (Partition, 1))
    ]
    assert lost[0] == lost[1] > 0


def test_utilities_that_fictitious_play_never_calls_are_refused():
    class Theirs(protocols.FictitiousPlay):
        def utilities(self, me):
            return {0: 0.0}

    with pytest.raises(ValueError, match="never calls `utilities`"):
        scenario(protocol=Theirs())


# Each method alone.

OTHERS = {
    "access": (ACCESSES, lambda model: linked(medium=Bitrate(bitrate=1e5, access=model))),
    "sync": (CLOCK_SYNCS, lambda model: scenario(clocks={"sync": model})),
    "transport": (TRANSPORTS, lambda model: linked(loss=0.3, transport=model)),
    "estimator": (
        ESTIMATORS,
        lambda model: scenario(protocol="local_min", sensing=Sensing(noise="position", estimator=model)),
    ),
    "trust": (TRUSTS, lambda model: scenario(protocol="local_min", announce=Announcements(heartbeat=0.1, trust=model))),
    "pursuer fault": (
        PURSUER_FAULTS,
        lambda model: scenario(fault=(model,), announce=Announcements(heartbeat=0.1, payload="state")),
    ),
    "property": (PROPERTIES, lambda model: scenario(properties=(model,), horizon=0.1)),
}
"""Families whose models are not called themselves."""
IN_A_RUN = {name: (family.choice, family.with_model) for name, family in FAMILIES.items()} | OTHERS
ELSEWHERE = {
    "LinkTrace.span": "warns of a table that ends",
    "Edges.notes": "warns",
    "Radio.interval": "estimates; see below",
    "Radio.occupancy": "warns of the load of a channel",
    "_Access.interval": "as Radio.interval",
    "_Access.occupancy": "as Radio.occupancy",
    "_Access.channel": "explains how frames overlap",
    "LatencyMatrix.name": "errors",
    "LoRa.is_tuned": "contending nodes; see below",
    "LoRa.hears": "contending nodes; see below",
    "Faded.gains": "only with fading",
    "Faded.varies": "refusals",
    **dict.fromkeys(
        (f"{kind}.received" for kind in ("Disk", "LogDistance", "Nakagami", "Rice")), "only with correlated fading"
    ),
    "Acceleration.capture_times": "protocols ask for capture times; the function `talk` does not",
    "TurnRate.capture_times": "as above",
    "RecordedMotion.places": "refusals",
    "Policy.write": "called by users",
    "Reliable.gives_up": "a warning about disseminations",
    "Always.bound": "the text of a search, which asks for a limit",
    "Rounds.for_all": "explain",
    "Synchronous.for_all": "explain",
    **dict.fromkeys((f"{kind}.message_size" for kind in ("_WithToken", "LocalMutex")), "checks of a channel"),
    **dict.fromkeys(
        (f"{kind}.without_serial_decisions" for kind in ("SharedSeed", "_WithToken", "LocalMutex")), "explain"
    ),
    **dict.fromkeys(
        ("Crash.sketch", "Partition.sketch", "Jamming.sketch", "MessageFault.sketch", "Window.sketch"), "drawings"
    ),
    **dict.fromkeys(("Crash.label", "Window.label", "MessageFault.label", "NewsFault.label"), "drawings"),
    **dict.fromkeys((f"{kind}.drops" for kind in ("ByzantineFault", "Selective")), "forwarding"),
    **dict.fromkeys((f"{kind}.accuses" for kind in ("ByzantineFault", "Slander")), "trust of accusations"),
}
"""Where a method is called that is not called in the runs above, by the class that defines it."""


def methods_of(kind):
    """Return the class that defines each public method and property of a kind, by name."""
    return {
        name: base
        for base in reversed(kind.__mro__)
        if is_ours(base) and base is not Value
        for name, value in vars(base).items()
        if name[0] != "_"
        and name not in kind.model_fields
        and not hasattr(Value, name)
        and isinstance(value, FunctionType | property | cached_property)
    }


def judgements():
    """Yield each kind with a method, one kind for each class that defines the method, and a scenario with the kind."""
    seen = set()
    for choice, with_model in IN_A_RUN.values():
        for kind in dict.fromkeys(choice.choices().values()):
            for name, base in methods_of(kind).items():
                if (base, name) not in seen:
                    seen.add((base, name))
                    yield pytest.param(kind, base, name, with_model, id=f"{kind.__name__}.{name}")


@pytest.mark.slow_but_one
@pytest.mark.parametrize(("kind", "base", "name", "with_model"), [*judgements()])
def test_each_method_counts_that_is_overridden_alone(kind, base, name, with_model):
    """Or it is refused; one that counts elsewhere than in a run or in warnings is listed with the place."""
    called = []

    def theirs(self, *given, **named):
        called.append(name)
        return getattr(super(type(self), self), name)(*given, **named)

    def attribute(self):
        called.append(name)
        return getattr(super(type(self), self), name)

    body = theirs if isinstance(vars(base)[name], FunctionType) else property(attribute)
    needed = NEEDED.get(kind.__name__, {}) | PARAMETERS.get(kind.__name__, {})
    needed |= {"start": 0.05} if "start" in kind.model_fields else {}
    needed |= {"values": [[0.1] * 4] * 4} if kind is LatencyMatrix else {}
    try:
        experiment = with_model(type(kind)("Theirs", (kind,), {"__module__": "theirs", name: body})(**needed))
    except (KeyedError, ValueError) as error:
        assert re.search(f"Theirs.*{name}", str(error))  # noqa: PT017
        return
    result = run(experiment.model_copy(update={"horizon": 0.2}), seed=1)
    with catch_warnings():
        list(warnings(experiment))
    for prop in experiment.properties:
        judge(prop, result)
    assert called or f"{base.__name__}.{name}" in ELSEWHERE


def test_a_fast_way_that_is_overridden_alone_is_refused():
    """With the method to override; with that one, both count or neither is needed."""
    for family, name, method in (
        ("guidance", "one", "__call__"),
        ("reception", "one", "__call__"),
        ("reception", "border", "__call__"),
        ("flow", "displacement", "velocity_at"),
        ("flow", "trend", "velocity_at"),
        ("utility", "expected", "__call__"),
    ):
        for kind in FAMILIES[family].choice.choices().values():
            if name not in methods_of(kind):
                continue
            alone = {name: lambda self, *given: None}
            with pytest.raises(KeyedError, match=f"Theirs has its own {name}.* it should have its own {method}, too"):
                FAMILIES[family].with_model(derived(kind, **alone))
            inherited = getattr(kind, method)
            FAMILIES[family].with_model(derived(kind, **alone, **{method: lambda *given, f=inherited: f(*given)}))


def test_a_silent_pursuer_that_says_something_is_refused():
    for name in ("says", "says_to", "drops", "accuses"):
        body = {name: lambda self, *given: None}
        with pytest.raises(KeyedError, match=rf"inherits is_silent = True.* its own {name} would have no effect"):
            scenario(fault=(type("Theirs", (Silent,), {"__module__": "theirs", **body})(node=1, start=0.0),))
        type("Theirs", (Silent,), {"__module__": "theirs", "is_silent": False, **body})(node=1, start=0.0)


@pytest.mark.parametrize("access", [{}, {"access": Aloha()}], ids=["ideal", "aloha"])
def test_the_airtime_of_a_node_is_that_of_all_estimates(access):
    """The longest one: of an announcement, of the interval between two, and of the latency in a metric."""

    class Slow(Bitrate):
        def airtime(self, size, node):
            return 0.3 if node == 2 else super().airtime(size, node)

    class Steady(Bitrate):
        def __call__(self, size):
            return 0.3

    theirs, other = (linked(medium=kind(bitrate=1e6, **access)) for kind in (Slow, Steady))
    assert theirs.announcement_airtime == other.announcement_airtime == 0.3
    assert theirs.network.medium.interval(24, 4) == 0.3
    heard = []

    def asks(me):
        heard.append((me.airtime(1), me.interval(1)))
        yield me.sleep(1.0)

    for experiment in (theirs, other):
        run(experiment.model_copy(update={"protocol": asks}), seed=1)
    assert set(heard) == {(0.3, 0.3)}
    assert _latency(run(theirs, seed=1)) == _latency(run(other, seed=1))


def test_a_radio_that_hears_nothing_receives_nothing():
    class Deaf(LoRa):
        def hears(self, src, nodes):
            return np.zeros(len(nodes), dtype=bool)

    counts = run(scenario(network=Links(medium=Deaf(access=Aloha())), horizon=3.0), seed=1).trace.of(MessageCounts)[0]
    assert counts.delivered == 0 < counts.lost


@pytest.mark.slow_but_one
@pytest.mark.parametrize("method", [{"__bool__": lambda _: False}, {"__len__": lambda _: 0}], ids=["bool", "len"])
@pytest.mark.parametrize("name", [name for name, family in FAMILIES.items() if family.refused is None])
def test_a_model_that_is_false_or_empty_is_that_of_the_run(name, method):
    family = FAMILIES[name]
    kind = next(kind for kind in family.choice.choices().values() if not is_refused(kind))
    base = kind(**PARAMETERS.get(kind.__name__, {}))
    body = {"__call__": lambda _, *given: family.function(*given)}
    names = (*family.beside, "needs_positions", "has_noise")
    body |= {name: getattr(base, name) for name in names if hasattr(base, name)}
    model, theirs = (type("Theirs", (), body | more)() for more in ({}, method))
    assert events(family.with_model(theirs)) == events(family.with_model(model))
