"""Many runs: sweeps over a grid, stores, workers and clusters, paired comparisons, explanations.

A single run lives in `desim.simulation`.
"""
