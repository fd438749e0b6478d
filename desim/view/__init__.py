"""Pictures and pages of results: replays, alone or in pairs, film, space-time diagram, Perfetto trace, report.

Nothing here computes a metric.
"""
