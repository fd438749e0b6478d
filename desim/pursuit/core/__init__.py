"""Points, headings and the state of the players, and the events of a pursuit, for all other packages.

Mathematics without a clock. A change here changes every trace.
"""
