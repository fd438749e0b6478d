"""Links that follow measurements: tables, traces and ping logs, read from files and played back.

A new file format is one reader here. The readers share `csv_tables`, which states file and line of an error.
"""
