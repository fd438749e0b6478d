"""Shortest paths among walls: which straight lines are free, the visibility graph, and the space of a game.

Geometry without a clock. Motion, evaders and capture times ask the space (`space`) for distances and directions.
"""
