"""The game, its players, and what each of them may know; nothing of runs."""
