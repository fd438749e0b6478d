"""The ends of the processes of a run: what they do in `finally` belongs to the run."""

import gc
import sys

import pytest

from desim import Crash, Recording, Scenario, Team, run
from protocols.rule import Rule


def brief(protocol, **more):
    return Scenario(team=Team(count=3), horizon=0.3, protocol=protocol, **more)


def test_the_finally_of_each_process_runs_before_the_run_returns_in_the_order_of_the_pursuers():
    ended = []

    def protocol(me):
        try:
            while True:
                yield me.sleep(0.1 * (3 - me.id))
        finally:
            ended.append((me.id, round(me.now, 9)))

    for _ in range(2):
        run(brief(protocol), 1)
    assert ended == [(0, 0.3), (1, 0.3), (2, 0.3)] * 2


def test_a_file_that_a_protocol_writes_is_complete_after_the_run(tmp_path):
    def protocol(me):
        with (tmp_path / f"{me.id}.csv").open("w") as log:
            while True:
                log.write(f"{me.now}\n")
                yield me.sleep(0.1)

    run(brief(protocol), 1)
    assert [len((tmp_path / f"{k}.csv").read_text().splitlines()) for k in range(3)] == [3, 3, 3]


TURNS = []


class Counting(Rule):
    """A rule that tells how many turns it had."""

    def actions(self, me):
        turns = 0
        try:
            while True:
                turns += 1
                yield 1
        finally:
            TURNS.append(turns)


def test_the_finally_of_a_rule_and_of_what_a_protocol_yields_from_runs_too():
    ended = []

    def waiting(me):
        try:
            while True:
                yield me.sleep(0.1)
        finally:
            ended.append(me.id)

    def protocol(me):
        yield from waiting(me)

    run(brief(protocol), 1)
    assert ended == [0, 1, 2]
    run(brief(Counting()), 1)
    assert len(TURNS) == 3


def test_what_a_finally_does_after_the_end_is_not_recorded():
    def protocol(me, *, at_the_end):
        try:
            while True:
                me.assign(1)
                me.announce()
                yield me.sleep(0.1)
        finally:
            if at_the_end:
                me.assign(0)
                me.announce()
                me.send(None, "over")

    def with_end(me):
        return protocol(me, at_the_end=True)

    def without_end(me):
        return protocol(me, at_the_end=False)

    seen = []
    results = [run(brief(each, record=Recording(messages=True)), 1, seen.append) for each in (with_end, without_end)]
    gc.collect()
    assert results[0].trace.events == results[1].trace.events
    assert seen == [*results[0].trace.events, *results[1].trace.events]


def test_an_error_in_finally_ends_the_run_and_the_first_error_counts():
    def protocol(me):
        try:
            yield me.sleep(0.1)
            if me.id == 1:
                raise KeyError("first")
            yield me.sleep(1.0)
        finally:
            if me.id == 0:
                me.assign(7)

    with pytest.raises(KeyError, match="first"):
        run(brief(protocol), 1)
    with pytest.raises(ValueError, match="7") as caught:
        run(brief(lambda me: protocol(me) if me.id == 0 else iter([])), 1)
    assert caught.value.__notes__ == ["(pursuer 0, at 0.3 s of its clock)"]


def test_all_processes_are_closed_whatever_one_raises_and_exit_is_an_error():
    ended = []

    def protocol(me):
        try:
            yield me.sleep(0.1 if me.id == fails else 1.0)
            raise KeyError(me.id)
        finally:
            ended.append(me.id)
            sys.exit(0)

    fails = None
    with pytest.raises(RuntimeError, match=r"^the protocol called exit\(0\) \(pursuer 0, at 0.3 s of its clock\)$"):
        run(brief(protocol), 1)
    fails = 1
    with pytest.raises(RuntimeError, match=r"^the protocol called exit\(0\) \(pursuer 1, at 0.1 s of its clock\)$"):
        run(brief(protocol), 1)
    assert ended == [0, 1, 2, 1, 0, 2]


class Sleeping:
    """An iterator that has no `close`."""

    def __init__(self, me):
        self.me = me

    def __iter__(self):
        return self

    def __next__(self):
        return self.send(None)

    def send(self, value):
        return self.me.sleep(0.1)


def test_an_iterator_without_close_needs_none():
    crash = Crash(node=1, start=0.1, end=0.2, memory=False)
    assert run(brief(lambda me: Sleeping(me), fault=(crash,)), 1).trace.events


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_protocol_that_goes_on_after_its_end_is_left_to_python():
    def protocol(me):
        while True:
            try:  # noqa: SIM105
                yield me.sleep(0.1)
            except:  # noqa: E722
                pass

    assert run(brief(protocol), 1).trace.events
    gc.collect()


def test_a_pursuer_that_is_down_at_the_end_is_closed_too():
    ended = []

    def protocol(me):
        try:
            while True:
                yield me.sleep(0.1)
        finally:
            ended.append(me.id)

    run(brief(protocol, fault=(Crash(node=1, start=0.1, end=9.0, memory=True),)), 1)
    assert ended == [0, 1, 2]
