"""The network in environments of other libraries: wrappers for PettingZoo and Gymnasium (the extra `rl`).

They step a `SteppedNetwork`; nothing of the pursuit is imported. A wrapper for another library is one module here, and
one case in `wrap`.
"""
