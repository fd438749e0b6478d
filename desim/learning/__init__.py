"""Environments for reinforcement learning: a run in which the caller, not the protocol, decides for the pursuers.

The environments have the interface of PettingZoo, which the extra `rl` installs.
"""
