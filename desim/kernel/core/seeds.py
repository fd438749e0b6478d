"""Named random streams: many independent generators from one seed, none of them global.

A stream depends only on the seed, its name and its index, not on other streams or on swept values. Two scenarios with
the same seed therefore use common random numbers.
"""

import zlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desim.config.arguments import value_text
from desim.config.arrays import Integers
from desim.config.python_numbers import whole

ROOM = 2**22
"""Maximum number of values in a cache with one value per pair of nodes; further values are computed at each use."""


def seed_list(seeds: Any) -> list[Any]:
    """Return seeds of any kind, such as a range, as a list.

    Raises:
        ValueError: if they are a text or a table, or one number.
    """
    if isinstance(seeds, str | Mapping) or not isinstance(seeds, Iterable):
        raise ValueError(f"seeds should be a list of integers (got {value_text(seeds)})")
    return list(seeds)


def seed_of(value: int) -> int:
    """Return a seed, an integer of any kind, as an `int`.

    Raises:
        ValueError: if the value is not an integer, or is negative.
    """
    seed = whole(value, "the seed")
    if seed < 0:
        raise ValueError(f"the seed should be at least 0, got {seed}")
    return seed


RUNS_PER_SEED = 1_000_000
"""The number of runs of one root seed, each of which has a seed of its own."""


def run_seed(root: int, run: int) -> int:
    """Return the seed of a run of a root seed, `RUNS_PER_SEED` * root + run, so that no two root seeds share a run.

    Raises:
        ValueError: if the root seed is not a seed, or the number of the run is not below `RUNS_PER_SEED`.
    """
    if not 0 <= run < RUNS_PER_SEED:
        raise ValueError(f"a seed has the runs 0 to {RUNS_PER_SEED - 1:,}, got {run:,}: take another seed for more")
    return seed_of(root) * RUNS_PER_SEED + run


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """Create a generator, for instance `stream(7, "pursuer", 3)`; equal arguments give equal draws."""
    return np.random.default_rng(_sequence(seed, name, index))


def pair_uniform(
    seed: int,
    name: str,
    src: int | Integers,
    dst: Integers,
    number: int | Integers = 0,
    *,
    symmetric: bool = True,
) -> NDArray[np.float64]:
    """Return (k,) uniform draws in (0, 1), one per pair (src, dst[k]), the same in every call with equal arguments.

    Each draw is a splitmix64 hash of the arguments (Steele, Lea & Flood 2014, "Fast Splittable Pseudorandom Number
    Generators"). Draws are not stored, because a table for ten thousand nodes would have 10^8 entries.

    Args:
        seed: the seed of the run.
        name: the name of the random quantity.
        src: the first node of the pairs, one for all or (k,).
        dst: (k,) the second node of each pair.
        number: the index of the draw of a pair, for instance the number of a message; one for all or (k,).
        symmetric: whether (i, j) and (j, i) have the same draw.
    """
    other = np.asarray(dst)
    first, second = (np.minimum(src, other), np.maximum(src, other)) if symmetric else (np.full_like(other, src), other)
    pair = (first.astype(np.uint64) << np.uint64(32)) | second.astype(np.uint64)
    # The pair is mixed before the number is added: plain sums of different pairs and numbers could be equal. The
    # constant, 2^64 divided by the golden ratio, is the step of splitmix64.
    increment = (np.atleast_1d(number).astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = _mix(_mix(pair + _key(seed, name)) + increment)
    # 52 bits, because with 53 the largest draw would be rounded to 1, where most quantiles are infinite.
    return ((mixed >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52


def pair_draw(seed: int, name: str, src: int, dst: int, number: int = 0, *, symmetric: bool = True) -> float:
    """Return the draw of `pair_uniform` for one pair, in a tenth of the time.

    Kept equal to the draws of many pairs by `tests/kernel/test_seeds.py::test_the_draw_of_one_pair_is_that_of_many`.
    """
    first, second = (dst, src) if symmetric and dst < src else (src, dst)
    pair = ((first << 32 | second) + int(_key(seed, name))) & WORD
    mixed = _mix_one((_mix_one(pair) + (number + 1) * 0x9E3779B97F4A7C15) & WORD)
    return ((mixed >> 12) + 0.5) * 2.0**-52


WORD = 2**64 - 1
"""The mask that reduces an integer of Python to 64 bits."""


def _mix_one(z: int) -> int:
    """Mix the bits of one number, as `_mix` does with those of an array."""
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & WORD
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & WORD
    return z ^ (z >> 31)


@lru_cache(maxsize=256)
def _key(seed: int, name: str) -> np.uint64:
    return np.uint64(_sequence(seed, name, 0).generate_state(1, np.uint64)[0])


def _sequence(seed: int, name: str, index: int) -> np.random.SeedSequence:
    # CRC-32, because `hash` of a text differs from process to process.
    return np.random.SeedSequence(seed_of(seed), spawn_key=(zlib.crc32(name.encode()), index))


def _mix(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
