"""How pursuers negotiate: protocols, learning rules, schedules, temperatures and disseminations.

A dissemination determines how announcements spread. No module of this package depends on a scenario or a run.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from desim.config.exports import homes_of_exports, lazy_exports
from desim.config.packages import package_folder

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
    from protocols.policy import Layer as Layer
    from protocols.policy import Policy as Policy
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

_HOMES = homes_of_exports(__file__)
"""The module of each class."""
_CLASSES = MappingProxyType(
    {
        "desim.protocols": {
            "sap": "SpatialAdaptivePlay",
            "best_response": "BestResponse",
            "better_reply": "BetterReply",
            "binary_log_linear": "BinaryLogLinear",
            "selective_sap": "SelectiveSAP",
            "fictitious_play": "FictitiousPlay",
            "jsfp": "JointStrategyFictitiousPlay",
            "regret_matching": "RegretMatching",
            "generalised_regret_matching": "GeneralisedRegretMatching",
            "local_min": "LocalMin",
            "argmin_known": "ArgminKnown",
            "cbaa": "CBAA",
            "cbba": "CBBA",
            "server": "Server",
            "voronoi": "Voronoi",
            "argmin": "Argmin",
            "centralised": "Centralised",
            "policy": "Policy",
        },
        "desim.disseminations": {
            "one_hop": "OneHop",
            "flooding": "Flooding",
            "gossip": "Gossip",
            "reliable": "ReliableOneHop",
            "coded": "CodedOneHop",
        },
    }
)
"""For each group of entry points, the class of each kind; add a new protocol here, and to the imports above."""
KINDS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {group: {kind: f"{_HOMES[name]}:{name}" for kind, name in kinds.items()} for group, kinds in _CLASSES.items()}
)
"""For each group of entry points, the class of each kind as "module:class".

A module is imported when a scenario selects its kind.
"""


def _import_hints() -> dict[str, str]:
    """Return, by names that users look for in this package, what to write instead."""
    class_of = {kind: name for kinds in _CLASSES.values() for kind, name in kinds.items()}
    hints = {kind.upper(): f"from protocols import {name}" for kind, name in class_of.items()} | {  # SAP, for example
        kind: f"from protocols import {name}, or protocol={kind!r} for its defaults" for kind, name in class_of.items()
    }
    exports = homes_of_exports(str(package_folder("desim") / "__init__.py"))
    return hints | {name: f"from desim import {name}" for name in exports if name not in hints}


__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__, _import_hints)
