"""How pursuers negotiate: one protocol, learning rule, schedule or dissemination for each module.

Nothing here knows of a scenario or a run.
"""
