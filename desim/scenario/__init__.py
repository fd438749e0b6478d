"""An experiment as one frozen value: from TOML and overrides to a validated scenario, its checks and assumptions.

Nothing here runs anything.
"""
