"""From numbers to figures: the palette, the style of axes, and how figures are saved.

Figures of sweeps and of runs share this style, so that a colour means the same everywhere.
"""
