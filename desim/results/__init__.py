"""The folder of a run on disk: its files, its provenance, and how they are read again.

Nothing here computes a metric.
"""
