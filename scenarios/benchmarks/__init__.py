"""How fast desim is, and how large: `python -m scenarios.benchmarks` measures it beside other simulators.

This room is not in the wheel. What desim costs is in `costs`, `sweep_costs`, `learning_costs` and `live_costs`; the
other implementations are `peers`.
"""
