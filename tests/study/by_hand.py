"""Results of studies made by hand, without a run: everything occurs in them that is drawn or printed."""

from itertools import product
from math import nan

import numpy as np

from desim.analysis.metrics import Summary
from desim.analysis.statistics import mean
from desim.live.agreement import Agreement
from desim.live.result import Conduct, LiveResult
from desim.study.comparing.control import Controlled
from desim.study.comparing.scores import OMNISCIENT, Benchmark, NoPart
from desim.study.comparing.suite import AS_IT_IS, PERFECT, REFERENCE, SILENT
from desim.study.results.comparison import Comparison
from desim.study.results.costs import Bounds, Cost, Saving
from desim.study.results.explanation import Explanation
from desim.study.results.result import SweepResult
from desim.study.results.runs import Group
from desim.study.selection.kim_nelson import Dropped, Selection
from desim.study.selection.race_result import RaceResult
from desim.study.sensitivity.morris import ElementaryEffects
from desim.study.sensitivity.sensitivity_result import SensitivityResult
from desim.study.sensitivity.sobol_indices import IndexEstimate, SobolIndices
from desim.study.store.run_table import Row
from tests.view.by_hand import history, pair

LATENCY, LOSS = "network.latency.value", "network.loss.p"
RULES = ["sap", "cbba"]
TIMES = [0.05, 0.1, 0.4]
NAME = "a <b> & $c$"
"""A name with letters that HTML, LaTeX and mathematics read as commands."""
TRACEBACK = (
    'Traceback (most recent call last):\n  File "rules.py", line 7, in rule\n    fail()\nValueError: <no> & $way$\n'
)
NOISE = (0.0, 0.5, -0.2)
"""What run k of every configuration has in addition, so that paired differences are exact."""


def row(k, time, **metrics):
    """Return run k of a configuration, whose active time is given, s."""
    captured = {"captured": True, "capture_time": 2.0 * time, "mean_capture_time": 2.0 * time}
    values = {"active_time": time, **captured, "end_time": 2.0 * time, "messages_sent": round(100.0 * time)}
    return Row(k, 10 + k, "ok", Summary(values | metrics, {"heat": "J"}))


def swept(grid, *, time=lambda k: 1.0 + k, runs=3, units=None, **options):
    """Return a sweep over a grid, in which run r of configuration k has the active time time(k) + NOISE[r], s.

    The first run of the second configuration has no capture, and the last run of the last one failed.
    """
    groups = []
    for k, values in enumerate(product(*grid.values())):
        rows = [row(r, time(k) + NOISE[r], heat=0.5 * k) for r in range(runs)]
        if k == 1:
            rows[0] = row(0, time(k), heat=7.0, captured=False, capture_time=None, mean_capture_time=None)
        groups.append(Group(dict(zip(grid, values, strict=True)), tuple(rows)))
    *others, last = groups
    failed = Row(runs - 1, 9 + runs, "error", None, TRACEBACK)
    groups = (*others, Group(last.settings, (*last.rows[:-1], failed)))
    return SweepResult(NAME, tuple(grid), groups, units={"heat": "J"} if units is None else units, **options)


def scattered(keys=(LATENCY, LOSS)):
    """Return a sweep over nine points of a design, the first key over two decades, and two rules."""
    groups = []
    for k in range(9):
        point = (0.01 * 10.0 ** (k / 4.0), ((2 * k + 1) % 9) / 10.0)
        for j, rule in enumerate(RULES):
            rows = tuple(row(r, 1.0 + j + point[1] + k / 10.0 + NOISE[r]) for r in range(2))
            settings = dict(zip((LATENCY, LOSS), point, strict=True))
            groups.append(Group({"protocol": rule} | {key: settings[key] for key in keys}, rows))
    return SweepResult("points", ("protocol", *keys), tuple(groups), start="known")


def flat():
    """Return a sweep in which the active time is 2 s in every run."""
    groups = [
        Group({LATENCY: time, "protocol": rule}, tuple(row(r, 2.0) for r in range(3)))
        for time in TIMES
        for rule in RULES
    ]
    return SweepResult("flat", (LATENCY, "protocol"), tuple(groups), start="announced")


def raced(count=3, *, is_decided=True, maximise=False, common=True, apart=1.0, **options):
    """Return a race that configuration 1 won: the last was dropped first, the first one two runs later."""
    base = np.array([3.0, 3.5, 2.5, 3.2, 2.9, 3.1, 3.4])
    samples = [
        base[: 7 if k in (0, 1) else 5] + apart * abs(k - 1) + 0.1 * (np.arange(7 if k in (0, 1) else 5) % 2)
        for k in range(count)
    ]
    variances = np.array([[abs(i - j) * 0.04 for j in range(count)] for i in range(count)])
    gone = [*range(count - 1, 1, -1), 0] if is_decided else range(count - 1, 1, -1)
    dropped = tuple(Dropped(k, 7 if k == 0 else 5, 1) for k in gone)
    left = (1,) if is_decided else (0, 1)
    selection = Selection(1, left, dropped, is_decided, tuple(samples), 1234, variances)
    settings = tuple({"protocol": f"rule {k}", "slot": 0.1 * k} for k in range(count))
    usual = {"name": NAME, "metric": "active_time", "unit": "s", "zone": 0.25, "confidence": 0.9, "first": 4}
    return RaceResult(**usual | options, maximise=maximise, settings=settings, selection=selection, common=common)


def sensitivity(*, screened=True, indices=True, varied=True, runs_at_point=2):
    """Return an analysis of three keys, the last of which was screened out."""
    effects = ElementaryEffects(
        (IndexEstimate(2.0, 1.5, 2.75), IndexEstimate(0.5, 0.25, 0.75), IndexEstimate(0.01, -0.01, 0.02)),
        (1.5, -0.5, 0.01),
        (0.25, 0.125, 0.02),
    )
    none = IndexEstimate(nan, nan, nan)
    parts = SobolIndices(
        (IndexEstimate(0.5, 0.25, 0.625), IndexEstimate(0.0, -0.125, 0.1)) if varied else (none, none),
        (IndexEstimate(0.75, 0.5, 0.875), IndexEstimate(0.04, -0.01, 0.125)) if varied else (none, none),
        3.0,
        1.0 if runs_at_point > 1 else nan,
        varied,
        IndexEstimate(0.5, 0.125, 0.75) if varied else none,
    )
    ranges = {LATENCY: "log:0.01:1", LOSS: "0:0.5", "file$": "a, b"}
    return SensitivityResult(
        NAME,
        "active_time",
        "s",
        ranges,
        runs_at_point,
        96,
        effects if screened else None,
        (0, 1),
        parts if indices else None,
    )


def benchmark():
    """Return a benchmark of two scenarios and one that is left out, with a protocol of the caller's."""
    seeds = np.array([0.0, 0.1, -0.1, 0.05])

    def costs(as_it_is, perfect):
        return {AS_IT_IS: as_it_is + seeds, PERFECT: perfect + seeds[::-1]}

    def scenario(bounds, **others):
        reference = costs(12.0, 10.0) | {SILENT: bounds + 2.0 * seeds}
        return {REFERENCE: reference, **{name: costs(*both) for name, both in others.items()}}

    mine = {"mine $1$": (20.0, 8.0), OMNISCIENT: (9.0, 9.0), "deaf": (40.0, 40.0)}
    kept = {
        name: scenario(50.0, **mine, **others) for name, others in {"loss": {}, "late": {"some": (11.0, 9.0)}}.items()
    }
    left_out = {"still": scenario(10.1, **mine)}
    return Benchmark(
        "1", kept | left_out, ("mine $1$",), (NoPart("some", "loss", "needs positions"),), {"still": left_out["still"]}
    )


def explanation(metrics=("active_time", "messages_sent", "heat"), failed=1):
    """Return what two imperfections cost in some metrics, with bounds in the first; some seeds failed."""

    def cost(label, unit, more_is, ideal, first, second, rest, bounds=None):
        one, other, left = ([value + noise for noise in NOISE] for value in (first, second, rest))
        other = [second] * 3 if second == 0.0 else other
        together = [sum(parts) for parts in zip(one, other, left, strict=True)]
        base = [ideal + noise for noise in NOISE]
        whole = [low + more for low, more in zip(base, together, strict=True)]
        parts = {"latency": Saving.of(one), "loss": Saving.of(other)}
        return Cost(
            label, unit, mean(whole), mean(base), parts, Saving.of(together), Saving.of(left), more_is, 0.995, bounds
        )

    bounds = Bounds.of([4.0, 4.5, 3.8], [30.0, 29.5, 30.5])
    costs = {
        "active_time": cost("sum of active times", "s", "worse", 4.0, 10.0, 0.0, 8.0, bounds),
        "messages_sent": cost("messages", "", "better", 100.0, -20.0, 5.0, 0.1),
        "heat": cost("heat $Q$", "J", None, 2.0, 0.1, 1.0, 0.0),
    }
    return Explanation(NAME, 3, failed, ("faults", "lies"), {metric: costs[metric] for metric in metrics})


def comparison(metrics=("active_time", "heat"), *, seeds=10, scale=1.0, times=TIMES):
    """Return two sweeps side by side; the second has a further configuration; times grow with the powers of a scale."""
    first = swept({"protocol": RULES[:1], LATENCY: times[:2]}, time=lambda k: (1.0 + k) * scale**k)
    second = swept({"protocol": RULES[1:], LATENCY: times}, time=lambda k: (5.0 + k) * scale**k)
    if seeds != 10:
        groups = [
            Group(
                group.settings,
                tuple(Row(r.replication, r.seed + seeds, r.status, r.summary, r.traceback) for r in group.rows),
            )
            for group in second.groups
        ]
        second = SweepResult(second.name, second.keys, tuple(groups), units=second.units)
    return Comparison.of(first, second, metrics, ("old", NAME), {"horizon": ("1", "2")})


def controlled(large=0.0):
    """Return means of two rules that a control explains, of one that it does not, and of the control itself.

    The times of the second rule are larger by `large`, s.
    """
    chance = np.array([0.0, 0.5, -0.2, 0.4, -0.6, 0.1])
    other = np.array([0.3, -0.3, 0.2, 0.1, -0.1, -0.2])
    noise = np.array([0.0, 0.01, 0.02, -0.01, 0.0, -0.02])
    times = {"sap": 3.0 + chance + noise, "cbba": 4.0 + large + chance * 0.5 + other, "centralised": 2.0 + chance}
    groups = tuple(
        Group({"protocol": rule}, tuple(row(k, time) for k, time in enumerate(numbers)))
        for rule, numbers in times.items()
    )
    base = Group({}, tuple(row(k, 2.0 + (chance[k] if k < 6 else 0.05 * (k % 3))) for k in range(20)))
    result = SweepResult(NAME, ("protocol",), groups)
    return Controlled(result, (base, base, None), "centralised", 20, 20, ("active_time",))


def agreement(late=2_000_000):
    """Return two live runs, whose timers were late, ns, beside simulated ones of which one went otherwise."""
    live = []
    for result in (history(), pair()):
        conduct = Conduct()
        conduct.note(0, [1_000_000, late], [500_000])
        conduct.orders.append(10_000_000)
        live.append(LiveResult(result.scenario, result.seed, result.trace, conduct))
    return Agreement(history().scenario, live, [pair(), pair()])
