"""Named random streams: independent of each other and of everything global."""

import random

import numpy as np

from desim.kernel.seeds import stream


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
