"""Where finished runs are kept: SQLite files, their rows, and the history of sweeps.

A run is a row as soon as it has finished, so a crash loses nothing. A change of the layout needs a new version number.
"""
