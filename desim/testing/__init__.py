"""Checks of what users write: protocols, models of links, faults, bodies, flows, trust, evaders, metrics, exporters.

If you are unsure whether your latency is right, run `check_latency(...)`: it raises an error that says what is wrong.
Watchers check the invariants of messages and of pursuits in any run. Nothing here needs pytest.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from desim.testing.bodies import check_body as check_body
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

_NAMES = {
    "bodies": ("check_body",),
    "decisions": ("check_protocol", "check_schedule"),
    "evaders": ("check_evader",),
    "exporters": ("check_exporter",),
    "faults": ("check_fault",),
    "flows": ("check_flow",),
    "judging": ("ContractError",),
    "links": ("check_latency", "check_loss"),
    "metrics": ("check_metric",),
    "properties": ("assert_holds",),
    "pursuits": ("watched",),
    "trust": ("check_trust",),
}
"""The public names by module. Each is imported on first access."""
_HOMES = {name: f"{__name__}.{module}" for module, names in _NAMES.items() for name in names}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    """Return the object that a public name denotes; its module is imported on first access."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
