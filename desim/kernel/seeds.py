"""Named random streams: one seed, many independent generators, none of them global.

A stream depends on the seed and its name alone. It does not depend on how many other streams exist or on any
swept value, so two scenarios with the same seed share their luck (common random numbers).
"""

import zlib

import numpy as np


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """Return the generator of a name, for instance `stream(7, "pursuer", 3)`; equal arguments, equal draws."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()), index)))
