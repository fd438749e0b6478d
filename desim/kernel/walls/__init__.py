"""Walls: their shapes, in numbers, WKT or SVG, what they block, losses of materials, and which lines cross them.

Radio, sight and motion share the crossings. A new way to write shapes is one reader in `outlines`.
"""
