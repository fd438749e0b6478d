"""Points, headings and the state of the players, and the events of a pursuit: words that all other rooms use.

Mathematics without a clock. A change here changes every trace.
"""
