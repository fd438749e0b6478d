"""Message passing in simulated time: clock, graphs, link models, faults, `publish` and `send`.

Usable alone: nothing here knows of pursuit.
"""
