"""How pursuers negotiate: one protocol, learning rule, schedule or dissemination for each module.

Nothing here knows of a scenario or a run.
"""

from collections.abc import Mapping
from types import MappingProxyType

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
        },
    }
)
"""For each group, the home "module:class" of each kind; add a new protocol here.

A module is imported when a scenario selects its kind.
"""
