"""What a sweep found: rows, groups and estimates, as tables, figures and files.

Nothing here performs a run.
"""
