"""Environments for learners: a run in which the caller decides for the pursuers, with the interface of PettingZoo.

A new reward is one function in `rewards`. What a pursuer observes is in `desim.pursuit.team.observation`.
"""
