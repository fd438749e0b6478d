"""How pursuers negotiate: protocols, learning rules, schedules, temperatures and disseminations.

A dissemination determines how announcements spread. No module of this package depends on a scenario or a run.
"""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from protocols.best_response import BestResponse as BestResponse
    from protocols.best_response import BetterReply as BetterReply
    from protocols.binary_log_linear import BinaryLogLinear as BinaryLogLinear
    from protocols.binary_log_linear import SelectiveSAP as SelectiveSAP
    from protocols.cbaa import CBAA as CBAA
    from protocols.cbba import CBBA as CBBA
    from protocols.centralised import Centralised as Centralised
    from protocols.dissemination import CodedOneHop as CodedOneHop
    from protocols.dissemination import Flooding as Flooding
    from protocols.dissemination import Gossip as Gossip
    from protocols.dissemination import OneHop as OneHop
    from protocols.dissemination import ReliableOneHop as ReliableOneHop
    from protocols.fictitious_play import FictitiousPlay as FictitiousPlay
    from protocols.fictitious_play import JointStrategyFictitiousPlay as JointStrategyFictitiousPlay
    from protocols.geometric import Argmin as Argmin
    from protocols.geometric import Voronoi as Voronoi
    from protocols.local_min import ArgminKnown as ArgminKnown
    from protocols.local_min import LocalMin as LocalMin
    from protocols.regret_matching import GeneralisedRegretMatching as GeneralisedRegretMatching
    from protocols.regret_matching import RegretMatching as RegretMatching
    from protocols.sap import SpatialAdaptivePlay as SpatialAdaptivePlay
    from protocols.schedules.mutex import LocalMutex as LocalMutex
    from protocols.schedules.periodic import Periodic as Periodic
    from protocols.schedules.periodic import Poisson as Poisson
    from protocols.schedules.periodic import Rounds as Rounds
    from protocols.schedules.periodic import SharedSeed as SharedSeed
    from protocols.schedules.synchronous import Synchronous as Synchronous
    from protocols.schedules.token import TokenRing as TokenRing
    from protocols.schedules.token import TokenWalk as TokenWalk
    from protocols.server import Server as Server
    from protocols.temperature import AdaptiveTau as AdaptiveTau
    from protocols.temperature import ConstantTau as ConstantTau
    from protocols.temperature import GeometricTau as GeometricTau
    from protocols.temperature import LogarithmicTau as LogarithmicTau
    from protocols.temperature import PaperTau as PaperTau

KINDS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "desim.protocols": {
            "sap": "protocols.sap:SpatialAdaptivePlay",
            "best_response": "protocols.best_response:BestResponse",
            "better_reply": "protocols.best_response:BetterReply",
            "binary_log_linear": "protocols.binary_log_linear:BinaryLogLinear",
            "selective_sap": "protocols.binary_log_linear:SelectiveSAP",
            "fictitious_play": "protocols.fictitious_play:FictitiousPlay",
            "jsfp": "protocols.fictitious_play:JointStrategyFictitiousPlay",
            "regret_matching": "protocols.regret_matching:RegretMatching",
            "generalised_regret_matching": "protocols.regret_matching:GeneralisedRegretMatching",
            "local_min": "protocols.local_min:LocalMin",
            "argmin_known": "protocols.local_min:ArgminKnown",
            "cbaa": "protocols.cbaa:CBAA",
            "cbba": "protocols.cbba:CBBA",
            "server": "protocols.server:Server",
            "voronoi": "protocols.geometric:Voronoi",
            "argmin": "protocols.geometric:Argmin",
            "centralised": "protocols.centralised:Centralised",
        },
        "desim.disseminations": {
            "one_hop": "protocols.dissemination:OneHop",
            "flooding": "protocols.dissemination:Flooding",
            "gossip": "protocols.dissemination:Gossip",
            "reliable": "protocols.dissemination:ReliableOneHop",
            "coded": "protocols.dissemination:CodedOneHop",
        },
    }
)
"""For each group of entry points, the class of each kind as "module:class"; add a new protocol here.

A module is imported when a scenario selects its kind.
"""

PARTS = (
    "protocols.schedules.mutex:LocalMutex",
    "protocols.schedules.periodic:Periodic",
    "protocols.schedules.periodic:Poisson",
    "protocols.schedules.periodic:Rounds",
    "protocols.schedules.periodic:SharedSeed",
    "protocols.schedules.synchronous:Synchronous",
    "protocols.temperature:AdaptiveTau",
    "protocols.temperature:ConstantTau",
    "protocols.temperature:GeometricTau",
    "protocols.temperature:LogarithmicTau",
    "protocols.temperature:PaperTau",
    "protocols.schedules.token:TokenRing",
    "protocols.schedules.token:TokenWalk",
)
"""The schedules and temperatures as "module:class"; a script can import them from `protocols`, like the protocols."""
_HOMES = {
    home.partition(":")[2]: home for home in (*PARTS, *(home for group in KINDS.values() for home in group.values()))
}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    """Return a class, and import its module if necessary."""
    if name not in _HOMES:
        raise AttributeError(f"module 'protocols' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name].partition(":")[0]), name)


def __dir__() -> list[str]:
    """Return the names of the classes."""
    return __all__
