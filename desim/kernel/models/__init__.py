"""The models that a user writes under `[network]` and `[[fault]]`: graphs, latency, loss, reception, access, faults.

All are immutable, and none has the state of a run. A new kind is one class in the module of its family; it changes no
existing trace.
"""
