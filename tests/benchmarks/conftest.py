"""What is printed after the benchmarks: the laps of each way pooled, and what it does in a second."""

from collections import defaultdict
from statistics import median

import pytest

from desim.analysis.tables import aligned

BY_MODEL = "publish by model"
"""The group in which models of links are compared with each other."""


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
    """Print what each way does in a second, medians of the laps."""
    deliveries = defaultdict(dict)
    for each in config._benchmarksession.benchmarks:
        if "deliveries_per_second" in each.extra_info:
            deliveries[each.group][each.name] = each.extra_info["deliveries_per_second"]
    by_model = deliveries.pop(BY_MODEL, {})
    if deliveries:
        terminalreporter.section("deliveries per second")
        terminalreporter.write_line(_rates(deliveries))
    if by_model:
        terminalreporter.section(f"{BY_MODEL}: deliveries per second, and share of the ideal")
        rows = [(model, f"{rate:,.0f}", f"{rate / by_model['ideal']:.2f}") for model, rate in by_model.items()]
        terminalreporter.write_line(aligned(rows))


def _rates(deliveries):
    ways = list(dict.fromkeys(way for found in deliveries.values() for way in found))
    rows = [("", *ways)]
    for workload, found in deliveries.items():
        rows.append((workload, *(f"{found[way]:,.0f}" if way in found else "-" for way in ways)))
    return aligned(rows)
