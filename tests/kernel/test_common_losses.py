"""Losses that are correlated between the receivers of a message, and between links with a node in common."""

from itertools import combinations
from math import exp, sqrt

import numpy as np
import pytest

from desim.config.errors import KeyedError
from desim.kernel.core.clock import Clock
from desim.kernel.core.link_context import LinkContext
from desim.kernel.models.common_losses import CommonCause, max_common
from desim.kernel.models.graphs import Complete
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli, GilbertElliott
from desim.kernel.network import Network

P = 0.2


def losses(model, messages, receivers=6, seed=1, step=0.0, src=0):
    """Return the (messages, receivers) losses of a sender."""
    run, rng = model.start_run(receivers + 1) if hasattr(model, "start_run") else model, np.random.default_rng(seed)
    dst = np.array([node for node in range(receivers + 1) if node != src])
    return np.array([run(LinkContext(src, dst, now=step * k), rng) for k in range(messages)])


def products(lost, pairs, p):
    """Return the (messages,) means, over pairs of columns, of the products of the losses in standard units."""
    unit = (lost - p) / sqrt(p * (1.0 - p))
    return np.mean([unit[:, a] * unit[:, b] for a, b in pairs], axis=0)


def deviation(samples, expected):
    """Return how many standard errors the mean of independent samples is off."""
    return (np.mean(samples) - expected) / (np.std(samples) / sqrt(np.size(samples)))


# A common cause.


@pytest.mark.parametrize("common", [0.0, 0.3, 0.9])
def test_losses_of_one_message_have_the_wanted_correlation(common):
    """Of any two receivers of 6000 messages, s.e. at most 0.013; what one receiver loses is Bernoulli.

    The control has independent losses.
    """
    lost = losses(CommonCause(p=P, common=common), 6000)
    assert abs(deviation(lost.mean(axis=1), P)) < 3.0
    assert abs(deviation(products(lost, combinations(range(6), 2), P), common)) < 3.0
    later = np.concatenate([lost[1:], lost[:-1]], axis=1)
    assert abs(deviation(products(later, [(k, k + 6) for k in range(6)], P), 0.0)) < 3.0
    independent = losses(Bernoulli(p=P), 6000)
    off = abs(deviation(products(independent, combinations(range(6), 2), P), common))
    assert (off > 5.0) == (common > 0.0)


def test_the_number_of_losses_without_a_common_part_is_binomial():
    """As many receivers lose a message as with `bernoulli`: 0 to 6 of 6, within 3 s.e. for each."""
    counts = losses(CommonCause(p=P, common=0.0), 6000).sum(axis=1)
    same = losses(Bernoulli(p=P), 6000, seed=2).sum(axis=1)
    for number in range(5):
        expected = [1, 6, 15, 20, 15][number] * P**number * (1.0 - P) ** (6 - number)
        assert abs(deviation(counts == number, expected)) < 3.0
        assert abs(deviation(same == number, expected)) < 3.0


@pytest.mark.slow
def test_in_a_network_receivers_lose_broadcasts_together_and_messages_to_one_node_alone():
    """With a correlation of 0.9 most of 2000 broadcasts reach all of 4 receivers or none; 0.08 se for a message."""
    clock = Clock()
    net = Network(clock, Complete()(5), Links(loss=CommonCause(p=0.5, common=0.9)), seed=3)
    for number in range(2000):
        net.send(0, None, number, port="all")
        net.send(1, 2, number, port="one")
    clock.run(until=1)
    got = [{message.body for message in net.inbox(node, "all").drain()} for node in range(1, 5)]
    together = [sum(number in bodies for bodies in got) for number in range(2000)]
    assert 0.4 < np.mean(np.array(together) == 4) < 0.55
    assert np.mean(np.isin(together, [0, 4])) > 0.8
    assert abs(len(net.inbox(2, "one").drain()) / 2000 - 0.5) < 3.0 * sqrt(0.25 / 2000)


# Bursts.

SHARE, COMMON, BURST = 0.2, 0.35, 0.5
BURSTS = GilbertElliott(share=SHARE, burst=BURST, advance="time", common=COMMON)


def states_of_all(model, times, size=4, seed=5):
    """Return the (times, links) states of all directed links, as the losses of messages at those times."""
    run, rng = model.start_run(size), np.random.default_rng(seed)
    links = [(src, dst) for src in range(size) for dst in range(size) if src != dst]
    drawn = []
    for now in times:
        by_link = {}
        for src in range(size):
            dst = np.array([node for node in range(size) if node != src])
            for node, lost in zip(dst.tolist(), run(LinkContext(src, dst, now=now), rng).tolist(), strict=True):
                by_link[src, node] = lost
        drawn.append([by_link[link] for link in links])
    return links, np.array(drawn)


@pytest.mark.slow
def test_links_with_a_node_in_common_are_bad_together():
    """At 3000 independent instants: with one node in common `common`, s.e. 0.009; with none 0, in any direction.

    The control is the same model without `common`.
    """
    times = 20.0 * BURST * np.arange(3000)
    links, bad = states_of_all(BURSTS, times)
    pairs = list(combinations(range(len(links)), 2))
    shared = [(a, b) for a, b in pairs if len({*links[a], *links[b]}) == 3]
    apart = [(a, b) for a, b in pairs if len({*links[a], *links[b]}) == 4]
    assert abs(deviation(bad.mean(axis=1), SHARE)) < 3.0
    assert abs(deviation(products(bad, shared, SHARE), COMMON)) < 3.0
    assert abs(deviation(products(bad, apart, SHARE), 0.0)) < 3.0
    _, alone = states_of_all(BURSTS.model_copy(update={"common": 0.0}), times)
    assert abs(deviation(products(alone, shared, SHARE), 0.0)) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("common", [COMMON, 0.05, max_common(SHARE)])
def test_bursts_have_their_share_and_mean_duration(common):
    """A link is bad for `burst` on average, and good for (1 - share) / share of that: 9 runs of 15 s and 20 links."""
    step, shares, begun = 0.01, [], []
    for seed in range(9):
        model = BURSTS.model_copy(update={"common": common})
        lost = losses(model, 1500, receivers=20, seed=seed, step=step)
        shares.append(lost.mean())
        begun.append((lost[1:] & ~lost[:-1]).mean() / step)
    assert abs(deviation(shares, SHARE)) < 3.0
    assert abs(deviation(np.array(shares) - BURST * np.array(begun), 0.0)) < 3.0
    assert abs(deviation(np.array(shares) - 1.3 * BURST * np.array(begun), 0.0)) > 3.0


def test_a_link_with_common_bursts_forgets_its_state_at_the_rate_of_its_parts():
    """Without links of their own the states of both nodes decay alike: the correlation after t is known.

    P(good at 0 and t) is the square of that of one node, whose share is s with (1 - s)^2 = 1 - share.
    """
    model = BURSTS.model_copy(update={"common": max_common(SHARE)})
    s = 1.0 - sqrt(1.0 - SHARE)
    recovery = SHARE / (1.0 - SHARE) / BURST / (2.0 * s / (1.0 - s))
    t = 0.2
    both = ((1.0 - s) ** 2 + s * (1.0 - s) * exp(-recovery / (1.0 - s) * t)) ** 2
    times = [20.0 * k * BURST + after for k in range(1500) for after in (0.0, t)]
    run, rng = model.start_run(3), np.random.default_rng(2)
    good = ~np.array([run(LinkContext(0, np.array([1]), now=now), rng)[0] for now in times]).reshape(-1, 2)
    assert abs(deviation(good.all(axis=1), both)) < 3.0
    assert abs(deviation(good.all(axis=1), (1.0 - SHARE) ** 2)) > 3.0


def test_losses_in_common_bursts_have_the_probabilities_of_the_states():
    model = BURSTS.model_copy(update={"loss_good": 0.1, "loss_bad": 0.7})
    lost = losses(model, 3000, step=20.0 * BURST)
    assert abs(deviation(lost.mean(axis=1), 0.1 + 0.6 * SHARE)) < 3.0


# Bad values.


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: CommonCause(common=1.0), "common"),
        (lambda: CommonCause(common=-0.1), "common"),
        (lambda: CommonCause(p=1.5), "p"),
        (lambda: GilbertElliott(common=0.2), 'common needs advance = "time"'),
        (lambda: GilbertElliott(advance="time", common=0.49), "common should be at most 0.4868 for a share of 0.1"),
        (lambda: GilbertElliott(advance="time", common=-0.1), "common"),
        (lambda: GilbertElliott(advance="time", common=1.0), "common"),
    ],
)
def test_a_wrong_correlation_is_refused(make, problem):
    with pytest.raises(KeyedError, match=problem):
        make()


def test_the_largest_correlation_is_that_of_links_without_bad_periods_of_their_own():
    for share in (1e-3, 0.1, 0.5, 0.9):
        of_node = 1.0 - sqrt(1.0 - share)
        both_good = (1.0 - of_node) ** 3
        assert max_common(share) == pytest.approx((both_good - (1.0 - share) ** 2) / (share * (1.0 - share)))
    assert max_common(1e-6) == pytest.approx(0.5, abs=1e-4)
