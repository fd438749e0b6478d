"""Records: what each node reads, counted against a plain model that keeps a table per node and delivers one by one."""

import random
from types import SimpleNamespace

import pytest

from desim.kernel.core.records import Record
from desim.kernel.state.received_records import Records, SharedTable

HISTORIES = 1000


class Plain:
    """A table per node; each arrival is delivered on its own, in the order of time."""

    def __init__(self, size):
        self.tables = [{} for _ in range(size)]
        self.flying = []

    def deliver(self, now):
        self.flying.sort(key=lambda each: each[0])
        while self.flying and self.flying[0][0] <= now:
            self.put(*self.flying.pop(0))

    def put(self, when, node, record):
        known = self.tables[node].get(record.src)
        if node != record.src and (known is None or known[1].seq < record.seq):
            self.tables[node][record.src] = (when, record)


def differs(seed, relays):
    """Return whether the records of a random history differ from those of the plain model."""
    rng, clock = random.Random(seed), SimpleNamespace(now=0)
    size = rng.choice([1, 2, 3, 3, 4, 5, 6, 7])
    records, plain = Records(clock, size, is_even), Plain(size)
    sent, undecided, numbers = [], [], [0] * size
    for _ in range(rng.randint(5, 60)):
        clock.now += rng.choice([0, 0, 1, 2])
        for landing in [each for each in undecided if each[0] <= clock.now]:
            undecided.remove(landing)
            _, record, others, is_simultaneous = landing
            reached = [node for node in others if rng.random() < 0.7]
            unreached = set(others).difference(reached)
            if is_simultaneous and not records.share(record, len(others), clock.now, unreached):
                records.insert(reached, record)
            elif not is_simultaneous:
                records.receive(reached, [clock.now] * len(reached), [record] * len(reached))
            plain.flying += [(clock.now, node, record) for node in reached]
        plain.deliver(clock.now)
        act, node = rng.choice("ppppplrruuifgb"), rng.randrange(size)
        others = [other for other in range(size) if other != node]
        if act in "pul":
            numbers[node] += 1
            record = Record(node, numbers[node], clock.now, rng.randrange(100))
            sent.append(record)
            if act == "l":
                undecided.append((clock.now + rng.randint(0, 5), record, others, rng.random() < 0.6))
                continue
            reached = [other for other in others if rng.random() < 0.75]
            times = [clock.now + rng.randint(0, 5) for _ in reached]
            if act == "p":
                times = [clock.now + 3] * len(reached)
            arrival = clock.now + 3 if act == "p" else times
            records.schedule(record, reached, arrival, [other for other in others if other not in reached])
            plain.flying += zip(times, reached, [record] * len(reached), strict=True)
            plain.deliver(clock.now)
        elif act == "i":
            belief = Record(node, 0, clock.now, rng.randrange(100))
            records.set_initial_belief(belief)
            for other in others:
                plain.tables[other].setdefault(node, (clock.now, belief))
        elif act == "f":
            records.forget(node)
            plain.tables[node].clear()
        elif act == "b" and relays and sent and (record := rng.choice(sent)).src != node:
            if records.is_news(node, record):
                records.relay(node, record)
            plain.put(clock.now, node, record)
        elif act == "g" and records.in_flight() != sum(when > clock.now for when, _, _ in plain.flying):
            return True
        elif act == "r":
            known = plain.tables[node]
            matches = {src: each for src, each in known.items() if is_even(each[1].body)}
            if records.latest_records(node) != known or records.matching(node) != matches:
                return True
    return False


def is_even(body):
    return body % 2 == 0


@pytest.mark.slow
@pytest.mark.parametrize("relays", [False, True])
def test_each_node_reads_what_a_plain_model_delivers_one_by_one(relays):
    """Broadcasts miss nodes, overtake others or are decided late; nodes lose their memory, or are told by relays."""
    assert [seed for seed in range(HISTORIES) if differs(seed, relays)] == []


@pytest.mark.parametrize("broken", ["_except", "forget", "unreached"])
def test_the_comparison_detects_exceptions_that_are_overlooked(broken, monkeypatch):
    """The control."""
    monkeypatch.setattr(SharedTable, broken, lambda *_: 0)
    assert any(differs(seed, relays=False) for seed in range(HISTORIES))


@pytest.mark.parametrize("way", ["insert", "receive"])
def test_a_late_record_that_is_stored_does_not_replace_a_newer_one(way):
    """Also if both arrive between two readings."""
    for reads in (False, True):
        clock = SimpleNamespace(now=0)
        records = Records(clock, 2, None)
        for seq in (2, 1):
            record = Record(0, seq, 0, seq)
            records.insert([1], record) if way == "insert" else records.receive([1], [clock.now], [record])
            clock.now += 1
            assert not reads or records.latest_records(1)[0][1].seq == 2
        assert records.latest_records(1)[0][1].seq == 2
