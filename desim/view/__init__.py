"""Pictures and pages of results: replay, film, space-time diagram, Perfetto trace, report.

Nothing here computes a metric.
"""
