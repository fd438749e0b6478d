"""Mobility files of BonnMotion and ns-2: what they mean, and what is refused with file and line."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim.kernel.core.units import nanoseconds
from desim.pursuit.mobility.mobility import Waypoint
from desim.pursuit.mobility.mobility_file import read_mobility
from desim.pursuit.mobility.ns2_file import Move, legs

START = "$node_(3) set X_ 1.0\n$node_(3) set Y_ 2.0\n$node_(3) set Z_ 7.0\n"


def read(tmp_path, text, node=0):
    (tmp_path / "motion.txt").write_text(text, encoding="utf-8")
    return read_mobility(tmp_path / "motion.txt").track(node).waypoints


def moved(tmp_path, *moves):
    """Return the waypoints (t, x, y) of node 3, which starts at (1, 2), in a file of ns-2."""
    lines = "".join(f'$ns_ at {t} "$node_(3) setdest {rest}"\n' for t, rest in moves)
    return [each[:3] for each in read(tmp_path, START + lines, 3)]


def test_a_node_of_bonnmotion_is_a_line_with_comments_and_empty_lines_left_out(tmp_path):
    text = "# made by hand\n0 1 2 1.5 3 -4.5\n\n  # another\n2 5 6\n"
    assert read(tmp_path, text, 0) == [Waypoint(0.0, 1.0, 2.0, 2), Waypoint(1.5, 3.0, -4.5, 2)]
    assert read(tmp_path, text, 1) == [Waypoint(2.0, 5.0, 6.0, 5)]


def test_a_waypoint_that_bonnmotion_repeats_counts_once(tmp_path):
    assert len(read(tmp_path, "0 1 2 0 1 2 3 1 2")) == 2


def test_a_node_of_ns2_stands_until_it_moves_and_after_it_has_arrived(tmp_path):
    """3 m at 2 m/s from 4 s on take 1.5 s; until the next statement at 10 s it waits."""
    assert moved(tmp_path, (4.0, "4 2 2"), (10.0, "4 3 1")) == [
        (0.0, 1.0, 2.0),
        (4.0, 1.0, 2.0),
        (5.5, 4.0, 2.0),
        (10.0, 4.0, 2.0),
        (11.0, 4.0, 3.0),
    ]


@pytest.mark.parametrize(("speed", "x"), [("4e-9", 5.0), ("1e-320", 1.0)])
def test_a_move_of_ns2_that_outlasts_all_runs_ends_on_the_way(tmp_path, speed, x):
    """From (1, 2) towards (9, 2), 4 m in 1e9 s; the slower one would take longer than a number can say."""
    assert moved(tmp_path, (0.0, f"9 2 {speed}")) == [(0.0, 1.0, 2.0), (1e9, pytest.approx(x), 2.0)]


def test_a_new_target_of_ns2_replaces_the_one_that_has_not_been_reached(tmp_path):
    """After 1 s at 1 m/s it is at (2, 2), and goes up from there; speed 0 stops it there."""
    assert moved(tmp_path, (0.0, "9 2 1"), (1.0, "2 9 1"), (3.0, "0 0 0")) == [
        (0.0, 1.0, 2.0),
        (1.0, 2.0, 2.0),
        (3.0, 2.0, 4.0),
    ]


def test_what_else_is_in_a_script_of_ns2_is_ignored(tmp_path):
    text = f"""# $node_(3) setdest bad
set god_ [God instance]
for {{set i 0}} {{$i < 5}} {{incr i}} {{ set node_($i) [$ns_ node] }}
{START}
$node_(0) set X_ 5
$god_ set-dist 0 1 1
$ns at 2.0 " $node_(3) setdest 1.0 3.0 1.0 " ;
$ns_ at 2.0 "$god_ set-dist 0 1 2"
$ns_ at 9.0 "$ns_ halt"
"""
    assert [each[:3] for each in read(tmp_path, text, 3)] == [(0.0, 1.0, 2.0), (2.0, 1.0, 2.0), (3.0, 1.0, 3.0)]


numbers = st.floats(-100.0, 100.0)
moves = st.builds(Move, st.floats(0.0, 50.0), numbers, numbers, st.just(0.0) | st.floats(0.01, 100.0), st.just(1))


def simulated(start, moves, t):
    """Return where a node of ns-2 is at a time, one move after another."""
    place, until = complex(*start), [move.t for move in moves[1:]] + [t]
    for move, end in zip(moves, until, strict=False):
        way = complex(move.x, move.y) - place
        length = min(move.speed * max(min(end, t) - move.t, 0.0), abs(way))
        place += way * (length / abs(way)) if way else 0j
    return place


def interpolated(waypoints, t):
    """Return where a node is at a time, between the waypoints around it."""
    for before, after in pairwise(waypoints):
        if t <= after.t:
            share = (t - before.t) / (after.t - before.t)
            return complex(*before[1:3]) + share * (complex(*after[1:3]) - complex(*before[1:3]))
    return complex(*waypoints[-1][1:3])


@given(st.lists(moves, max_size=6), st.floats(0.0, 80.0))
def test_the_waypoints_of_ns2_are_where_the_moves_lead(given, t):
    """Moves of less than 1 ns are left out: at most 100 m/s for 1 ns each."""
    ordered = sorted(given, key=lambda move: move.t)
    waypoints = list(legs(Waypoint(0.0, 1.0, 2.0, 1), ordered))
    assert all(nanoseconds(before.t) < nanoseconds(after.t) for before, after in pairwise(waypoints))
    assert abs(interpolated(waypoints, t) - simulated((1.0, 2.0), ordered, t)) < 1e-6


BAD = {
    "count": ("0 1 2\n0 1 2 3\n", 1, r"line 2: should be t1 x1 y1 t2 x2 y2 \.\.\., three numbers each; there are 4"),
    "text": ("0 1 north", 0, r"line 1: 'north' is not a number"),
    "order": ("0 1 2 5 1 2 4 1 2", 0, r"line 1: the times of a node should increase; after 5 s comes 4 s"),
    "jump": ("0 1 2 5 1 2 5 1 3", 0, r"after 5 s comes 5 s"),
    "negative time": ("-1 1 2", 0, r"line 1: a time should be from 0 to 1e\+09 s \(got -1\)"),
    "not finite": ("0 1 nan", 0, r"line 1: a coordinate should be from -1e\+09 to 1e\+09 m \(got nan\)"),
    "no node": ("0 1 2\n0 1 2\n", 2, r"has no node 2: it has nodes 0 to 1"),
    "no nodes": ("# nothing\n", 0, r"has no node 0: it has no nodes"),
    "no node of ns-2": (START, 0, r"has no node 0: it has node 3"),
    "no start": ("$node_(0) set X_ 1\n", 0, r"node 0 has no initial position: \$node_\(0\) set Y_ is missing"),
    "variable": (START + '$ns_ at 1 "$node_(3) setdest 1 2 $v"', 3, r"line 4: '\$v' is not a number"),
    "loop": ("$node_($i) set X_ 5\n" + START, 3, r"line 1: should have the form \$node_\(0\) set X_ 10\.0, or"),
    "jump of ns-2": (START + '$ns_ at 1 "$node_(3) set X_ 5"', 3, r"line 4: should have the form"),
    "backwards": (START + '$ns_ at 1 "$node_(3) setdest 1 2 -3"', 3, r"line 4: a speed should be from 0 .*got -3"),
}


@pytest.mark.parametrize(("text", "node", "why"), BAD.values(), ids=BAD)
def test_a_bad_file_is_refused_with_its_name_and_the_line(tmp_path, text, node, why):
    with pytest.raises(ValueError, match=rf"motion\.txt.*{why}"):
        read(tmp_path, text, node)


def test_an_unreadable_file_is_reported_by_its_name(tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    for name in ("binary", "none"):
        with pytest.raises(ValueError, match=rf"{name} cannot be read"):
            read_mobility(tmp_path / name)
