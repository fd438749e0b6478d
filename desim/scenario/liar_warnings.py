"""Warnings about lies and trust that probably have no effect, or about more liars than trust tolerates."""

from collections.abc import Iterator

from desim.pursuit.byzantine.lies import (
    ByzantineFault,
    FalseAnnouncements,
    Liar,
    RandomLies,
    Selective,
    Silent,
    Slander,
)
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.team.trust import INITIAL_REPUTATION, TRUSTS, Reputation, Trimmed, may_distrust, tolerated_liars
from desim.scenario.assumptions import initial_graph, is_relayed
from desim.scenario.scenario import Scenario
from desim.scenario.telling import is_built_in, tells_nothing


def lie_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about Byzantine faults without an effect."""
    payload = None if scenario.protocol_traits.claim_size else scenario.announce.payload
    has_reports = scenario.protocol_traits.reckons and not scenario.announces
    is_forwarded = DisseminationTraits.of(scenario.announce.dissemination).relays
    has_token = scenario.schedule_traits.spreads_to is not None
    has_accusations = scenario.announce.trust.period is not None
    for k, fault in enumerate(scenario.fault):
        if not isinstance(fault, ByzantineFault):
            continue
        stays = fault.acts == "stay"  # staying has an effect, whatever the pursuer sends
        if isinstance(fault, Slander) and not (has_accusations or stays):
            yield f"fault.{k}", "it has no effect, because `announce.trust` reads no accusations"
        elif not (isinstance(fault, Slander | Silent) or stays) and tells_nothing(scenario):
            yield f"fault.{k}", f"it has no effect, because pursuers announce nothing under {scenario.protocol_name!r}"
        elif isinstance(fault, Selective) and not (is_forwarded or has_token or stays) and is_built_in(scenario):
            yield f"fault.{k}", "it has no effect, because pursuers forward nothing"
        elif isinstance(fault, FalseAnnouncements) and is_built_in(scenario):
            contained = {
                "phi": payload in {"time", None} and not has_reports,
                "position": payload in {"state", "course"} or has_reports,
            }
            unused = [key for key, is_sent in contained.items() if dict(fault)[key] is not None and not is_sent]
            yield from ((f"fault.{k}.{key}", "it has no effect: announcements do not contain it") for key in unused)
        if isinstance(fault, Liar) and (fault.action, fault.phi, fault.position) == ("truth", None, None):
            yield f"fault.{k}.action", "the announcements are true"


def trust_warnings(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield the warnings about trust without an effect, or with more liars than it can tolerate."""
    trust, count = scenario.announce.trust, scenario.team.count
    if not may_distrust(trust):
        return
    has_slander = any(isinstance(fault, Slander | RandomLies) for fault in scenario.fault)
    reads_slander = has_slander and trust.period is not None
    if tells_nothing(scenario) and TRUSTS.holds(trust) and not reads_slander:
        yield "announce.trust", "it has no effect, because pursuers announce nothing"
    if isinstance(trust, Trimmed):
        if scenario.protocol_traits.claim_size:
            yield "announce.trust", f"{scenario.protocol_name} compares bids, of which none is ignored"
        if trust.liars > tolerated_liars(count):
            yield (
                "announce.trust.liars",
                f"a complete graph of {count} pursuers is robust against {tolerated_liars(count)} liars",
            )
        elif trust.liars and not is_relayed(scenario) and not tells_nothing(scenario):
            yield from _sparse_warnings(scenario, trust.liars)
        return
    is_slow_to_trust = isinstance(trust, Reputation) and trust.threshold > INITIAL_REPUTATION
    if scenario.motion.static and TRUSTS.holds(trust) and not (reads_slander or is_slow_to_trust):
        yield "announce.trust", "it has no effect: no pursuer moves, so no motion refutes an announcement"


def _sparse_warnings(scenario: Scenario, liars: int) -> Iterator[tuple[str, str]]:
    """Yield a warning if a pursuer has too few neighbours for F liars among them.

    The rule needs a (2F + 1)-robust graph (LeBlanc et al. 2013, theorem 2): of any two disjoint sets of nodes, one has
    a node with 2F + 1 neighbours outside of its set. Take a single node and the set of all others. Each of these has at
    most one neighbour outside of its set, so the single node has 2F + 1. This condition on each node is necessary and
    not sufficient; a full test of robustness takes a time that is exponential in the size of the graph.
    """
    neighbours = dict(initial_graph(scenario).in_degree())
    pursuer = min(neighbours, key=lambda node: (neighbours[node], node), default=0)
    needed = 2 * liars + 1
    if neighbours.get(pursuer, 0) < needed:
        yield (
            "announce.trust.liars",
            f"to tolerate {liars} among its neighbours, each pursuer needs at least 2 F + 1 = {needed} of them, and"
            f" pursuer {pursuer} hears {neighbours.get(pursuer, 0)} at the start",
        )
