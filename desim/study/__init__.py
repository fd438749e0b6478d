"""Many runs: sweeps over a grid, stores, workers and clusters, paired comparisons, explanations.

For a single run see `desim.simulation`.
"""
