"""Checks of what users write: protocols, models of links, faults, bodies, flows, trust, evaders, metrics, exporters.

If you are unsure whether your latency is right, run `check_latency(...)`: it raises an error that says what is wrong.
Watchers check the invariants of messages and of pursuits in any run. Nothing here needs pytest.
"""

from typing import TYPE_CHECKING

from desim.config.exports import lazy_exports

if TYPE_CHECKING:
    from desim.testing.bodies import check_body as check_body
    from desim.testing.decisions import check_dissemination as check_dissemination
    from desim.testing.decisions import check_protocol as check_protocol
    from desim.testing.decisions import check_schedule as check_schedule
    from desim.testing.evaders import check_evader as check_evader
    from desim.testing.exporters import check_exporter as check_exporter
    from desim.testing.faults import check_fault as check_fault
    from desim.testing.flows import check_flow as check_flow
    from desim.testing.judging import ContractError as ContractError
    from desim.testing.links import check_latency as check_latency
    from desim.testing.links import check_loss as check_loss
    from desim.testing.metrics import check_metric as check_metric
    from desim.testing.properties import assert_holds as assert_holds
    from desim.testing.pursuits import watched as watched
    from desim.testing.trust import check_trust as check_trust

__getattr__, __dir__, __all__ = lazy_exports(__name__, __file__)
