"""The space in which players move: the plane, or the plane among walls, with its shortest paths.

Motion, evaders and capture times ask the space for distances and directions, so nothing else knows of walls.
"""
