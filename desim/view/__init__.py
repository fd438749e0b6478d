"""Pictures and pages of results: replays, alone or in pairs, film, space-time diagram, Perfetto trace, report.

Traces for pandas, Wireshark and Foxglove. Nothing here computes a metric.
"""
