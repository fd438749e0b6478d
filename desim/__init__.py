"""desim simulates multi-robot relay pursuit that is negotiated over an imperfect network.

from desim import Scenario, load, run, summary

result = run(load("scenarios/relay.toml"), seed=7)
print(summary(result))
"""

from importlib import import_module

_HOMES = {
    "Result": "desim.simulation",
    "Scenario": "desim.scenario",
    "load": "desim.scenario_file",
    "run": "desim.simulation",
    "summary": "desim.analysis.metrics",
}
__all__ = ["Result", "Scenario", "load", "run", "summary"]  # noqa: F822


def __getattr__(name: str) -> object:
    """Import what is asked for when it is asked for, so that `desim --help` does not load numpy."""
    if name not in _HOMES:
        raise AttributeError(f"module 'desim' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
