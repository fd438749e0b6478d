"""How evaders behave: what they observe, and the strategies that choose their heading.

A new strategy is one class in `evasion`; it changes no existing trace.
"""
