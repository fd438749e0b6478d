"""Latency and loss models against their theory."""

import numpy as np

from desim.kernel.hops import Hops
from desim.kernel.latency import Constant
from desim.kernel.loss import Bernoulli

HOPS = Hops(0, np.arange(1, 1001))


def test_a_constant_latency_is_one_number_for_all_hops():
    assert Constant(value=0.25)(HOPS, np.random.default_rng(0)) == 0.25


def test_bernoulli_loses_its_share_independently():
    """10^6 hops at p = 0.3: the share has standard error sqrt(p q / n) = 0.00046; neighbours are uncorrelated."""
    rng, p = np.random.default_rng(1), 0.3
    lost = np.concatenate([Bernoulli(p=p)(HOPS, rng) for _ in range(1000)])
    error = np.sqrt(p * (1 - p) / lost.size)
    assert abs(lost.mean() - p) < 5 * error
    assert abs(lost.mean() - 1.02 * p) > 5 * error  # the control: 2 % off would be seen
    both = (lost[1:] & lost[:-1]).mean()
    assert abs(both - p * p) < 5 * np.sqrt(p * p * (1 - p * p) / lost.size)


def test_no_loss_draws_nothing_so_that_it_costs_nothing():
    rng = np.random.default_rng(1)
    assert Bernoulli()(HOPS, rng) is False
    assert rng.random() == np.random.default_rng(1).random()
