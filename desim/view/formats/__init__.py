"""Runs in the formats of other tools: pandas, Perfetto, Wireshark and Foxglove.

A new format is one module and one entry in `export`.
"""
