"""The game of the paper, with one or several evaders: profiles, utilities, assignments.

Mathematics without a clock, the same for every protocol. A new utility is one class in `utility`.
"""
