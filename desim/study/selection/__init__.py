"""Which of several configurations is best, with a guarantee: systems are dropped as soon as they have lost.

The procedure is a function of a callable that gives samples; the race performs runs for it. A further procedure is one
module beside `kim_nelson`.
"""
