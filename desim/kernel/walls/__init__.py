"""Walls: their shapes, what they block, the loss of radio through them, and which lines cross them.

The crossings are shared by radio, sight and motion. A new way to write shapes is one reader here.
"""
