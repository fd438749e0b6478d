"""Protocols compared: a benchmark with fixed scenarios and scores, and sweeps that a control variate makes precise."""
