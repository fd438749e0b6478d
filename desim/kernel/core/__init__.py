"""Time, randomness and vocabulary of the kernel: clock, units, seeds, positions, records, events, message bodies.

Everything above builds on it. A change here changes every trace, so compare the digests before and after.
"""
