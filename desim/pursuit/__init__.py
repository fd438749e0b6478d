"""The game and its players: capture times, utilities, evaders, sensing, motion, and what each agent may know.

Nothing here starts a run.
"""
