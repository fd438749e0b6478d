"""Walls: their shapes, in numbers, WKT or SVG, what they block, the loss of radio through materials, and which straight
lines cross them.

Radio, sight and motion share the crossings. A new way to write shapes is one reader in `outlines`.
"""
