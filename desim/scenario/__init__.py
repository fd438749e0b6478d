"""An experiment as one immutable object: TOML and overrides in, a validated scenario with checks and assumptions out.

Nothing here runs a simulation.
"""
