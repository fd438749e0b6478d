"""An experiment as one frozen value: TOML and overrides in, a validated scenario with checks and assumptions out.

Nothing here runs a simulation.
"""
