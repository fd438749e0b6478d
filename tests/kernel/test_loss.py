"""Every loss model against its theory."""

import tracemalloc
from math import exp, sqrt

import numpy as np
import pytest

from desim.config.errors import KeyedError
from desim.kernel.core.link_context import LinkContext
from desim.kernel.models.common_losses import CommonCause
from desim.kernel.models.correlation import RANGE, CorrelatedNumbers
from desim.kernel.models.link_draws import booleans_of
from desim.kernel.models.loss import Bernoulli, Bursts, ByDistance, Correlated, FourState, GilbertElliott
from tests.models import MODELS, made

SEEDS = range(3)
LINKS = 4000
SHARE, BURST = 0.2, 5.0


def context(now=0.0, src=0, links=LINKS):
    return LinkContext(src, np.arange(1, links + 1), now=now)


def history(model, times, seed, links=LINKS):
    """Return what each of many links does at each time: (times, links) truths, True where a message is lost."""
    run, rng = model.start_run(links + 1), np.random.default_rng(seed)
    return np.array([run(context(now, links=links), rng) for now in times])


def errors(hits, trials, probability):
    """Return how many standard errors sqrt(p (1 - p) / n) the share of hits is off."""
    return (hits / trials - probability) / sqrt(probability * (1 - probability) / trials)


# Independent losses.


@pytest.mark.parametrize("p", [0.02, 0.3, 0.95])
def test_bernoulli_loses_its_share(p):
    """3 seeds x 10^6 hops, within 5 standard errors; the control, 10 % (of the rarer outcome) off, is not."""

    def worst(model, pick):
        lost = (model(context(links=10**6), np.random.default_rng(seed)).sum() for seed in SEEDS)
        return pick(abs(errors(each, 10**6, p)) for each in lost)

    assert worst(Bernoulli(p=p), max) < 5
    assert worst(Bernoulli(p=p + 0.1 * min(p, 1 - p)), min) > 5


def test_bernoulli_draws_in_advance_equal_those_hop_by_hop():
    model, rng, ahead = Bernoulli(p=0.3), np.random.default_rng(1), np.random.default_rng(1)
    assert [*model(context(links=7), rng), *model(context(links=2), rng)] == model.draw(9, ahead).tolist()


def test_loss_probabilities_0_and_1_are_certain_and_no_loss_draws_no_random_numbers():
    rng = np.random.default_rng(1)
    assert Bernoulli()(context(), rng) is Bernoulli(p=0.0)(context(), rng) is False
    assert rng.random() == np.random.default_rng(1).random()
    assert Bernoulli(p=1.0)(context(), rng).all()


LOSSES = [model for model in MODELS if model.__module__ in {"desim.kernel.models.loss", CommonCause.__module__}]


@pytest.mark.parametrize("kind", LOSSES)
def test_a_sender_without_receivers_loses_nothing_after_messages_to_one_node(kind):
    model, rng = made(kind), np.random.default_rng(1)
    run = model.start_run(3) if hasattr(model, "start_run") else model
    for dst in ([1], [], [1, 2], []):
        asked = LinkContext(0, np.array(dst, int), positions=lambda: np.arange(6.0).reshape(3, 2))
        assert len(booleans_of(run(asked, rng), len(dst), kind)) == len(dst)


# Bursts, message by message.


@pytest.mark.slow
def test_a_link_that_advances_by_messages_keeps_its_two_rates():
    """Of bad links 1 / burst recover with a message, of good ones share / (1 - share) / burst fail: p = 0.05, r = 0.2.

    3 seeds x 4000 links x 100 messages, given the state before: binomial, within 5 standard errors. The control is a
    burst 10 % longer.
    """
    for seed in SEEDS:
        good = history(GilbertElliott(share=SHARE, burst=BURST), range(100), seed)
        off = history(GilbertElliott(share=SHARE, burst=1.1 * BURST), range(100), seed)
        assert max(np.abs(rates_off(good))) < 5
        assert min(np.abs(rates_off(off))) > 5


def rates_off(bad):
    before, after = bad[:-1], bad[1:]
    recovered, failed = (before & ~after).sum(), (~before & after).sum()
    return errors(recovered, before.sum(), 0.2), errors(failed, (~before).sum(), 0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "control"),
    [
        (GilbertElliott(share=SHARE, burst=BURST), {"burst": 5.5}),
        (GilbertElliott(share=1.125 * SHARE, burst=10.0, loss_bad=8 / 9), {"loss_bad": 0.91}),
    ],
)
def test_a_link_that_advances_by_messages_loses_its_share_in_bursts_of_the_mean_length(model, control):
    """With a loss h while bad, after a lost message the next is lost with probability h (1 - r): 0.8 in both cases, so
    that the mean burst of losses is 1 / (1 - h (1 - r)) = 5. The share of losses is h s = 0.2.

    A burst is geometric: mean 5, variance 5^2 - 5. Of 200 messages, bursts that begin in the first 100 are counted,
    so that none is cut short (0.8^100 = 2e-10); standard error sqrt(20 / bursts). The share is counted over links at a
    single message, the 200th, where they are independent. The control is a burst of 5.5.
    """
    for seed in SEEDS:
        lost = history(model, range(200), seed)
        assert abs(errors(lost[-1].sum(), LINKS, SHARE)) < 5
        assert abs(errors(lost[0].sum(), LINKS, SHARE)) < 5
        assert abs(bursts_off(lost)) < 5
        assert abs(bursts_off(history(model.model_copy(update=control), range(200), seed))) > 5


def bursts_off(lost):
    """Return how many standard errors the mean burst differs from 5."""
    padded = np.vstack([np.zeros((1, lost.shape[1]), bool), lost, np.zeros((1, lost.shape[1]), bool)]).astype(int)
    change = np.diff(padded, axis=0).T
    begins, ends = np.argwhere(change == 1), np.argwhere(change == -1)
    counted = (begins[:, 1] > 0) & (begins[:, 1] < 100)
    lengths = (ends - begins)[counted, 1]
    return (lengths.mean() - 5.0) / sqrt(20.0 / lengths.size)


@pytest.mark.slow
@pytest.mark.parametrize("advance", ["message", "time"])
def test_losses_in_either_state_have_their_mean_and_their_correlation(advance):
    """With s = 0.3, r = 0.25 and p = r s / (1 - s): the mean is m = 0.3 x 0.7 + 0.7 x 0.1 = 0.28, and both of two
    messages, k apart, are lost with m^2 + s (1 - s) (0.7 - 0.1)^2 c^k, c = 1 - p - r by message, exp(-p - r) in time.

    Binomial over 40 000 links, 3 seeds, within 5 standard errors; the control is another loss while bad.
    """
    model = GilbertElliott(share=0.3, burst=4.0, advance=advance, loss_good=0.1, loss_bad=0.7)
    rate = 0.25 / 0.7
    fading = 1.0 - rate if advance == "message" else exp(-rate)

    def off(model, seed):
        first, *others = history(model, range(4), seed, links=40_000)
        both = [
            errors((first & other).sum(), 40_000, 0.28**2 + 0.0756 * fading**k) for k, other in enumerate(others, 1)
        ]
        return max(map(abs, [errors(first.sum(), 40_000, 0.28), errors(others[-1].sum(), 40_000, 0.28), *both]))

    assert max(off(model, seed) for seed in SEEDS) < 5
    assert min(off(model.model_copy(update={"loss_bad": 0.8}), seed) for seed in SEEDS) > 5
    alone = model(context(links=40_000), np.random.default_rng(0))
    assert abs(errors(alone.sum(), 40_000, 0.28)) < 5


@pytest.mark.slow
def test_shares_differ_and_the_stationary_law_is_there_from_the_first_message_on():
    """The control is the share 10 % off."""
    for share in (0.05, 0.5, 0.8):
        lost = history(GilbertElliott(share=share, burst=8.0), range(20), 3, links=40_000)
        assert max(abs(errors(each.sum(), 40_000, share)) for each in lost) < 5
        assert min(abs(errors(each.sum(), 40_000, 1.1 * share)) for each in lost) > 2


def test_time_does_not_matter_to_a_link_that_advances_by_messages():
    model = GilbertElliott(share=SHARE, burst=BURST)
    assert (history(model, range(50), 1) == history(model, [0.0] * 50, 1)).all()


# Bursts as time goes by.

IN_TIME = GilbertElliott(share=SHARE, burst=2.0, advance="time")
"""r = 0.5 /s, p = 0.5 x 0.2 / 0.8 = 0.125 /s, so that the memory fades as exp(-0.625 t)."""


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 4, 16, 64])
def test_a_link_that_advances_in_time_forgets_exponentially(steps):
    """Sampled every 0.05 s: of the links that are bad, pi + (1 - pi) exp(-(p + r) k dt) are bad k samples later.

    So the autocorrelation at k dt is exp(-(p + r) k dt). Binomial over the bad ones of 40 000 links (of 10 000 for long
    times), 3 seeds, within 5
    standard errors, as is the share pi; also if nothing is asked in between. The control forgets 30 % faster.
    """
    links = 40_000 if steps < 16 else 10_000
    memory, faster = exp(-0.625 * 0.05 * steps), exp(-0.8125 * 0.05 * steps)
    fine, coarse = [0.05 * k for k in range(steps + 1)], [0.0, 0.05 * steps]
    for times in (fine, coarse):
        ends = [history(IN_TIME, times, seed, links=links)[[0, -1]] for seed in SEEDS]
        assert max(abs(errors(end.sum(), links, SHARE)) for pair in ends for end in pair) < 5
        counts = np.array([[(first & last).sum(), first.sum()] for first, last in ends])
        assert max(abs(errors(*count, SHARE + (1 - SHARE) * memory)) for count in counts) < 5
        assert abs(errors(*counts.sum(axis=0), SHARE + (1 - SHARE) * memory)) < 5
        assert abs(errors(*counts.sum(axis=0), SHARE + (1 - SHARE) * faster)) > 5


def test_the_state_of_a_link_to_one_node_fades_as_that_of_links_to_many():
    """1,200 links, each used alone, and all together: pi + (1 - pi) exp(-(p + r) t), and not pi, the control."""
    alone, rng, times = Bursts(IN_TIME), np.random.default_rng(3), [0.0, 2.0]
    one_by_one = [[alone.to_one(0, node, now, rng) for node in range(1, 1201)] for now in times]
    for first, last in (np.array(one_by_one), history(IN_TIME, times, 3, links=1200)):
        hits, trials = (first & last).sum(), first.sum()
        assert abs(errors(hits, trials, SHARE + (1.0 - SHARE) * exp(-0.625 * 2.0))) < 5
        assert abs(errors(hits, trials, SHARE)) > 5


@pytest.mark.whole
def test_a_burst_in_time_has_the_mean_duration():
    """Of links that are bad now exp(-r dt) + O(dt^2) are bad dt later: at dt = 1 ms the chance to recover is r dt.

    1 - pi_bad(dt | bad) = (1 - pi)(1 - exp(-(p + r) dt)) = 0.0004999; the sampled bursts last 2.0006 s on average.
    100 samples of 40 000 links, within 3 standard errors, binomial given the state before; the control is a burst of
    2.5 s.
    """
    lost = history(IN_TIME, [0.001 * k for k in range(100)], 5, links=40_000)
    recovered = (lost[:-1] & ~lost[1:]).sum()
    assert abs(errors(recovered, lost[:-1].sum(), 0.8 * (1 - exp(-0.000625)))) < 3
    assert abs(errors(recovered, lost[:-1].sum(), 0.001 / 2.5)) > 3


def test_within_an_instant_a_link_does_not_change():
    lost = history(IN_TIME, [1.0] * 20, 2)
    assert (lost == lost[0]).all()


@pytest.mark.slow
def test_after_a_long_time_a_link_has_forgotten_how_it_was():
    """exp(-0.625 x 100) is nothing: both bad with probability share^2, the standard error is binomial."""
    first, last = history(IN_TIME, [0.0, 100.0], 1, links=100_000)
    assert abs(errors((first & last).sum(), 100_000, SHARE**2)) < 5


# Bursts, link by link.


@pytest.mark.parametrize("model", [GilbertElliott(share=SHARE, burst=50.0), IN_TIME])
def test_links_are_independent_of_each_other_also_the_two_ways(model):
    """Both of two links are bad with probability share^2, binomial over 4000 pairs of links to different receivers and
    1000 pairs there and back; the control is each link with itself.
    """
    run, rng = model.start_run(8001), np.random.default_rng(4)
    for now in (0.0, 0.01):
        out = run(LinkContext(0, np.arange(1, 8001), now=now), rng)
        back = np.array([run(LinkContext(node, np.array([0]), now=now), rng) for node in range(1, 1001)])
    assert abs(errors((out[:4000] & out[4000:]).sum(), 4000, SHARE**2)) < 5
    assert abs(errors((out[:1000] & back).sum(), 1000, SHARE**2)) < 5
    assert errors((out[:1000] & out[:1000]).sum(), 1000, SHARE**2) > 5


def test_a_link_remembers_across_broadcasts_and_single_messages():
    """With a burst of 10^6 messages a link stays as it is, whichever other links are used."""
    run, rng = GilbertElliott(share=0.5, burst=1e6).start_run(101), np.random.default_rng(0)
    first = run(context(links=100), rng)
    assert 20 < first.sum() < 80
    assert (run(LinkContext(0, np.arange(51, 101)), rng) == first[50:]).all()
    assert [run(LinkContext(0, np.array([node])), rng) for node in range(1, 101)] == first.tolist()


def test_links_used_later_are_independent_of_earlier_ones_and_leave_them_unchanged():
    """With a burst of 10^6 messages: first every third of 100 nodes, then from the far end all."""
    run, rng = GilbertElliott(share=0.5, burst=1e6).start_run(101), np.random.default_rng(0)
    first = run(LinkContext(0, np.arange(1, 101, 3)), rng)
    assert 5 < first.sum() < 29
    then = run(LinkContext(0, np.arange(100, 0, -1)), rng)[::-1]
    assert (then[::3] == first).all()
    assert (run(LinkContext(0, np.arange(1, 101)), rng) == then).all()
    assert 5 < (then[1::3] & ~then[2::3]).sum() < 15


def test_only_links_that_are_used_take_room():
    """A hundred of a million nodes to twenty others each: three arrays of 21 numbers a sender, not of a million."""
    tracemalloc.start()
    run, rng = GilbertElliott().start_run(10**6), np.random.default_rng(0)
    for node in range(100):
        run(LinkContext(node, np.arange(200, 220)), rng)
    assert tracemalloc.get_traced_memory()[1] < 500_000
    tracemalloc.stop()


def test_every_run_starts_with_fresh_state_and_leaves_the_model_unchanged():
    model = GilbertElliott(share=SHARE, burst=BURST)
    assert (history(model, range(5), 1) == history(model, range(5), 1)).all()
    assert model == GilbertElliott(share=SHARE, burst=BURST)


def test_a_model_without_a_run_has_the_stationary_law_and_no_memory():
    """Within 5 standard errors of a binomial; the control is a share 3 % off."""
    lost = GilbertElliott(share=SHARE, burst=BURST)(context(links=10**6), np.random.default_rng(0)).sum()
    assert abs(errors(lost, 10**6, SHARE)) < 5
    assert abs(errors(lost, 10**6, 1.03 * SHARE)) > 5


@pytest.mark.parametrize("advance", ["message", "time"])
def test_no_share_loses_nothing(advance):
    assert not history(GilbertElliott(share=0.0, burst=3.0, advance=advance), range(20), 0).any()


def test_a_burst_of_one_message_is_always_followed_by_a_good_one():
    lost = history(GilbertElliott(share=0.3, burst=1.0), range(30), 0)
    assert lost.any()
    assert not (lost[1:] & lost[:-1]).any()


@pytest.mark.parametrize(("share", "burst", "least"), [(0.1, 0.9, "1"), (0.8, 3.9, "4"), (0.9, 8.5, "9")])
def test_bursts_that_are_too_short_for_their_share_are_refused(share, burst, least):
    """p = share / (1 - share) / burst is a probability, so burst >= share / (1 - share); in time it is a rate."""
    with pytest.raises(KeyedError, match=rf"burst should be at least {least} messages .* \(got {burst:g}\)"):
        GilbertElliott(share=share, burst=burst)
    assert GilbertElliott(share=share, burst=float(least) + 1e-9)
    assert GilbertElliott(share=share, burst=burst, advance="time")


# Losses of netem.


@pytest.mark.slow
def test_correlated_numbers_have_the_mean_the_variance_and_the_correlation_of_a_moving_average():
    """With c = 0.25: 1/2, (1 - c) / (1 + c) / 12 = 0.05 and c, in units of 2^32.

    Over 150 000 links at their 30th message, where c^30 is nothing, and 31st: within 3 standard errors, of the mean
    sqrt(0.05 / n), of the variance by the fourth moment, of the correlation (1 - c^2) / sqrt(n). The control is
    c = 0.26.
    """

    def off(correlation):
        numbers, rng, links = CorrelatedNumbers(correlation), np.random.default_rng(3), 150_000
        *_, x, y = (numbers(context(links=links), rng) / RANGE for _ in range(31))
        about, between = (x - 0.5) ** 2, np.corrcoef(x, y)[0, 1]
        return (
            (x.mean() - 0.5) / sqrt(0.05 / links),
            (about.mean() - 0.05) / (about.std() / sqrt(links)),
            (between - 0.25) / ((1 - 0.25**2) / sqrt(links)),
        )

    assert max(map(abs, off(0.25))) < 3
    assert min(map(abs, off(0.26)[1:])) > 3


def test_a_number_is_the_one_that_linux_computes_from_the_same_random_numbers():
    """get_crandom in integers of any length, link by link; the first last number of a link is a random one."""
    correlation, nodes = 0.25, [1, 2, 3]
    numbers, rng, plain = CorrelatedNumbers(correlation), np.random.default_rng(5), np.random.default_rng(5)
    last, rho = {}, round(correlation * (2**32 - 1)) + 1
    for receivers in ([1, 2, 3], [2], [3, 1], [1, 2, 3]):
        found = numbers(LinkContext(0, np.array(receivers)), rng).tolist()
        new = [int(each) for each in plain.integers(2**32, size=len(receivers), dtype=np.uint64)]
        if not last:
            last = dict(zip(nodes, map(int, plain.integers(2**32, size=3, dtype=np.uint64)), strict=True))
        for node, value in zip(receivers, new, strict=True):
            last[node] = (value * (2**32 - rho) + last[node] * rho) >> 32
        assert found == [last[node] for node in receivers]


def below(limit, c):
    """Return the probability that the moving average X = (1 - c) U + c X is at most a limit.

    Its distribution F(x) = int_0^1 F((x - (1 - c) u) / c) du is the limit of an iteration, here with 2000 steps.
    """
    x, u = np.linspace(0.0, 1.0, 1001), (np.arange(2000) + 0.5) / 2000
    law = x
    for _ in range(8):
        law = np.array([np.interp((each - (1.0 - c) * u) / c, x, law).mean() for each in x])
    return np.interp(limit, x, law)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize(("p", "correlation", "share"), [(0.1, 0.25, 0.0175), (0.3, 0.25, 0.233), (0.3, 0.5, 0.129)])
def test_correlated_losses_are_fewer_than_nominal_and_follow_each_other(p, correlation, share):
    """`loss random 10% 25%` loses 1.75 % in the long run.

    100 000 links at their 30th message, within 3 standard errors of a binomial; the control is the nominal share.
    """
    before, lost = history(Correlated(p=p, correlation=correlation), range(30), 2, links=100_000)[-2:]
    theory = below(p, correlation)
    assert theory == pytest.approx(share, rel=0.005)
    assert abs(errors(lost.sum(), 100_000, theory)) < 3
    assert abs(errors(lost.sum(), 100_000, p)) > 3
    assert errors((before & lost).sum(), 100_000, theory**2) > 3


def test_losses_without_correlation_are_those_of_bernoulli_and_p_0_loses_nothing():
    lost = Correlated(p=0.3, correlation=0.0)(context(links=10**5), np.random.default_rng(0))
    assert abs(errors(lost.sum(), 10**5, 0.3)) < 3
    assert not np.any(history(Correlated(p=0.0), range(3), 0))


def test_a_subclass_may_draw_in_a_run_as_without_state():
    class Fresh(Correlated):
        def start_run(self, size):
            return self

    model, drawn = Correlated(p=0.3, correlation=0.2), [np.random.default_rng(0) for _ in range(2)]
    fresh = Fresh(p=0.3, correlation=0.2).start_run(2)
    assert np.array_equal(fresh(context(links=9), drawn[0]), model(context(links=9), drawn[1]))


FOUR = FourState(p13=0.05, p31=0.3, p32=0.2, p23=0.4, p14=0.02)


def test_the_four_states_lose_their_share_and_follow_each_other_as_in_the_chain():
    """With q = 1/6: 1 + q + q/2 + 0.02 = 1.27; lost (q + 0.02) / 1.27; after a loss, only state 3 loses again, so the
    next is lost, too, with probability q (1 - 0.3 - 0.2) / 1.27.

    20 000 links at their first, second and 10th messages, 3 standard errors of a binomial; the control is p32 = 0.3.
    """
    q = 1 / 6
    np.testing.assert_allclose(FOUR.stationary(), np.array([1.0, q / 2, q, 0.02]) / 1.27, rtol=1e-12)

    def off(model):
        lost = history(model, range(10), 4, links=20_000)
        share, both = (q + 0.02) / 1.27, q * 0.5 / 1.27
        return [
            *(errors(lost[k].sum(), 20_000, share) for k in (0, 1, 9)),
            *(errors((lost[k] & lost[k + 1]).sum(), 20_000, both) for k in (0, 8)),
        ]

    assert max(map(abs, off(FOUR))) < 3
    assert max(map(abs, off(FOUR.model_copy(update={"p32": 0.3})))) > 3
    assert abs(errors(FOUR(context(links=20_000), np.random.default_rng(0)).sum(), 20_000, (q + 0.02) / 1.27)) < 3


@pytest.mark.slow
def test_without_the_states_2_and_4_the_chain_is_that_of_gilbert():
    """p13 = 0.05 and p31 = 0.2 are a share of 0.2 and bursts of 5: 3 standard errors; the control is p31 = 0.22."""
    lost = history(FourState(p13=0.05, p31=0.2, p32=0.0, p14=0.0), range(200), 3)
    assert abs(errors(lost[-1].sum(), LINKS, SHARE)) < 3
    assert abs(bursts_off(lost)) < 3
    assert abs(bursts_off(history(FourState(p13=0.05, p31=0.22, p32=0.0, p14=0.0), range(200), 3))) > 3


@pytest.mark.parametrize("given", [{"p13": 0.6, "p14": 0.5}, {"p31": 0.6, "p32": 0.5}])
def test_transitions_of_the_four_states_that_exceed_1_together_are_refused(given):
    first, second = given
    with pytest.raises(KeyedError, match=rf"{first} \+ {second} should be at most 1 \(got 1.1\)"):
        FourState(**given)


# Distance.


def test_loss_by_distance_rises_from_near_to_far():
    """0.1 + 0.8 (d / 10)^2: 0.1 at 0 m, 0.3 at 5 m, 0.9 at 10 m and beyond; linear with exponent 1."""
    d = np.array([0.0, 5.0, 10.0, 25.0])
    assert ByDistance(near=0.1, far=0.9).probability(d).tolist() == pytest.approx([0.1, 0.3, 0.9, 0.9])
    assert ByDistance(near=0.1, far=0.9, exponent=1.0).probability(d)[1] == pytest.approx(0.5)


@pytest.mark.slow
def test_losses_by_distance_have_their_probability():
    """25 000 receivers each at 2, 4, 6 and 8 m, 3 seeds, within 5 standard errors; the control is 5 % off."""
    radius = np.repeat([2.0, 4.0, 6.0, 8.0], 25_000)
    angle = np.random.default_rng(0).uniform(0.0, 7.0, radius.size)
    at = np.vstack([[0.0, 0.0], np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])])
    rings = LinkContext(0, np.arange(1, radius.size + 1), positions=lambda: at)
    theory = [0.05 + 0.75 * (d / 10.0) ** 3 for d in (2.0, 4.0, 6.0, 8.0)]

    def off(model, seed):
        lost = model(rings, np.random.default_rng(seed)).reshape(4, -1).sum(axis=1)
        return [abs(errors(count, 25_000, p)) for count, p in zip(lost, theory, strict=True)]

    right = ByDistance(near=0.05, far=0.8, distance=10.0, exponent=3.0)
    wrong = ByDistance(near=0.05, far=0.8, distance=9.5, exponent=3.0)
    assert max(max(off(right, seed)) for seed in SEEDS) < 5
    assert min(max(off(wrong, seed)) for seed in SEEDS) > 5


def test_loss_by_distance_needs_positions():
    with pytest.raises(ValueError, match="needs the positions of the nodes"):
        ByDistance()(context(), np.random.default_rng(0))
