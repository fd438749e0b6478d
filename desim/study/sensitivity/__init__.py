"""What decides a metric: how much of its variation each key with a range causes.

Screening finds the keys without effect in few runs, and indices divide the variance among the others. Their estimators
are functions of arrays; the analysis performs runs for them.
"""
