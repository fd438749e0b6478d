"""The folder of a run on disk: what it holds, where it comes from, and how it is read again.

Nothing here computes a result.
"""
