"""Time, randomness and vocabulary of the kernel: clock, units, seeds, positions, records, events, message bodies.

All other packages of the kernel build on this one. A change here can change every trace, so compare the digests before
and after.
"""
