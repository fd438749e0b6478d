"""The time of a run does not grow with the length of the records that it reads."""

from time import process_time

import pytest

from desim import load, run

SHORT, LONG = 40, 36_000
"""Numbers of rows; the long record has ten per second for an hour."""
MOVING = "t,x,y\n", lambda k: f"{k / 10},{0.01 * (k % 7)},{0.01 * (k % 5)}\n"
MEASURED = "t,value\n", lambda k: f"{k / 10},{0.01 * (k % 7)}\n"
SIGNALS = "t,value\n", lambda k: f"{k / 10},{-60 - 4 * (k % 7)}\n"
LISTED = "", lambda k: f"0.0{k % 7}\n"
RECORDS = {
    "flow on all": (MOVING, ['environment.flow={kind="recorded",file=FILE}']),
    "flow on pursuers": (MOVING, ['environment={on="pursuers",flow={kind="recorded",file=FILE}}']),
    "flow and inertia": (
        MOVING,
        ['environment.flow={kind="recorded",file=FILE}', 'team.dynamics={kind="acceleration",limit=2.0}'],
    ),
    "evader": (MOVING, ['evader.strategy={kind="recorded",file=FILE}']),
    "relay": (MOVING, ['team.relay=[{pursuer=0,motion={kind="recorded",file=FILE}}]', "network.range=8.0"]),
    "latency trace": (MEASURED, ['network.latency={kind="trace",file=FILE}']),
    "loss trace": (MEASURED, ['network.loss={kind="trace",file=FILE}']),
    "signal trace": (SIGNALS, ['network.loss={kind="signal_trace",file=FILE,threshold=-70.0}']),
    "latencies": (LISTED, ['network.latency={kind="empirical",file=FILE}']),
}
"""By the name of a reader: the head and the rows of its record, and the keys of a scenario with FILE in its place."""


def time_of_run(folder, record, keys, length):
    """Return the least CPU time, s, of three runs of a scenario with a record of some length, without its reading."""
    (head, row), name = record, f"record{length}.csv"
    (folder / name).write_text(head + "".join(map(row, range(length))))
    scenario = load(folder / "scenario.toml", [key.replace("FILE", f'"{name}"') for key in keys])
    times = []
    for seed in range(3):
        begin = process_time()
        run(scenario, seed)
        times.append(process_time() - begin)
    return min(times)


@pytest.mark.whole
@pytest.mark.parametrize("name", RECORDS)
def test_a_long_record_makes_no_step_of_a_run_slower(tmp_path, name):
    (tmp_path / "scenario.toml").write_text("horizon = 2.0\nteam = {count = 4}\nevader = {speed = 0.9}\n")
    record, keys = RECORDS[name]
    short, long = (time_of_run(tmp_path, record, keys, length) for length in (SHORT, LONG))
    assert long < 6.0 * short + 0.2  # 0.2 s for what is prepared once
