"""Tables, letter by letter."""

from dataclasses import replace
from math import inf, nan

import pytest

from desim.analysis.metrics import Summary
from desim.analysis.tables import aligned, batch_table, number, run_table
from desim.scenario import Evader, Scenario, Team

SCENARIO = Scenario(name="relay", team=Team(count=3))
CAUGHT = Summary(
    seed=7,
    captured=True,
    capture_time=3.9454,
    capturer=2,
    end_time=3.9454,
    active_time=12.7394,
    idle_time=0.0,
    crowded_time=1.23,
    excess_time=0.5,
    misassigned_time=None,
    time_to_relay=None,
    potential_gap=None,
    regret=None,
    energy=16.25,
    decisions=1358,
    switches=19,
    handovers=3,
    ping_pongs=1,
    messages_sent=6802,
    messages_delivered=6610,
    messages_lost=116,
    messages_in_flight=76,
    messages_lost_by={"reach": 16, "half_duplex": 100},
    transmissions=3401,
    bytes_sent=81624,
    utilisation=0.0,
    age_mean=None,
    age_peak=None,
    age_at_decision=None,
    belief_error=None,
    believed_leaders=None,
)
SEEN = replace(CAUGHT, misassigned_time=1.5, time_to_relay=1.25, potential_gap=40.5, regret=-0.125)
HEARD = replace(
    CAUGHT,
    utilisation=0.25,
    age_mean=0.0519,
    age_peak=0.1021,
    age_at_decision=0.0498,
    belief_error=0.03125,
    believed_leaders=0.75,
)
ESCAPED = replace(CAUGHT, seed=8, captured=False, capture_time=None, capturer=None, end_time=30.0)


def test_columns_line_up_the_first_to_the_left_and_the_others_to_the_right():
    rows = [("", "mean", "n"), ("time, s", "3.5", "12"), ("x", "10.25", "")]
    assert aligned(rows) == "          mean   n\ntime, s    3.5  12\nx        10.25"


def test_columns_before_right_from_line_up_to_the_left():
    assert aligned([("a", "bbb"), ("aaa", "b")], right_from=2) == "a    bbb\naaa  b"


def test_rows_of_different_length_are_an_error():
    with pytest.raises(ValueError, match="argument 2"):
        aligned([("a", "b"), ("a",)])


def test_no_rows_are_an_empty_table():
    assert aligned([]) == ""


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(1234.5678, 3, "1,234.568"), (0.0, 3, "0.000"), (-2.5, 1, "-2.5"), (nan, 3, "-"), (inf, 3, "inf")],
)
def test_a_number_has_thousands_separators_and_a_dash_stands_for_none(value, digits, text):
    assert number(value, digits) == text


def test_the_table_of_a_run_that_ended_with_a_capture():
    """6802 messages in 0.05 s are 136,040 in a second."""
    assert run_table(SCENARIO, CAUGHT, wall_time=0.05).splitlines() == [
        "relay: 3 pursuers, sap, seed 7",
        "captured       after 3.945 s by pursuer 2",
        "active time    12.739 s                    summed over the pursuers",
        "idle time      0.000 s                     nobody active",
        "crowded time   1.230 s                     more than one active",
        "energy         16.250 m^2/s                v^2 summed over the active, over time",
        "decisions      1,358                       19 of them changed an action",
        "hand-overs     3                           1 of them ping-pong",
        "messages sent  6,802                       each receiver of a broadcast counts as one",
        "  delivered    6,610",
        "  lost         116                         100 by half duplex, 16 by reach",
        "  in flight    76                          when the run ended",
        "bytes sent     81,624                      in 3,401 transmissions",
        "wall time      0.050 s                     136,040 messages/s",
    ]


def test_the_table_of_a_run_whose_word_was_measured_tells_how_old_and_how_wrong_it_was():
    assert run_table(SCENARIO, HEARD, wall_time=0.05).splitlines()[-8:] == [
        "bytes sent        81,624                      in 3,401 transmissions",
        "utilisation       0.250                       share of the time in which the channels were busy",
        "age mean          0.052 s                     averaged over time and pairs",
        "age peak          0.102 s                     just before newer word came, where it did",
        "age at decision   0.050 s                     when the reader decided",
        "belief error      0.031                       share of pairs with wrong word of the action",
        "believed leaders  0.750                       active, and heard of nobody else who is",
        "wall time         0.050 s                     136,040 messages/s",
    ]


def test_the_table_of_a_run_whose_positions_are_known_tells_how_far_it_was_from_the_relay_profile():
    assert run_table(SCENARIO, SEEN, wall_time=0.05).splitlines()[4:10] == [
        "crowded time      1.230 s                     more than one active",
        "misassigned time  1.500 s                     not just the relay pursuer active",
        "time to relay     1.250 s                     until just the relay pursuer was, for a while",
        "potential gap     40.500 s^2                  below the greatest potential, over time",
        "regret            -0.125 s                    against each one's better fixed action, averaged",
        "energy            16.250 m^2/s                v^2 summed over the active, over time",
    ]


def test_the_table_of_a_run_without_losses_names_no_cause():
    table = run_table(SCENARIO, replace(CAUGHT, messages_lost=0, messages_lost_by={}), wall_time=0.05)
    assert "  lost         0" in table.splitlines()


def test_the_table_of_several_runs_averages_ages_over_the_runs_that_have_them():
    lines = batch_table(SCENARIO, [replace(HEARD, age_peak=None), HEARD], wall_time=1.0).splitlines()
    cells = {line[:20].strip(): line[20:].split() for line in lines[3:-1]}
    assert cells["believed leaders"] == ["0.750", "0.000", "0.750", "0.750", "2"]
    assert cells["age mean, s"] == ["0.052", "0.000", "0.052", "0.052", "2"]
    assert cells["age peak, s"] == ["0.102", "-", "0.102", "0.102", "1"]
    assert cells["belief error"] == ["0.031", "0.000", "0.031", "0.031", "2"]
    assert cells["utilisation"] == ["0.250", "0.000", "0.250", "0.250", "2"]


def test_the_table_of_several_runs_averages_over_those_in_which_there_was_something_to_measure():
    """In one of two runs the relay pursuer never chased alone for long enough; in the third nothing was recorded."""
    runs = [SEEN, replace(SEEN, time_to_relay=None, misassigned_time=2.5), CAUGHT]
    lines = batch_table(SCENARIO, runs, wall_time=1.0).splitlines()
    cells = {line[:20].strip(): line[20:].split() for line in lines[3:-1]}
    assert cells["misassigned time, s"] == ["2.000", "6.353", "1.500", "2.500", "2"]
    assert cells["time to relay, s"] == ["1.250", "-", "1.250", "1.250", "1"]
    names = list(cells)
    assert names[names.index("excess time, s") :][:6] == [
        "excess time, s",
        "misassigned time, s",
        "time to relay, s",
        "potential gap, s^2",
        "regret, s",
        "energy, m^2/s",
    ]


def test_a_cause_that_one_run_lacks_counts_as_0_there():
    """Of 16 and 0: mean 8, s.e. 8, and t(1, 0.975) = 12.706."""
    lines = batch_table(SCENARIO, [CAUGHT, replace(CAUGHT, messages_lost_by={})], wall_time=1.0).splitlines()
    (line,) = (line for line in lines if line.startswith("  by reach"))
    assert line.split()[2:] == ["8.000", "101.650", "0.000", "16.000", "2"]


def test_the_table_of_a_run_that_ended_at_the_horizon():
    assert run_table(SCENARIO, ESCAPED, wall_time=0.05).splitlines()[:2] == [
        "relay: 3 pursuers, sap, seed 8",
        "captured       no, the pursuit ended after 30.000 s",
    ]


def test_the_table_of_several_runs_has_means_intervals_and_extremes():
    """Of 0, 3 and 6 s: mean 3, s.e. sqrt(9 / 3), and t(2, 0.975) = 4.3027 gives 7.452; captured after 2 and 4 s:
    s.e. 1 and t(1, 0.975) = 12.706. 3 x 6802 messages in 2 s are 10,203 in a second."""
    runs = [
        replace(CAUGHT, seed=7, capture_time=2.0, idle_time=0.0, switches=10),
        replace(CAUGHT, seed=8, capture_time=4.0, idle_time=3.0, switches=10),
        replace(ESCAPED, seed=9, idle_time=6.0, switches=10),
    ]
    lines = batch_table(SCENARIO, runs, wall_time=2.0).splitlines()
    assert lines[0] == "relay: 3 pursuers, sap, seeds 7 to 9"
    assert lines[1] == "captured in 2 of 3 runs; +- is half a 95 % t interval"
    assert lines[2] == "capture probability 0.667, 95 % Wilson interval 0.208 to 0.939"
    cells = {line[:18].strip(): line[18:].split() for line in lines[3:-1]}
    assert cells[""] == ["mean", "+-", "least", "most", "runs"]
    assert cells["capture time, s"] == ["3.000", "12.706", "2.000", "4.000", "2"]
    assert cells["idle time, s"] == ["3.000", "7.452", "0.000", "6.000", "3"]
    assert cells["switches"] == ["10.000", "0.000", "10.000", "10.000", "3"]
    assert cells["messages sent"] == ["6,802.000", "0.000", "6,802.000", "6,802.000", "3"]
    names = ["capture time, s", "end time, s", "active time, s", "idle time, s", "crowded time, s", "excess time, s"]
    names += [
        "energy, m^2/s",
        "decisions",
        "switches",
        "handovers",
        "ping pongs",
        "messages sent",
        "messages delivered",
        "messages lost",
        "by half duplex",
        "by reach",
    ]
    names += ["messages in flight", "transmissions", "bytes sent"]
    assert list(cells) == ["", *names]
    assert lines[-1] == "wall time 2.000 s, 10,203 messages/s"


def test_a_capture_in_one_run_only_has_no_interval():
    table = batch_table(SCENARIO, [CAUGHT, ESCAPED], wall_time=1.0)
    (line,) = (line for line in table.splitlines() if line.startswith("capture time"))
    assert line.split()[-5:] == ["3.945", "-", "3.945", "3.945", "1"]


def test_runs_without_a_capture_have_no_time_of_it():
    table = batch_table(SCENARIO, [ESCAPED, ESCAPED], wall_time=1.0)
    assert "captured in 0 of 2 runs" in table
    assert "capture time" not in table


PACK = SCENARIO.model_copy(update={"evader": (Evader(), Evader(count=2))})
TAKEN = replace(
    SEEN,
    captures=3,
    mean_capture_time=2.5,
    capture_times={"3": 1.5, "1": 2.0545, "2": 3.9454},
    capturers={"3": 0, "1": 0, "2": 2},
)


def test_the_table_of_a_run_with_several_evaders_tells_who_captured_which_when_in_order():
    assert run_table(PACK, TAKEN, wall_time=0.05).splitlines()[:12] == [
        "relay: 3 pursuers, 3 evaders, sap, seed 7",
        "captured          3 of 3                      the last after 3.945 s",
        "  evader 3        after 1.500 s by pursuer 0",
        "  evader 1        after 2.054 s by pursuer 0",
        "  evader 2        after 3.945 s by pursuer 2",
        "active time       12.739 s                    summed over the pursuers",
        "idle time         0.000 s                     nobody on an evader, summed over those at large",
        "crowded time      1.230 s                     more than one on an evader, summed over these",
        "misassigned time  1.500 s                     not the best pursuer alone on each evader",
        "time to relay     1.250 s                     until just the best on each evader were, for a while",
        "potential gap     40.500 s^2                  below the greatest potential, over time",
        "regret            -0.125 s                    against each one's best fixed action, averaged",
    ]


def test_the_table_of_a_run_names_the_evaders_that_were_not_captured():
    run = replace(ESCAPED, captures=1, mean_capture_time=1.5, capture_times={"3": 1.5}, capturers={"3": 0})
    assert run_table(PACK, run, wall_time=0.05).splitlines()[1:5] == [
        "captured       1 of 3                      the pursuit ended after 30.000 s",
        "  evader 3     after 1.500 s by pursuer 0",
        "  evader 1     no",
        "  evader 2     no",
    ]
    run = replace(run, captures=0, mean_capture_time=None, capture_times={}, capturers={})
    assert run_table(PACK, run, wall_time=0.05).splitlines()[1].startswith("captured       0 of 3")


def test_the_table_of_a_run_with_many_evaders_names_the_first_of_them():
    many = SCENARIO.model_copy(update={"evader": Evader(count=30)})
    lines = run_table(many, TAKEN, wall_time=0.05).splitlines()
    assert [line.strip() for line in lines[12:15]] == ["evader 11       no", "evader 12       no", "and 18 more"]
    assert lines[15].startswith("active time")


def test_the_table_of_several_runs_with_several_evaders_counts_what_was_captured():
    """Of 3 and 1: mean 2, s.e. 1, and t(1, 0.975) = 12.706."""
    runs = [TAKEN, replace(ESCAPED, captures=1, mean_capture_time=1.5, capture_times={"3": 1.5}, capturers={"3": 0})]
    lines = batch_table(PACK, runs, wall_time=1.0).splitlines()
    assert lines[:2] == [
        "relay: 3 pursuers, 3 evaders, sap, seeds 7 to 8",
        "all captured in 1 of 2 runs; +- is half a 95 % t interval",
    ]
    cells = {line[:22].strip(): line[22:].split() for line in lines[3:-1]}
    assert list(cells)[1:4] == ["capture time, s", "captures", "mean capture time, s"]
    assert cells["captures"] == ["2.000", "12.706", "1.000", "3.000", "2"]
    assert cells["mean capture time, s"] == ["2.000", "6.353", "1.500", "2.500", "2"]


def test_a_protocol_of_ones_own_is_called_by_its_name():
    def daydream(me):
        yield me.at(0.0)

    class Idler:
        def __call__(self, me):
            yield me.at(0.0)

    class Kindless(Idler):
        kind = None

    for protocol, called in ((daydream, "daydream"), (Idler(), "Idler"), (Kindless(), "Kindless")):
        scenario = SCENARIO.model_copy(update={"protocol": protocol})
        assert run_table(scenario, CAUGHT, 1.0).splitlines()[0] == f"relay: 3 pursuers, {called}, seed 7"
