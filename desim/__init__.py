"""desim simulates multi-robot relay pursuit that is negotiated over an imperfect network.

```python
from desim import load, run, summary

result = run(load("scenarios/relay.toml"), seed=7)
print(summary(result))
```
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from desim.analysis.metrics import summary
    from desim.scenario.scenario import Scenario
    from desim.scenario.toml import load
    from desim.simulation.run import Result, run
    from desim.study.explain import explain
    from desim.study.sweep import sweep

__all__ = ["Result", "Scenario", "explain", "load", "run", "summary", "sweep"]

_HOMES = {
    "Result": "desim.simulation.run",
    "Scenario": "desim.scenario.scenario",
    "explain": "desim.study.explain",
    "load": "desim.scenario.toml",
    "run": "desim.simulation.run",
    "summary": "desim.analysis.metrics",
    "sweep": "desim.study.sweep",
}


def __getattr__(name: str) -> object:
    """Import a public name on first access, so that `desim --help` does not load numpy."""
    if name not in _HOMES:
        raise AttributeError(f"module 'desim' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
