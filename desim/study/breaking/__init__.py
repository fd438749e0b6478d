"""What breaks a protocol: scenarios in which it violates a property are searched for, and the smallest one is kept.

A new imperfection that the search may add is one entry in `features`.
"""
