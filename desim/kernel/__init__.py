"""Message passing in simulated time: clock, graphs, link models, faults, and a network with `publish` and `send`.

This package does not depend on pursuit and can be used alone.
"""
