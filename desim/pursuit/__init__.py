"""The pursuit game and its players: capture times, utilities, evaders, sensing, motion, and the interface of an agent.

Nothing here starts a run or reads a file.
"""
