"""What is printed after the benchmarks: laps pooled, and ratios beside their targets, which are not asserted."""

from collections import defaultdict
from statistics import median

import pytest

from desim.analysis.tables import aligned

TARGETS = [
    ("publish", "documented", {"W1": 30.0, "W2": 30.0, "W3": 30.0}),
    ("publish", "by hand, drawn at once", {"W1": 4.0, "W2": 4.0, "W3": 4.0, "W4": 15.0}),
    ("send", "by hand, drawn at once", {"W1": 1.0, "W2": 1.0, "W3": 1.0, "W4": 1.0}),
]
"""How many times the deliveries per second of the other way the first should make at least, by workload."""
BY_MODEL = "publish by model"
"""The group in which models of links are compared with each other."""
MOST = 1.3
"""How many times the time per slot of the bare loop desim should take at most."""


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session):
    """Make one benchmark of all laps of a way, before pytest-benchmark makes its table."""
    benchmarks = session.config._benchmarksession.benchmarks
    laps = defaultdict(list)
    for lap in benchmarks:
        if lap and "lap" in (lap.params or {}):
            laps[lap.group, lap.params["way"]].append(lap)
    for (_, way), (first, *others) in laps.items():
        first.name = way
        for unit in list(first.extra_info):
            rates = [lap.extra_info[unit] / lap.stats.data[0] for lap in (first, *others)]
            first.extra_info[f"{unit}_per_second"] = median(rates)
        for lap in others:
            first.stats.data += lap.stats.data
            benchmarks.remove(lap)
    return (yield)


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter, config):
    """Print what each way does in a second, medians of the laps, and the ratios."""
    deliveries, slots = defaultdict(dict), {}
    for each in config._benchmarksession.benchmarks:
        if "deliveries_per_second" in each.extra_info:
            deliveries[each.group][each.name] = each.extra_info["deliveries_per_second"]
        elif "slots_per_second" in each.extra_info:
            slots[each.name] = each.extra_info["slots_per_second"]
    by_model = deliveries.pop(BY_MODEL, {})
    if deliveries:
        terminalreporter.section("deliveries per second, and their ratios")
        terminalreporter.write_line(f"{_rates(deliveries)}\n\n{_ratios(deliveries)}")
    if by_model:
        terminalreporter.section(f"{BY_MODEL}: deliveries per second, and share of the ideal")
        rows = [(model, f"{rate:,.0f}", f"{rate / by_model['ideal']:.2f}") for model, rate in by_model.items()]
        terminalreporter.write_line(aligned(rows))
    if len(slots) == 2:
        terminalreporter.section("time per slot, desim / bare loop")
        ratio = slots["bare loop"] / slots["desim"]
        terminalreporter.write_line(f"{ratio:.2f} ({'target' if ratio <= MOST else 'MISSED'} <= {MOST})")


def _rates(deliveries):
    ways = list(dict.fromkeys(way for found in deliveries.values() for way in found))
    rows = [("", *ways)]
    for workload, found in deliveries.items():
        rows.append((workload, *(f"{found[way]:,.0f}" if way in found else "-" for way in ways)))
    return aligned(rows)


def _ratios(deliveries):
    rows = [("", *(f"{way} / {other}" for way, other, _ in TARGETS))]
    for workload, found in deliveries.items():
        rows.append((workload, *(_ratio(found, way, other, aims.get(workload[:2])) for way, other, aims in TARGETS)))
    return aligned(rows)


def _ratio(found, way, other, least):
    if way not in found or other not in found:
        return "-"
    ratio = found[way] / found[other]
    if least is None:
        return f"{ratio:.2f}"
    return f"{ratio:.2f} ({'target' if ratio >= least else 'MISSED'} >= {least:g})"
