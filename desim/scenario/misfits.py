"""Errors about values of several tables of a scenario that cannot be simulated together.

The class of a table refuses a value that is wrong in any scenario, and values of the table that do not fit together.
Errors that models of links find in the links that use them (`check_links`) are collected by
`desim.kernel.models.own_links.link_misfits`, because a network without a scenario raises them, too.
"""

from collections.abc import Iterator
from functools import cache

from pydantic import BaseModel

from desim.config.choice import choices_of
from desim.config.errors import KeyedError
from desim.config.field_docs import annotated
from desim.config.model import Value
from desim.config.model_parts import models_in, models_within
from desim.config.traits import is_ours
from desim.kernel.clock_sync import TwoWay
from desim.kernel.core.units import nanoseconds, seconds
from desim.kernel.graph_files.node_names import shortened
from desim.kernel.models.access import Tdma
from desim.kernel.models.faults import nodes_of
from desim.kernel.models.graphs import names_of
from desim.kernel.models.medium import Radio, airtime_of
from desim.kernel.models.own_links import link_misfits
from desim.kernel.topology.topology import Topology
from desim.pursuit.core.traits import ScheduleTraits, UtilityTraits, size_by
from desim.scenario.conditions import AnyScenario
from desim.scenario.property_misfits import property_misfits
from desim.scenario.wall_misfits import Misfit, wall_misfits


def misfits(scenario: AnyScenario) -> Iterator[Misfit]:
    """Yield the key and the text of each inconsistency between the tables of a scenario."""
    if derived := list(_derived_tables(scenario)):
        yield from derived
        return
    no_pursuer = f"there is no pursuer {{}}: they are 0 .. {scenario.team.count - 1}"
    yield from _graph_misfits(scenario, no_pursuer)
    place: tuple[str, ...] = ("protocol",)  # the key of the step that raises
    try:
        size = scenario.announcement_size
        place = "network", "medium"
        airtime_of(scenario.network.medium, size, scenario.team.count)
    except ValueError as error:
        yield place, str(error)
    else:
        yield from _channel_misfits(scenario)
    yield from _name_misfits(scenario)
    yield from _motion_misfits(scenario)
    yield from wall_misfits(scenario)
    if (needed := scenario.capture.captures_to_end) is not None and needed > (number := len(scenario.evaders)):
        yield (
            ("capture", "captures_to_end"),
            f"there {'is' if number == 1 else 'are'} only {number} to capture (got {needed})",
        )
    yield from _protocol_misfits(scenario, no_pursuer)
    yield from _fault_misfits(scenario, no_pursuer)
    yield from property_misfits(scenario)


def _derived_tables(scenario: AnyScenario) -> Iterator[Misfit]:
    """Yield the key and the text of each table whose class a user has derived, with a key or method of its own.

    A scenario that is written, or changed, is read again from the keys of its tables, which then have the built-in
    classes. A model with a kind may have a derived class, because its kind names the class.
    """
    for place, table in models_within(scenario, fields=_fields_of_tables):
        if not is_ours(type(table)):
            yield from ((place, why) for why in _overridden(type(table)))


@cache
def _fields_of_tables(kind: type[BaseModel]) -> tuple[str, ...]:
    """Return the names of the fields that hold tables, and no models with a kind."""
    fields = kind.model_fields.items()
    return tuple(name for name, field in fields if [*models_in(field.annotation)] and not choices_of(field))


def _overridden(kind: type[BaseModel]) -> Iterator[str]:
    """Yield why a class that a user derives from a table is refused, if it redefines a key or method of the table."""
    base = next(ancestor for ancestor in kind.__mro__ if is_ours(ancestor))
    derived = kind.__mro__[: kind.__mro__.index(base)]
    theirs = dict.fromkeys(name for child in derived for name in (*annotated(child), *vars(child)) if name[0] != "_")
    if changed := [name for name in theirs if _is_of_table(base, name)]:
        yield (
            f"{kind.__name__} has its own {', '.join(changed)}, which a sweep, `with_` and a file would lose: they keep"
            f" the keys of a table only; give a {base.__name__} with values, or a model of your own in a key that has a"
            " kind"
        )


def _is_of_table(base: type[BaseModel], name: str) -> bool:
    """Return whether a table has a key, a method or a property of a name that a plain `Value` lacks."""
    return name in base.model_fields or (hasattr(base, name) and not hasattr(Value, name))


def _graph_misfits(scenario: AnyScenario, no_pursuer: str) -> Iterator[Misfit]:
    """Yield the key and the text of each error of the graph, and of each link that is not in it or does not fit it."""
    count = scenario.team.count
    graph = None
    try:
        made = scenario.network.make_graph(count)
        Topology(made)  # refuses some graphs, whose links are then not checked
        graph = made
    except (ValueError, TypeError, AttributeError) as error:
        yield ("network", "graph"), str(error)
    for k, link in enumerate(scenario.network.link):
        unknown = {end: node for end, node in (("src", link.src), ("dst", link.dst)) if node >= count}
        yield from ((("network", "link", k, end), no_pursuer.format(node)) for end, node in unknown.items())
        for src, dst in link.ways() if not unknown else ():
            if graph is not None and not graph.has_edge(src, dst):
                yield ("network", "link", k), f"there is no link from {src} to {dst} in the graph"
    if graph is not None:
        yield from ((("network", *place), why) for place, why in link_misfits(scenario.network, graph))


def _name_misfits(scenario: AnyScenario) -> Iterator[Misfit]:
    """Yield the key and the text of an error if the positions are of nodes with other names than those of the graph."""
    names = names_of(scenario.network.graph)
    if names and scenario.team.names and names != scenario.team.names:
        yield (
            ("team", "positions"),
            f"the nodes of the file are {shortened(scenario.team.names)}, and those of the graph {shortened(names)}:"
            " nodes should be in the order of the graph, or absent if both have the same names",
        )


def _protocol_misfits(scenario: AnyScenario, no_pursuer: str) -> Iterator[Misfit]:
    """Yield the key and the text of each part of the protocol that does not suit the team or its role."""
    count = scenario.team.count
    protocol = scenario.protocol_traits
    if protocol.host is not None and protocol.host >= count:
        yield ("protocol", "host"), no_pursuer.format(protocol.host)
    if protocol.check_game is not None:
        try:
            protocol.check_game(count, len(scenario.evaders))
        except KeyedError as error:
            yield from ((("protocol", *problem.key.split(".")), problem.reason) for problem in error.problems)
    if isinstance(scenario.clocks.sync, TwoWay) and scenario.clocks.sync.reference >= count:
        yield ("clocks", "sync", "reference"), no_pursuer.format(scenario.clocks.sync.reference)
    for part, traits, value in (
        ("schedule", ScheduleTraits, protocol.schedule),
        ("utility", UtilityTraits, protocol.utility),
    ):
        try:
            traits.check(value)
        except ValueError as error:
            yield ("protocol", part), str(error)


def _fault_misfits(scenario: AnyScenario, no_pursuer: str) -> Iterator[Misfit]:
    """Yield the key and the text of each pursuer that a fault names and that does not exist."""
    count = scenario.team.count
    for k, fault in enumerate(scenario.fault):
        for key, nodes in nodes_of(fault).items():
            yield from ((("fault", k, key), no_pursuer.format(node)) for node in nodes if node >= count)


def _motion_misfits(scenario: AnyScenario) -> Iterator[Misfit]:
    """Yield the key and the text of each model that does not allow for the flow or for inertia."""
    environment = scenario.environment
    if scenario.team.has_inertia and not environment.keeps_distances:
        yield (
            ("team", "dynamics"),
            "capture times of pursuers with inertia are known only in a flow that carries all players alike:"
            ' `environment.flow` none, uniform, harmonic or recorded, and `environment.on` "all"',
        )
    if scenario.sensing.estimate == "worst_case" and not environment.is_still:
        yield ("sensing", "estimate"), "the bound of worst_case does not allow for a flow (`environment.flow`)"
    if scenario.sensing.estimate == "worst_case" and scenario.team.has_inertia:
        yield ("sensing", "estimate"), "the bound of worst_case does not allow for inertia (`team.dynamics`)"


def _channel_misfits(scenario: AnyScenario) -> Iterator[Misfit]:
    """Yield the key and the text of each inconsistency between the team and the channel for which it contends."""
    medium, count = scenario.network.medium, scenario.team.count
    if not isinstance(medium, Radio):
        return
    access = medium.access
    place: tuple[str, ...] = "network", "medium"
    try:
        medium.check(count)
        if not isinstance(access, Tdma):
            return
        place = *place, "access"
        access.owners(count)
    except KeyedError as error:
        yield from (((*place, *problem.key.split(".")), problem.reason) for problem in error.problems)
        return
    sizes = {"an announcement": scenario.announcement_size} if scenario.announces else {}
    if (message_size := scenario.schedule_traits.message_size) is not None:
        sizes["a message of the schedule"] = size_by(message_size, count, scenario.announcement_size)
    if not sizes:
        return
    message, size = max(sizes.items(), key=lambda entry: entry[1])
    airtime, guard = nanoseconds(airtime_of(medium, size, count)), nanoseconds(access.guard)
    free = nanoseconds(access.slot) - guard
    if airtime > free:
        least = -(-(airtime + guard) // 1000) / 1e6  # s, rounded up to whole microseconds
        yield (
            ("network", "medium", "access", "slot"),
            f"{message} of {size} bytes takes {seconds(airtime):g} s on the air, but a slot without its guard time"
            f" only {seconds(free):g} s: it should be at least {least:.10g} s (got {access.slot:g})",
        )
