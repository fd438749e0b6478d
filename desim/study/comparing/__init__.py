"""Protocols compared: a benchmark with fixed scenarios and scores, and sweeps that a control variate makes precise.

A version of the benchmark never changes: a change of its scenarios is a new version beside it.
"""
