"""From the trace of a run to numbers and tables: metrics, age of information, hindsight, statistics, invariants.

Nothing here changes a run.
"""
