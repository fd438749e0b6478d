"""From the trace of a run to numbers and tables: metrics, age of information, hindsight, statistics, properties.

Nothing here changes a run.
"""
