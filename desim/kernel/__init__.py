"""Message passing in simulated time: clock, graphs, link models, faults, and a network that nodes publish and send on.

This package does not depend on pursuit and can be used alone.
"""
