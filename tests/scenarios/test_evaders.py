"""The study of evaders: what is in its tables and its picture, and what it claims."""

import numpy as np
import pytest

from desim import run, summary
from desim.analysis.drawing.plots import COLUMN
from desim.analysis.metrics import end_time
from desim.analysis.statistics import NORMAL_975, Estimate, estimate, share
from desim.kernel.core.events import Sent, Trace
from desim.pursuit.core.events import Ended, Sampled, Started
from desim.pursuit.sensing.sensing import Sighting
from desim.pursuit.team.announcements import Announcements
from desim.scenario.scenario import Motion
from desim.simulation.run import Result
from desim.study.workers.batch import run_many
from scenarios import evaders
from scenarios.studies import evaders_runs
from scenarios.studies.evaders_runs import CLAIMED, IDEAL, REFERENCE
from tests.scenarios.patching import patch_study
from tests.summaries import changed

TINY = ("pure evasion", "pure, of active", "still")


@pytest.fixture
def tiny(monkeypatch):
    """The study, cut down to what a test has time for."""
    patch_study(
        monkeypatch, (evaders, evaders_runs), "STRATEGIES", {name: evaders_runs.STRATEGIES[name] for name in TINY}
    )
    patch_study(monkeypatch, (evaders, evaders_runs), "PROTOCOLS", (IDEAL, "sap", "voronoi", "centralised"))
    patch_study(monkeypatch, (evaders, evaders_runs), "RADII", (2.0, np.inf))
    patch_study(monkeypatch, (evaders, evaders_runs), "MORE", 2)
    patch_study(
        monkeypatch, (evaders, evaders_runs), "WATCHED", evaders_runs.WATCHED.model_copy(update={"horizon": 2.0})
    )


@pytest.mark.whole
def test_every_strategy_meets_every_protocol_and_every_estimate_every_radius(tiny, study, shortened):
    cut = shortened(12.0)
    document, text, picture = study(evaders.main, "--runs", "1", "--seed", "1", "--latency", "0.2")
    assert document["latency"] == 0.2
    cells = {(each["strategy"], each["protocol"]): each for each in document["cells"]}
    assert list(cells) == [(name, protocol) for name in TINY for protocol in evaders_runs.PROTOCOLS]
    assert all(each["latency"] == (0.0 if each["protocol"] == IDEAL else 0.2) for each in cells.values())
    alone = summary(run(cut(evaders_runs.chase("still", "sap", 0.2)), 1_000_000))
    assert cells["still", "sap"]["survival"]["mean"] == alone.end_time
    assert cells["still", "sap"]["active_time"]["mean"] == alone.active_time
    assert (
        cells["still", "sap"]["difference"]["mean"]
        == alone.end_time - cells[REFERENCE, "sap"]["survival"]["mean"]
        < 0.0
    )
    assert all(cells[REFERENCE, protocol]["difference"]["mean"] == 0.0 for protocol in evaders_runs.PROTOCOLS)
    sight = [(each["radius"], each["estimate"]) for each in document["sight"]]
    assert sight == [*((2.0, made) for made in evaders_runs.ESTIMATES), ("Infinity", "hold")]
    assert text.count("\nstill ") == 4
    assert "sap: an evader that ignores inactive pursuers" in text
    assert "L = 0.2 s, 2 runs" in text
    for word in (
        "lives longer than pure evasion by (s)",
        "SAP, L = 0.2 s",
        "captured (% of runs)",
        "constant velocity",
    ):
        assert word in picture


def test_a_scenario_is_of_the_strategy_the_protocol_and_the_latency_it_is_named_for():
    for protocol, kind, latency in ((IDEAL, "sap", 0.0), ("cbba", "cbba", 0.3)):
        for name, strategy in evaders_runs.STRATEGIES.items():
            found = evaders_runs.chase(name, protocol, 0.3)
            assert (found.evader.strategy, found.protocol.kind) == (strategy, kind)
            assert found.network.latency.value == latency


def test_a_cell_is_compared_with_pure_evasion_run_by_run():
    """Times 5 and 7 s, and 4 and 5 s of pure evasion: 1 and 2 s more, so 1.5 s, +- 12.706 * 0.5 s."""
    one = summary(run(evaders_runs.chase("still", "voronoi").model_copy(update={"horizon": 0.02}), 0))
    runs, reference = ([changed(one, end_time=t) for t in times] for times in ((5.0, 7.0), (4.0, 5.0)))
    found = evaders_runs.cell(("still", "sap"), 0.1, runs, reference=reference)
    assert (found.survival.mean, found.difference.mean, found.captured) == (6.0, 1.5, 0.0)
    assert found.difference.half_width == pytest.approx(12.706 * 0.5, rel=1e-4)


@pytest.mark.parametrize(
    ("difference", "half_width", "verdict"),
    [(1.0, 0.5, "lives longer"), (0.4, 0.5, "shows no significant difference"), (-1.0, 0.5, "lives less long")],
)
def test_the_table_claims_what_its_interval_allows(difference, half_width, verdict):
    (line,) = evaders.claims([made(CLAIMED, IDEAL, difference, half_width)])
    assert verdict in line
    assert f"({difference - half_width:+.2f} .. {difference + half_width:+.2f} s)" in line


def made(strategy, protocol, difference, half_width=0.5):
    """Return a cell of which only the paired difference matters, s."""
    estimates = [Estimate(mean, width / NORMAL_975, 10**9) for mean, width in ((6.0, 1.0), (difference, half_width))]
    return evaders_runs.Cell(strategy, protocol, 0.0, *estimates, 1.0, estimates[0], 0.0)


@pytest.mark.own_trace
def test_an_evader_is_lost_if_once_sighted_it_stays_unseen_for_long():
    """R_s = 4 m, samples every 0.05 s: far, near, 41 times far: 2.05 s > T_lost = 2 s; 40 times is not longer."""

    def observed(*distances):
        trace = Trace(messages=True)
        trace.append(Started(0, ((0.0, 0.0),), ((3.0, 0.0), (90.0, 0.0)), (1.0, 1.0), (0, 0)))
        for k, x in enumerate(distances):
            trace.append(Sampled(k * 50_000_000, ((0.0, 0.0),), ((x, 0.0), (90.0, 0.0))))
        sighting = Sighting(1, 0.1, 0.0, 0.0, 0.0, 0.0)
        for dst in (1, 2):
            trace.append(Sent(10**9, 7, 0, dst, 10**9, 10**9, 64, (sighting,)))
        trace.append(Sent(10**9, 8, 0, 1, 10**9, 10**9, 24, ("something else",)))
        trace.append(Ended(30 * 10**9, "horizon", None))
        return evaders_runs.observe(Result(evaders_runs.watched(4.0, "hold"), 0, trace))

    found = observed(9.0, 3.0, *[5.0] * 41)
    assert (found.never_seen, found.lost, found.reports, found.report_transmissions) == (False, True, 2, 1)
    assert (found.captured, found.survival, found.active_time) == (False, 30.0, 0.0)
    assert not observed(9.0, 3.0, *[5.0] * 40, 4.0, *[5.0] * 40).lost
    assert not observed(*[9.0] * 99, 3.0).lost
    never = observed(*[9.0] * 99)
    assert (never.never_seen, never.lost) == (True, False)


def test_reports_are_counted_per_second_of_the_pursuits():
    """10 and 50 messages in 2 and 4 s."""
    runs = [
        evaders_runs.Watched(True, 2.0, 1.0, never_seen=False, lost=True, reports=10, report_transmissions=2),
        evaders_runs.Watched(False, 4.0, 2.0, never_seen=False, lost=False, reports=50, report_transmissions=10),
    ]
    held = [each._replace(survival=each.survival - k, active_time=0.5) for k, each in enumerate(runs)]
    found = evaders_runs.sighted(4.0, "worst_case", runs, reference=held)
    assert (found.difference.mean, found.active_difference.mean) == (0.5, 1.0)
    assert (found.reports, found.report_transmissions) == (10.0, 2.0)
    assert (found.captured.mean, found.lost, found.never_seen, found.survival.mean) == (0.5, 0.5, 0.0, 3.0)


def errors_from_0(differences):
    """Return a mean in units of its standard error."""
    found = estimate(differences)
    return found.mean / found.standard_error


@pytest.mark.whole
def test_an_evader_that_flees_only_active_pursuers_survives_longer():
    """By 1.06 +- 0.08 s (standard error of 200 runs): that of 20 runs is 0.25 s."""
    thrifty = {"announce": Announcements(trigger="change"), "motion": Motion(step=0.02)}
    all_, active = (evaders_runs.chase(name, IDEAL).model_copy(update=thrifty) for name in (REFERENCE, CLAIMED))
    tasks = [(each, seed) for each, first in ((all_, 0), (active, 0), (all_, 20)) for seed in range(first, first + 20)]
    times = np.reshape(run_many(tasks, 1, "lives", end_time), (3, 20))
    assert errors_from_0(times[1] - times[0]) > 3.0
    assert abs(errors_from_0(times[2] - times[0])) < 3.0  # the same evader with other seeds


def all_chase(me):
    """Chase, whatever the others do."""
    me.assign(True)
    yield me.sleep(1e3)


@pytest.mark.slow
def test_fleeing_active_or_all_pursuers_is_the_same_if_all_chase():
    scenarios = [
        evaders_runs.chase(name, IDEAL).model_copy(update={"protocol": all_chase}) for name in (REFERENCE, CLAIMED)
    ]
    for seed in (0, 1):
        one, other = (run(each, seed) for each in scenarios)
        assert end_time(one) == end_time(other)


@pytest.mark.whole
def test_the_picture_is_as_wide_as_a_column_and_its_text_lies_clear():
    rows = enumerate(evaders_runs.STRATEGIES)
    cells = [made(name, protocol, 0.3 * k) for k, name in rows for protocol in evaders_runs.PROTOCOLS]
    half = share([True, False])
    sight = [
        evaders_runs.Sighted(
            radius, name, half, *(estimate([t, t + 1.0]) for t in (9.0, 0.0, 5.0, 0.0)), 0.1, 0.2, 40.0, 4.0
        )
        for radius in evaders_runs.RADII[:-1]
        for name in evaders_runs.ESTIMATES
    ]
    figure = evaders.picture(cells, sight)
    assert figure.get_size_inches()[0] == pytest.approx(COLUMN)
    figure.draw_without_rendering()
    strategies, shares, _ = figure.axes
    assert [each.get_text() for each in strategies.get_yticklabels()] == list(evaders_runs.STRATEGIES)[1:]
    assert [each.get_text() for each in shares.get_xticklabels()] == ["2", "4", "8", "16"]
    said = [each for axes in figure.axes for each in (axes.xaxis.label, axes.yaxis.label) if each.get_text()]
    assert all("(" in each.get_text() for each in said)
    boxes = [each.get_window_extent() for each in (*said, *strategies.get_yticklabels())]
    for k, box in enumerate(boxes):
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in boxes[k + 1 :])
