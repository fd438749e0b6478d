"""How fast desim is, and how large: `python -m scenarios.benchmarks` measures it beside other simulators.

This room is not in the wheel. What desim costs is in `costs` and `sweep_costs`; the other implementations are `peers`.
"""
