"""What is run: the configurations of a grid, and the identity of code and values that decides what can be reused.

A change here makes finished runs of older stores unusable.
"""
