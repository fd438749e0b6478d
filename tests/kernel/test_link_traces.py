"""Messages under measured latencies and losses, against the table itself."""

from fractions import Fraction
from math import exp, sqrt

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import LatencyTrace, LossTrace, SignalTrace
from desim.kernel.core.clock import Clock, Instant, Phase
from desim.kernel.core.events import LOST, Sent, Trace
from desim.kernel.core.link_context import LinkContext
from desim.kernel.core.units import SECOND
from desim.kernel.link_layer.propagation import LinkSampler
from desim.kernel.measured.playback import TraceEndError
from desim.kernel.models.access import CsmaCa
from desim.kernel.models.graphs import Link
from desim.kernel.models.latency import Constant, mean_latency
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate
from desim.kernel.network import Network

STEPS = "t,value\n10,0.1\n11,0.3\n13,0.2\n"
"""Measured at 0, 1 and 3 s; it ends at 4.5 s."""
PAIR = LinkContext(0, np.array([1]))


def latency(trace, now, src=0, dst=1, seed=0):
    """Return the latency of a message, s, from the model of a run."""
    return np.ravel(trace.start_run(2)(LinkContext(src, np.array([dst]), now, seed=seed), None))[0]


def sent(links, messages, size=2, graph=None, seed=0):
    """Return the arrival of each message (time in ns, src, dst), ns, or `LOST`, and the counts."""
    clock, trace = Clock(), Trace()
    network = Network(clock, graph or nx.complete_graph(size), links, trace=trace, seed=seed)
    for number, (time, src, dst) in enumerate(messages):
        event = Instant(clock, time, Phase.DECISION)
        event.callbacks.append(lambda _, src=src, dst=dst, number=number: network.send(src, dst, number))
    clock.run()
    return {each.body: each.arrival for each in trace.of(Sent)}, network.message_counts()


@pytest.mark.parametrize(
    ("between", "after", "expected"),
    [
        ("hold", "repeat", {0: 0.1, 0.999: 0.1, 1: 0.3, 2: 0.3, 3: 0.2, 4.499: 0.2, 4.5: 0.1, 5.5: 0.3, 94.5: 0.1}),
        ("linear", "repeat", {0: 0.1, 0.5: 0.2, 1: 0.3, 2: 0.25, 3: 0.2, 3.75: 0.15, 4.5: 0.1, 8.25: 0.15}),
        ("hold", "hold", {2: 0.3, 3: 0.2, 4.5: 0.2, 1e6: 0.2}),
        ("linear", "hold", {2: 0.25, 3: 0.2, 3.75: 0.2, 1e6: 0.2}),
        ("hold", "error", {2: 0.3, 4.499: 0.2}),
    ],
)
def test_the_latency_is_that_of_the_row_at_the_time_of_the_simulation(between, after, expected):
    """The table is measured from 10 s on; linear repetition interpolates from the last row to the first."""
    trace = LatencyTrace(table=STEPS, between=between, after=after)
    assert {now: latency(trace, now) for now in expected} == pytest.approx(expected, abs=1e-12)


def test_after_the_end_of_the_trace_a_message_is_an_error():
    trace = LatencyTrace(table=STEPS, after="error", start=1.0, read_from="rtt.csv")
    assert latency(trace, 3.499) == 0.2
    where = r"rtt\.csv ends at 4\.5 s, but a message on the link from 0 to 1 is sent at 3\.5 s, at 4\.5 s of the trace"
    with pytest.raises(TraceEndError, match=where):
        latency(trace, 3.5)


def test_a_message_arrives_exactly_after_the_latency_of_its_row():
    """To the nanosecond, also for times since 1970 and for half a round trip."""
    table = "t,rtt\n1700000000.1,40.2\n1700000000.3,60.4\n1700000000.4,\n1700000000.7,81\n"
    trace = LatencyTrace(table=table, value="rtt", unit="ms", rtt=True)
    at = [0, 199_999_999, 200_000_000, 299_999_999, 300_000_000, 599_999_999, 600_000_000, 800_000_000]
    arrivals, counts = sent(Links(latency=trace), [(time, 0, 1) for time in at])
    taken = [20_100_000, 20_100_000, 30_200_000, 30_200_000, LOST, LOST, 40_500_000, 20_100_000]
    assert list(arrivals.values()) == [
        each if each == LOST else time + each for time, each in zip(at, taken, strict=True)
    ]
    assert counts.lost_by == {"loss": 2}
    assert (counts.sent, counts.delivered, counts.in_flight) == (8, 5, 1)


def test_a_number_at_the_start_shifts_the_trace():
    trace = LatencyTrace(table=STEPS, start=2.5)
    assert [latency(trace, now) for now in (0.0, 0.5, 2.0, 3.0)] == [0.3, 0.2, 0.1, 0.3]


def test_each_link_has_rows_of_its_own():
    table = "t,src,dst,value\n0,0,1,0.1\n0,1,0,0.2\n0.5,0,2,0.3\n1,0,1,0.4\n"
    run = LatencyTrace(table=table).start_run(3)
    assert run(LinkContext(0, np.array([1, 2]), 0.2), None).tolist() == [0.1, 0.3]
    assert run(LinkContext(0, np.array([2, 1]), 1.2), None).tolist() == [0.3, 0.4]
    assert run(LinkContext(1, np.array([0]), 1.2), None).tolist() == [0.2]
    with pytest.raises(ValueError, match="the table has no row for the link from 2 to 1"):
        run(LinkContext(2, np.array([1, 0]), 0.2), None)


@pytest.mark.parametrize(("after", "first"), [("repeat", 0.3), ("hold", 0.2)])
def test_before_its_first_row_a_link_has_its_last_value_if_the_trace_repeats(after, first):
    table = "t,src,dst,value\n0,0,1,0.1\n0.5,0,2,0.2\n0.8,0,2,0.3\n"
    trace = LatencyTrace(table=table, after=after)
    assert [latency(trace, now, 0, 2) for now in (0.2, 0.5, 0.9)] == [first, 0.2, 0.3]


def test_receivers_that_stay_the_same_have_the_latencies_of_each_time_and_sender():
    """A network keeps the array of the receivers of a broadcast."""
    table = "t,src,dst,value\n0,0,2,0.1\n0,1,2,0.2\n1,0,2,0.3\n1,1,2,0.4\n"
    run, receivers = LatencyTrace(table=table).start_run(3), np.array([2])
    receivers.setflags(write=False)
    contexts = [LinkContext(src, receivers, now) for now in (0.0, 1.0, 0.0) for src in (0, 1)]
    assert [run(context, None).item() for context in contexts] == [0.1, 0.2, 0.3, 0.4, 0.1, 0.2]


def test_rows_of_both_ways_hold_for_the_way_back():
    trace = LatencyTrace(table="t,src,dst,value\n0,0,1,0.1\n1,0,1,0.4\n", both_ways=True)
    assert [latency(trace, now, *way) for now in (0.0, 1.0) for way in ((0, 1), (1, 0))] == [0.1, 0.1, 0.4, 0.4]


# Against a reference that reads the table for each message.


def reference(rows, now, between, after, end):
    """Return the latency of a message, us, or None if it is lost; rows are (us, us or None), and times are us."""
    now = now % end if after == "repeat" else min(now, end)
    around = [(time - end, value) for time, value in rows] if after == "repeat" else [(-1, rows[0][1])]
    later = [(time + end, value) for time, value in rows] if after == "repeat" else []
    earlier = [row for row in [*around, *rows] if row[0] <= now]
    following = [row for row in [*rows, *later] if row[0] > now]
    (begin, value), (until, other) = earlier[-1], following[0] if following else (now + 1, None)
    if value is None or between == "hold" or other is None or (begin < 0 and after == "hold"):
        return value
    return value + Fraction(now - begin, until - begin) * (other - value)


US = SECOND // 10**6
OPTIONS = {
    "between": st.sampled_from(["hold", "linear"]),
    "after": st.sampled_from(["repeat", "hold"]),
    "start": st.sampled_from([0.0, 0.75e-3, 1.0]),
}
LINK_ROWS = st.dictionaries(st.integers(0, 40), st.one_of(st.none(), st.integers(0, 9)), min_size=1, max_size=6)


@pytest.mark.slow
@given(
    rows=st.one_of(
        st.fixed_dictionaries(dict.fromkeys(((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1)), LINK_ROWS)),
        st.fixed_dictionaries({None: LINK_ROWS}),
    ),
    messages=st.lists(st.tuples(st.integers(0, 200), st.integers(0, 2), st.integers(1, 2)), max_size=12),
    options=st.fixed_dictionaries(OPTIONS),
)
def test_messages_arrive_as_the_reference_says(rows, messages, options):
    """Rows and messages at multiples of 50 us, latencies of 0 to 900 us; in linear parts within 1 ns."""
    ways = {way: sorted((50 * time, value) for time, value in own.items()) for way, own in rows.items()}
    first = min(time for own in ways.values() for time, _ in own)
    lines = [
        f"{time},{'' if way is None else f'{way[0]},{way[1]},'}{'' if value is None else 100 * value}"
        for way, own in ways.items()
        for time, value in own
    ]
    header = "t,value" if None in ways else "t,src,dst,value"
    trace = LatencyTrace(table="\n".join([header, *lines]), unit="us", time_unit="us", **options)
    end, start = Fraction(trace.measurements.end, US), round(options["start"] * 10**6)
    messages = [(50 * US * time, src, (src + step) % 3) for time, src, step in messages]
    arrivals, _ = sent(Links(latency=trace), messages, 3)
    for number, (now, src, dst) in enumerate(messages):
        own = [
            (time - first, None if value is None else 100 * value)
            for time, value in ways.get((src, dst), ways.get(None))
        ]
        taken = reference(own, Fraction(now, US) + start, options["between"], options["after"], end)
        if taken is None:
            assert arrivals[number] == LOST
        else:
            assert abs(arrivals[number] - now - taken * US) <= (0 if options["between"] == "hold" else 1)


# The start.


def test_the_start_is_random_by_seed_and_the_same_for_all_links_and_traces():
    table = "t,src,dst,value\n" + "".join(
        f"{k},{src},{dst},{k / 100 + 0.001 * src}\n" for src, dst in ((0, 1), (1, 0)) for k in range(100)
    )
    trace = LatencyTrace(table=table, start="random")
    seeds = range(20)
    starts = [latency(trace, 0.0, seed=seed) for seed in seeds]
    assert starts == [latency(trace, 0.0, seed=seed) for seed in seeds]
    assert len(set(starts)) > 15
    assert [latency(trace, 0.0, 1, 0, seed) for seed in seeds] == pytest.approx([each + 0.001 for each in starts])
    other = LatencyTrace(table="t,value\n" + "".join(f"{k / 10},{k / 100}\n" for k in range(100)), start="random")
    assert [latency(other, 0.0, seed=seed) for seed in seeds] == starts


def test_the_mean_over_random_starts_is_the_mean_over_time():
    """Values .1, .5 and .2 s for 1, 6 and 3.5 s: mean .3619 s over time; the control is that of the rows, .2667 s.

    Over 400 seeds, within 3 standard errors. The standard deviation is .156 s, so the standard error is .0078 s.
    """
    trace = LatencyTrace(table="t,value\n0,0.1\n1,0.5\n7,0.2\n", start="random")
    found = np.array([latency(trace, 2.0, seed=seed) for seed in range(400)])
    weighted, error = (0.1 * 1 + 0.5 * 6 + 0.2 * 3.5) / 10.5, found.std() / sqrt(len(found))
    assert abs(found.mean() - weighted) < 3 * error
    assert abs(found.mean() - (0.1 + 0.5 + 0.2) / 3) > 5 * error
    assert mean_latency(trace) == pytest.approx(weighted)
    assert mean_latency(trace.model_copy(update={"table": "t,value\n0,0.1\n1,\n7,0.2\n"})) == pytest.approx(0.8 / 4.5)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"after": "hold", "start": 1.0}, {"after": "error"}])
def test_the_typical_latency_is_a_mean_over_the_trace(options):
    """It is estimated from draws at 2002 times that are spread evenly, so within .001 s."""
    trace = LatencyTrace(table="t,value\n0,0.9\n1,0.1\n5,\n6,0.4\n7,0.4\n8,0.4\n", **options)
    begin, end = (1.0, 9.6) if "start" in options else (0.0, 9.6)
    theory = (0.9 * (1 - begin) + 0.1 * 5 + 0.4 * 3.6) / (end - begin)  # while it is missing, that before
    found = LinkSampler(Links(latency=trace), nx.complete_graph(2), 3, None).typical_latency()
    assert found == pytest.approx(theory, abs=1e-3)
    processing = Links(latency=trace, link=(Link(src=0, dst=1, both_ways=True, latency=Constant(value=0.25)),))
    assert LinkSampler(processing, nx.complete_graph(2), 3, None).typical_latency() == pytest.approx(0.25)


# Losses.


def lost(model, now, seed=0, count=20_000):
    context = LinkContext(0, np.arange(1, count + 1), now)
    return np.broadcast_to(model.start_run(count)(context, np.random.default_rng(seed)), count)


@pytest.mark.parametrize(
    ("model", "now", "p"),
    [
        (LossTrace(table="t,value\n0,0.3\n1,0.7\n"), 0.9, 0.3),
        (LossTrace(table="t,value\n0,0.3\n1,0.7\n", between="linear"), 0.5, 0.5),
        (SignalTrace(table="t,value\n0,-92\n1,-88\n", width=2.0), 0.0, 1 / (1 + exp(-1))),
        (SignalTrace(table="t,value\n0,-92\n1,-88\n", width=2.0, between="linear"), 0.75, 1 / (1 + exp(0.5))),
    ],
)
def test_a_message_is_lost_with_the_probability_of_its_row(model, now, p):
    """20 000 messages, 5 seeds: each within 3 standard errors of p, and more than 5 from 0.9 p."""
    shares = np.array([lost(model, now, seed).mean() for seed in range(5)])
    error = sqrt(p * (1 - p) / 20_000)
    assert (np.abs(shares - p) < 3 * error).all()
    assert (np.abs(shares - 0.9 * p) > 5 * error).all()


def test_certain_losses_need_no_random_numbers():
    for model in (
        LossTrace(table="t,value\n0,0\n1,1\n2,\n3,0\n"),
        SignalTrace(table="t,value\n0,-90\n1,-90.1\n2,\n3,-20\n"),
        SignalTrace(table="t,value\n0,999\n1,-999\n2,\n3,999\n", threshold=0.0, width=0.001),
    ):
        assert [set(lost(model, now).tolist()) for now in range(4)] == [{False}, {True}, {True}, {False}]


def test_losses_follow_their_link_and_the_draws_of_other_links_do_not_change():
    rows = "t,src,dst,value\n0,0,1,0.5\n0,0,2,0.5\n1,0,1,1\n1,0,2,0.5\n"
    run = LossTrace(table=rows).start_run(3)
    both, alone = (np.random.default_rng(4) for _ in range(2))
    for now in (0.0, 1.0):
        found = np.array([run(LinkContext(0, np.array([1, 2]), now), both) for _ in range(100)])
        assert found[:, 1].tolist() == [(alone.random(2) < 0.5)[1] for _ in range(100)]
        assert found[:, 0].all() == (now == 1.0)


def test_a_missing_latency_is_lost_beside_other_losses_and_on_links_of_their_own():
    """Node 0 has its own latency to node 2, which loses from 1 s on; the others lose until then."""
    until, later = LatencyTrace(table="t,value\n0,\n1,0.1\n"), LatencyTrace(table="t,value\n0,0.1\n1,\n")
    links = Links(latency=until, link=(Link(src=0, dst=2, latency=later), Link(src=1, dst=2, latency=Constant())))
    messages = [(k * SECOND, src, dst) for k in (0, 1) for src, dst in ((0, 1), (0, 2), (1, 2))]
    arrivals, counts = sent(links, messages, 3)
    assert [arrivals[k] == LOST for k in range(6)] == [True, False, False, False, True, False]
    assert counts.lost_by == {"loss": 2}
    certain = links.model_copy(update={"loss": LossTrace(table="t,value\n0,0\n1,1\n")})
    arrivals, _ = sent(certain, messages, 3)
    assert [arrivals[k] == LOST for k in range(6)] == [True, False, False, True, True, True]


def test_a_broadcast_reaches_those_whose_latency_is_not_missing():
    clock = Clock()
    table = "t,src,dst,value\n0,0,1,\n0,0,2,0.1\n0,1,0,\n0,1,2,\n0,2,0,\n0,2,1,\n"
    network = Network(clock, nx.complete_graph(3), Links(latency=LatencyTrace(table=table)))
    network.publish(0, "here")
    Instant(clock, SECOND, Phase.SAMPLE)
    clock.run()
    assert [0 in network.latest_records(node) for node in (1, 2)] == [False, True]
    assert network.message_counts()[1:4] == (2, 1, 1)


def test_a_message_that_is_acknowledged_is_transmitted_again_while_its_latency_is_missing():
    """The first attempt is at about 0 s and the second, with the value of the next row, 1 ms later at the earliest."""
    medium = Bitrate(bitrate=24 * 8 * 1000.0, access=CsmaCa())
    for missing, expected in (("0.0005", {}), ("10", {"loss": 1})):
        trace = LatencyTrace(table=f"t,value\n0,\n{missing},0.1\n", after="hold")
        _, counts = sent(Links(latency=trace, medium=medium), [(0, 0, 1)])
        assert counts.lost_by == expected


def test_a_table_names_the_nodes_in_its_order_or_in_that_of_nodes():
    table = "t,src,dst,value\n0,b,a,0.1\n0,a,b,0.1\n"
    for nodes, names in ((None, ("b", "a")), (("a", "b"), ("a", "b"))):
        assert Links(latency=LatencyTrace(table=table, nodes=nodes)).node_names == names
    assert Links(latency=LatencyTrace(table="t,value\n0,0.1\n")).node_names == ()


@pytest.mark.parametrize(("key", "counts"), [("loss", (1, 1)), ("duplicate", (3, 0))])
def test_the_graph_numbers_the_nodes_of_a_table(key, counts):
    """In the order of the table, a would be 0; every message from a to b is lost, or has a copy."""
    links = Links(graph=nx.complete_graph(["b", "a"]), **{key: LossTrace(table="t,src,dst,value\n0,a,b,1\n0,b,a,0\n")})
    assert dict(links)[key].nodes == ("b", "a")
    _, total = sent(links, [(0, 1, 0), (0, 0, 1)], graph=links.make_graph(2))
    assert (total.delivered, total.lost) == counts


def test_a_cell_in_quotes_has_a_space_between_its_lines():
    """As in long names of columns of spreadsheets; the lines of a number were joined."""
    table = '"t","latency\n(s)"\r\n0,0.1\r\n1,{}\r\n'
    model = LatencyTrace(table=table.format('"2"'), value="latency (s)")
    assert model.measurements.values.tolist() == [0.1, 2.0]
    with pytest.raises(ValueError, match=r"'2 0' is not a number"):
        LatencyTrace(table=table.format('"2\n0"'), value="latency (s)")
