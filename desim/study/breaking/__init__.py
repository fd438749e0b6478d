"""What breaks a protocol: scenarios in which it violates a property are searched for and made small.

The search is random, or tries all choices of lost, late or repeated messages. A new imperfection that the search may
add is one entry in `features`.
"""
