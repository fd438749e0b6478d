"""Same scenario and seed, same bytes: in any process, with any number of workers, in any order of registration."""

import builtins
import os
import random
import subprocess
import sys

import numpy as np
import pytest

from desim import Scenario, load, run
from desim.kernel.core.trace_file import line_of
from desim.kernel.models.latency import Constant
from desim.kernel.models.links import Links
from desim.kernel.models.loss import Bernoulli
from desim.pursuit.motion.inertia import InertialKinematics
from desim.scenario.players import Team
from desim.simulation import run as run_module
from desim.study.workers.batch import run_many
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import Poisson, SharedSeed
from scenarios.studies.study import SCENARIOS
from tests.digests import NAMES, digests, digests_of

RELAY = SCENARIOS / "relay.toml"


def lines(result):
    return "".join(map(line_of, result.trace))


QUICK = ("learning.toml", "many.toml", "relay.toml")
LOOPS = " ".join(np.show_config(mode="dicts")["SIMD Extensions"]["found"])
"""The loops of numpy that are chosen for this processor; without them it takes those that run on any."""
KERNEL = {"OPENBLAS_CORETYPE": "Prescott", "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "1"}
NO_LOOPS = {
    "NPY_DISABLE_CPU_FEATURES": LOOPS,
    "OPENBLAS_NUM_THREADS": "2",
    "PYTHONHASHSEED": "2",
    "TZ": "Asia/Kathmandu",
}
LOCALE = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONHASHSEED": "3"}


def printed(*arguments, environment):
    """Return what Python prints in a process of its own."""
    command, place = [sys.executable, *arguments], SCENARIOS.parent
    return subprocess.run(
        command, cwd=place, env=os.environ | environment, capture_output=True, check=True, text=True
    ).stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "options", "environment"),
    [
        pytest.param(QUICK, (), NO_LOOPS | KERNEL, id="quick"),
        pytest.param(("long",), (), KERNEL, id="one thread of BLAS"),
        pytest.param(
            NAMES,
            ("-O",),
            NO_LOOPS | LOCALE | {"OPENBLAS_CORETYPE": KERNEL["OPENBLAS_CORETYPE"]},
            id="kernel, loops of numpy, two threads, time zone, -O and locale",
        ),
    ],
)
def test_traces_and_summaries_are_equal_in_any_process_at_any_place(names, options, environment):
    there = printed(*options, "-m", "tests.digests", "5", *names, environment=environment)
    assert there.splitlines() == digests(5, names)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rounded", "environment"),
    [
        ("x[:99] @ y[:99]", {"OPENBLAS_CORETYPE": "Prescott"}),
        ("x @ y", {"OPENBLAS_NUM_THREADS": "1"}),
        ("abs(x + 1j * y).tobytes().hex()", {"NPY_DISABLE_CPU_FEATURES": LOOPS}),
    ],
    ids=["kernel", "threads", "loops"],
)
def test_processor_dependent_rounding_differs_in_these_environments(rounded, environment):
    """The control: were it used, the digests would differ."""
    program = f"import numpy as np; x, y = np.random.default_rng(5).random((2, 20_001)); print({rounded})"
    here, there = (printed("-c", program, environment=given) for given in ({}, environment))
    if here == there:
        pytest.skip(f"{rounded} is the same with {environment} on this machine")


@pytest.mark.slow
def test_other_seeds_make_other_traces_and_summaries():
    found = [digest for seed in (5, 6) for line in digests(seed, QUICK) for digest in line.split()[:2]]
    assert len(set(found)) == len(found) == 12


@pytest.mark.slow
def test_digests_depend_on_distances_within_a_motion_step(monkeypatch):
    """The control: straight motion in place of curves is seen by the only run of players with inertia and a range."""
    before = digests(0, ("curves",))
    monkeypatch.delattr(InertialKinematics, "distances")
    digests_of.cache_clear()
    assert digests(0, ("curves",)) != before
    digests_of.cache_clear()


@pytest.mark.whole
def test_a_name_that_a_terminal_cannot_encode_is_printed_all_the_same(tmp_path):
    file = tmp_path / "named.toml"
    file.write_text('name = "Jäger ≤ 3"\nhorizon = 0.1\n', encoding="utf-8")
    turkish = os.environ | {"PYTHONIOENCODING": "iso8859-9"}
    done = subprocess.run([sys.executable, "-m", "desim", "run", file], env=turkish, capture_output=True, check=True)
    assert done.stdout.startswith(b"J\xe4ger \\u2264 3")


@pytest.mark.whole
def test_traces_are_equal_for_one_worker_and_two():
    tasks = [(load(RELAY, ["horizon=1.0"]), seed) for seed in range(4)]
    one, two = (run_many(tasks, jobs, measure=lines) for jobs in (1, 2))
    assert one == two
    assert len(set(one)) == 4


@pytest.mark.slow
@pytest.mark.parametrize("schedule", [SharedSeed(slot=0.05), Poisson(rate=2.0), "all at once", "by message"])
@pytest.mark.parametrize("latency", [0.0, 0.05])
def test_the_order_of_registration_does_not_matter(schedule, latency, monkeypatch):
    """Processes made backwards, and the world's own after or before them, give the same trace."""

    def all_at_once(me):
        for k in range(1, 60):
            yield me.at(k * 0.05)
            me.assign(me.gain() > 0)
            me.announce()

    def by_message(me):
        """Start by a message to all, then answer every message to its sender while there is something to say."""
        me.send(None, me.id)
        while True:
            yield me.arrival()
            for message in me.mail():
                me.assign((message.body + me.id) % 3 == 0)
                if message.body < 40 and me.id != message.src:
                    me.send(message.src, message.body + 7)

    own = {"all at once": all_at_once, "by message": by_message}
    scenario = Scenario(
        horizon=3.0,
        team=Team(count=7, active_at_start=0.5),
        protocol=own.get(schedule) or SpatialAdaptivePlay(schedule=schedule),
        network=Links(latency=Constant(value=latency), loss=Bernoulli(p=0.1), range=8.0),
        record={"messages": True},
    )
    forwards = lines(run(scenario, 5))
    begin, begin_world = run_module.TeamProcesses.begin, run_module.World.begin

    def world_first(crew):
        begin_world(crew._world)
        monkeypatch.setattr(run_module, "range", lambda n: reversed(builtins.range(n)), raising=False)
        begin(crew)

    monkeypatch.setattr(run_module.TeamProcesses, "begin", world_first)
    monkeypatch.setattr(run_module.World, "begin", lambda world: None)
    assert lines(run(scenario, 5)) == forwards
    assert forwards.count("Broadcast") + forwards.count("Sent") > 10


def test_two_runs_with_one_seed_are_equal_whatever_ran_between_them():
    """The control is the run between them, with another seed."""
    scenario = load(RELAY, ["horizon=0.3"])
    first, other, again = (lines(run(scenario, seed)) for seed in (3, 4, 3))
    assert first == again != other
    assert first.count("Broadcast") > 10


@pytest.mark.slow
def test_the_global_random_generators_are_untouched():
    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    run(load(RELAY))
    assert np.random.random() == 0.417022004702574  # noqa: NPY002
    assert random.random() == 0.13436424411240122


@pytest.mark.slow
def test_recording_and_watching_change_nothing_that_happens():
    quiet = load(RELAY, ["horizon=3.0", "record.messages=false", "record.trajectory=0"])
    unkept = {"Broadcast", "Lost", "Sampled"}
    events = [event for event in run(load(RELAY, ["horizon=3.0"]), 2).trace if type(event).__name__ not in unkept]
    assert list(run(quiet, 2).trace) == events
    assert list(run(quiet, 2, lambda event: None).trace) == events


@pytest.mark.slow
def test_scenarios_with_one_seed_share_their_random_streams():
    """A swept value moves no stream: start and order of decisions are the same at any latency and loss."""
    near, far = (
        run(load(RELAY, [f"network.latency.value={x}", f"network.loss.p={p}"])) for x, p in [(0, 0), (0.5, 0.3)]
    )
    assert near.trace.events[0] == far.trace.events[0]
    decided = [[(d.t, d.pursuer) for d in result.trace.events if hasattr(d, "pursuer")] for result in (near, far)]
    common = min(map(len, decided))
    assert common > 100
    assert decided[0][:common] == decided[1][:common]
