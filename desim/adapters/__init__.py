"""The network in environments of other libraries: wrappers for PettingZoo and Gymnasium (the extra `rl`).

The environment moves the robots, and a `SteppedNetwork` carries what they say. Nothing of the pursuit is imported.
"""
