"""Named random streams: independent of each other and of everything global."""

import random

import numpy as np
import pytest

from desim.kernel.core.seeds import _key, pair_draw, pair_uniform, stream


def test_equal_names_give_equal_draws_and_different_ones_do_not():
    draws = {
        key: tuple(stream(*key).random(4))
        for key in [(7, "latency", 0), (8, "latency", 0), (7, "loss", 0), (7, "latency", 1)]
    }
    assert len(set(draws.values())) == len(draws)
    assert tuple(stream(7, "latency").random(4)) == draws[7, "latency", 0]


def test_streams_are_uncorrelated():
    """|r| of two independent samples of n has standard error 1/sqrt(n); the control correlates fully."""
    n = 20_000
    a, b = stream(7, "pursuer", 0).random(n), stream(7, "pursuer", 1).random(n)
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(n)
    assert abs(np.corrcoef(a, stream(7, "pursuer", 0).random(n))[0, 1]) > 0.99


def test_the_first_draws_of_a_stream_never_change():
    """A golden value: seeds in papers must mean the same next year."""
    assert stream(7, "latency").integers(0, 1000, 5).tolist() == [311, 584, 491, 566, 783]


def test_the_global_generators_do_not_move():
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    stream(7, "latency").random(10)
    assert (np.random.random(), random.random()) == (0.417022004702574, 0.13436424411240122)  # noqa: NPY002


# Uniforms of pairs.

OTHERS = np.arange(1, 100_001)


def departure(sample):
    """Return sqrt(n) D of Kolmogorov and Smirnov against the uniform law: above 2.2 in 1 of 8000 samples."""
    ordered, steps = np.sort(sample), np.arange(sample.size + 1) / sample.size
    return max((steps[1:] - ordered).max(), (ordered - steps[:-1]).max()) * np.sqrt(sample.size)


@pytest.mark.slow
@pytest.mark.parametrize("symmetric", [True, False])
def test_pair_uniforms_are_uniformly_distributed(symmetric):
    """Over 10^5 receivers of a sender, of 3 senders and 5 seeds; the control is a uniform to the power of 1.05."""
    for seed in range(5):
        for src in (0, 77, 2**31):
            uniform = pair_uniform(seed, "fading", src, OTHERS, symmetric=symmetric)
            assert departure(uniform) < 2.2
            assert departure(uniform**1.05) > 2.2


def test_the_uniform_of_a_pair_does_not_depend_on_the_other_pairs_queried():
    uniform = pair_uniform(7, "fading", 3, OTHERS)
    assert (pair_uniform(7, "fading", 3, OTHERS[::-1]) == uniform[::-1]).all()
    assert pair_uniform(7, "fading", 3, np.array([99]))[0] == uniform[98]
    assert pair_uniform(7, "fading", 3, np.array([], dtype=int)).shape == (0,)


def test_the_uniform_of_a_pair_is_symmetric_only_on_request():
    there = [pair_uniform(7, "fading", 3, np.array([node])).item() for node in range(10)]
    back = [pair_uniform(7, "fading", node, np.array([3])).item() for node in range(10)]
    assert there == back
    there = pair_uniform(7, "fading", 3, np.array([5]), symmetric=False)
    back = pair_uniform(7, "fading", 5, np.array([3]), symmetric=False)
    assert there != back


@pytest.mark.parametrize("symmetric", [True, False])
def test_the_draw_of_one_pair_is_that_of_many(symmetric):
    rng = random.Random(1)
    pairs = [(rng.randrange(2**20), rng.randrange(2**20), rng.randrange(2**40)) for _ in range(100)]
    src, dst, numbers = np.array([*pairs, (0, 0, 0), (3, 1, 0), (2**31 - 1, 2**31 - 2, 2**62)]).T
    of_each = [
        pair_draw(7, "a", *pair, symmetric=symmetric)
        for pair in zip(*map(np.ndarray.tolist, (src, dst, numbers)), strict=True)
    ]
    assert of_each == pair_uniform(7, "a", src, dst, numbers, symmetric=symmetric).tolist()


@pytest.mark.parametrize("symmetric", [True, False])
def test_no_two_pairs_share_their_uniform(symmetric):
    """200 nodes: 19 900 pairs, or 39 800 with both ways; a chance collision of 2^-52 draws has probability 10^-7."""
    nodes, lucks = np.arange(200), set()
    for src in nodes.tolist():
        lucks.update(pair_uniform(7, "fading", src, nodes[nodes != src], symmetric=symmetric).tolist())
    assert len(lucks) == 19_900 * (1 if symmetric else 2)


def test_pair_uniforms_are_uncorrelated_between_neighbours_seeds_names_and_directions():
    """|r| of n = 10^5 independent pairs has standard error 1 / sqrt(n); the control is the same uniforms again."""
    uniform = pair_uniform(7, "fading", 500_000, OTHERS)
    shifted = {
        "next receiver": pair_uniform(7, "fading", 500_000, OTHERS + 1),
        "far receiver": pair_uniform(7, "fading", 500_000, OTHERS + 2**16),
        "next sender": pair_uniform(7, "fading", 500_001, OTHERS),
        "next seed": pair_uniform(8, "fading", 500_000, OTHERS),
        "other name": pair_uniform(7, "pair latency", 500_000, OTHERS),
        "next number": pair_uniform(7, "fading", 500_000, OTHERS, 1),
        "asymmetric": pair_uniform(7, "fading", 500_000, OTHERS, symmetric=False),
    }
    limit = 5 / np.sqrt(OTHERS.size)
    assert {name for name, other in shifted.items() if abs(np.corrcoef(uniform, other)[0, 1]) > limit} == set()
    assert np.corrcoef(uniform, pair_uniform(7, "fading", 500_000, OTHERS))[0, 1] > limit


def test_each_bit_of_a_pair_uniform_is_a_fair_coin():
    """The upper 40 bits of 10^5 draws: ones within 5 standard errors of one half; the last of 64, always 0, is not."""
    bits = (pair_uniform(7, "fading", 0, OTHERS) * 2.0**52).astype(np.uint64)
    ones = [((bits >> np.uint64(k)) & np.uint64(1)).mean() for k in range(12, 53)]
    off = np.abs(np.array(ones) - 0.5) / (0.5 / np.sqrt(OTHERS.size))
    assert off[:-1].max() < 5
    assert off[-1] > 5


def test_a_pair_uniform_is_less_than_1_even_for_the_largest_hash():
    """The hash is undone to find the pair whose 64 bits are all ones, and the one whose bits are all zeros."""
    for bits in (2**64 - 1, 0):
        pair = unmixed(unmixed(bits) - 0x9E3779B97F4A7C15) - int(_key(7, "fading"))
        src, dst = divmod(pair % 2**64, 2**32)
        (uniform,) = pair_uniform(7, "fading", src, np.array([dst]), symmetric=False)
        assert abs(uniform - bits / 2**64) < 1e-15
        assert 0.0 < uniform < 1.0


def unmixed(z):
    """Return what splitmix64 makes `z` of."""
    for shift, factor in ((31, 0x94D049BB133111EB), (27, 0xBF58476D1CE4E5B9), (30, 1)):
        z = undone(z % 2**64, shift) * pow(factor, -1, 2**64) % 2**64
    return z


def undone(z, shift):
    """Return x of z = x ^ (x >> shift)."""
    x = z
    for _ in range(64 // shift):
        x = z ^ (x >> shift)
    return x


def test_the_uniform_of_a_pair_never_changes():
    """A golden value: seeds in papers must mean the same next year."""
    assert np.round(pair_uniform(7, "fading", 0, np.array([1, 2, 3])), 6).tolist() == [0.531123, 0.51988, 0.562028]
