"""Each imperfection is removed, and nothing else."""

from math import inf

import networkx as nx
import pytest

from desim import Scenario, load, run
from desim.kernel.events import Tally
from desim.kernel.faults import Crash
from desim.kernel.graphs import Complete, Edges, Link, Ring
from desim.kernel.latency import Constant, Lognormal
from desim.kernel.links import Links, Processing
from desim.kernel.loss import Bernoulli
from desim.kernel.medium import Bitrate
from desim.kernel.reach import QuasiUnitDisk
from desim.pursuit.events import Started
from desim.pursuit.word import Announcements
from desim.scenario import Team
from desim.study.imperfections import (
    IMPERFECTIONS,
    without_faults,
    without_latency,
    without_loss,
    without_range,
    without_staleness,
    without_turns,
)
from desim.study.store import flat
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules import Rounds
from protocols.server import Server
from scenarios.study import SCENARIOS

FILES = sorted(SCENARIOS.glob("*.toml"))
WORST = Scenario(
    team=Team(count=4),
    network=Links(
        preset="acoustic",
        graph=Ring(),
        range=5.0,
        reach=QuasiUnitDisk(),
        latency=Lognormal(mean=0.1, cv=0.5),
        processing=Processing(sender=0.1),
        loss=Bernoulli(p=0.3),
        link=(Link(src=0, dst=1, latency=Constant(value=1.0), loss=Bernoulli(p=0.5)), Link(src=1, dst=2, order="fifo")),
    ),
    announce=Announcements(payload="time", trigger="heartbeat", warm_start=False, forget_after=inf),
    fault=(Crash(node=1, at=0.5),),
)
TOUCHED = {
    "latency": ("network.latency", "network.processing", "network.medium", "network.preset", "network.link"),
    "loss": ("network.loss", "network.preset", "network.link"),
    "range limit": ("network.range", "network.reach", "network.graph", "network.preset"),
    "faults": ("fault",),
    "serial decisions": ("protocol.schedule",),
    "stale knowledge": ("announce.payload", "announce.trigger", "announce.warm_start", "announce.forget_after"),
}
"""What each removal may change."""


def removed(scenario, names=tuple(IMPERFECTIONS)):
    for name in names:
        scenario = IMPERFECTIONS[name](scenario)
    return scenario


@pytest.mark.parametrize("name", IMPERFECTIONS)
def test_an_imperfection_is_removed_and_nothing_else(name):
    before, after = flat(WORST.plain()), flat(removed(WORST, [name]).plain())
    changed = {key for key in before.keys() | after.keys() if before.get(key) != after.get(key)}
    assert changed
    assert not [key for key in changed if not key.startswith(TOUCHED[name])]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_what_is_without_all_of_them_has_none_whatever_the_order(path):
    scenario = load(path)
    ideal = removed(scenario)
    assert ideal == removed(scenario, reversed(IMPERFECTIONS))
    assert all(remove(ideal) == ideal for remove in IMPERFECTIONS.values())
    assert Scenario.model_validate(ideal.plain()).plain() == ideal.plain()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_it_starts_as_it_would_and_no_message_is_late_or_lost(path):
    """Over 0.1 s, so that whatever is on its way when the run ends is on its way for no time."""
    scenario = load(path, ["horizon=0.1"])
    ideal = run(removed(scenario)).trace
    assert ideal.of(Started)[0].pursuers == run(scenario).trace.of(Started)[0].pursuers
    (tally,) = ideal.of(Tally)
    assert not tally.lost


def test_the_default_scenario_has_turns_and_nothing_else():
    kept = [name for name, remove in IMPERFECTIONS.items() if remove(Scenario()) == Scenario()]
    assert kept == [name for name in IMPERFECTIONS if name != "serial decisions"]


def test_links_of_their_own_lose_what_is_removed_and_keep_the_rest():
    slow, fifo = WORST.network.link
    assert without_latency(WORST).network.link == (slow.model_copy(update={"latency": None}), fifo)
    assert without_loss(WORST).network.link == (slow.model_copy(update={"loss": None}), fifo)
    assert without_loss(without_latency(WORST)).network.link == (fifo,)
    assert without_latency(WORST).network.loss == WORST.network.loss


def test_edges_of_a_graph_of_ones_own_keep_what_is_not_removed():
    graph = nx.path_graph(3)
    graph.edges[0, 1]["latency"] = 0.5
    graph.edges[1, 2]["loss"] = 0.25
    scenario = Scenario(team=Team(count=3), network=Links(graph=Edges.of(graph)))

    def edges(scenario):
        return {(a, b): data for a, b, data in scenario.network.graph(3).edges(data=True)}

    late, lossy = {"latency": Constant(value=0.5)}, {"loss": Bernoulli(p=0.25)}
    assert edges(scenario) == {(0, 1): late, (1, 2): lossy}
    assert edges(without_latency(scenario)) == {(0, 1): {}, (1, 2): lossy}
    assert edges(without_loss(scenario)) == {(0, 1): late, (1, 2): {}}
    assert edges(without_range(scenario)) == {(0, 1): late, (1, 2): lossy, (0, 2): {}}
    assert without_range(without_loss(without_latency(scenario))).network.graph == Complete()


def test_a_medium_takes_time_and_so_belongs_to_latency():
    scenario = Scenario(network=Links(medium=Bitrate(bitrate=1000.0)))
    assert without_latency(scenario) == Scenario(network=Links(preset=None)) == without_latency(Scenario())


@pytest.mark.parametrize(
    "protocol", [Centralised(), Server(), SpatialAdaptivePlay(schedule=Rounds(period=0.2)), lambda me: iter(())]
)
def test_who_takes_no_turns_does_not_lose_them(protocol):
    scenario = Scenario(protocol=protocol)
    assert without_turns(scenario) is scenario


@pytest.mark.parametrize(("trigger", "ideal"), [("change", "change"), ("revision", "revision"), ("never", "both")])
def test_who_is_silent_for_long_speaks_at_once(trigger, ideal):
    assert without_staleness(Scenario(announce=Announcements(trigger=trigger))).announce.trigger == ideal


def test_nothing_breaks_any_more():
    assert without_faults(WORST).fault == ()
