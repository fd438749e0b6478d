"""Runs in the formats of other tools: pandas, Perfetto, Wireshark and Foxglove.

A new format is one exporter, in a module of its own, and one entry in `export`.
"""
