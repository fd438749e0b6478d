"""Measure what the initial knowledge of pursuers does to the cost of latency (`announce.start`).

First, the cost of latency is measured for three rules in two teams. In one team few pursuers could capture before the
horizon, in the other all. First actions are announced over the network, known without a message, or not announced.
Second, for the team in which few could, the cost is divided between the pursuers that could not capture in time and the
others, under the mean utility of the paper and under `minimum`. With --law, the study measures instead what announcing
first actions adds to the scaling law of `scenarios.delay` if all could capture in time; the theory is (1 - 1 / N) L
lambda. With --worth, it measures what a message saves: a team that announces its actions is compared with a silent one
that knows the same at the start.
"""

from collections.abc import Sequence

from click import Option

from desim.analysis.tables import aligned, with_half_width
from scenarios.studies.rivals_runs import SHOWN
from scenarios.studies.start_runs import (
    LATENCIES,
    LONG,
    RULES,
    TEAMS,
    Cell,
    Extra,
    Share,
    Worth,
    measure_costs,
    measure_law,
    measure_shares,
    measure_worth,
)
from scenarios.studies.study import Options, study


def table(cells: Sequence[Cell], shares: Sequence[Share], runs: int) -> str:
    """Return the costs, a table for each team, and who causes them, as text."""
    parts = [f"Sum of active times without latency, s, and its increase, {runs} runs of equal seeds, 95 % intervals"]
    for team in TEAMS:
        rows: list[tuple[str, ...]] = [("rule", "start", "L = 0", *(f"L = {latency:g} s" for latency in LATENCIES[1:]))]
        for rule in RULES:
            for cell in cells:
                if (cell.team, cell.rule) == (team, rule):
                    costs = (with_half_width(cost, runs, "+") for cost in cell.costs)
                    rows.append((rule, cell.start, with_half_width(cell.prompt, runs), *costs))
        parts.append(f"{team}\n{aligned(rows)}")
    who: list[tuple[str, ...]] = [("utility", "start", "cannot be in time", "others")]
    for share in shares:
        increases = (with_half_width(increase, runs, "+") for increase in (share.late, share.in_time))
        who.append((share.utility, share.start, *increases))
    parts.append(f"Who causes the increase at L = {LONG:g} s where few are in time, best response, s\n{aligned(who)}")
    return "\n\n".join(parts)


def law_table(extras: Sequence[Extra], runs: int) -> str:
    """Return what announcing adds to the law, as text."""
    rows: list[tuple[str, ...]] = [("schedule", "L lambda", "theory", "measured", "standard error")]
    for extra in extras:
        numbers = (extra.expected, extra.difference.mean, extra.difference.standard_error)
        rows.append((extra.schedule, f"{extra.delay:g}", *(f"{number:.3f}" for number in numbers)))
    return f"Excess with announced first actions minus that with known ones, N^2 delta, {runs} runs\n{aligned(rows)}"


def worth_table(worth: Sequence[Worth], runs: int) -> str:
    """Return what messages save, as text."""
    rows: list[tuple[str, ...]] = [("rule", "start", "speaking", "silent", "saved per message")]
    for saving in worth:
        saved = f"{1000.0 * saving.saved.mean:.2f} +- {1000.0 * saving.saved.half_width:.2f} ms"
        times = (with_half_width(time, runs) for time in (saving.speaking, saving.silent))
        rows.append((saving.rule, saving.start, *times, saved))
    return (
        f"Sum of active times, s, of teams that announce their actions and of silent ones, L = {SHOWN:g} s, {runs} runs"
        f" of equal seeds, 95 % intervals\n{aligned(rows)}"
    )


@study(
    "start",
    __doc__,
    60,
    Option(["--law"], is_flag=True, help="Measure the scaling law instead."),
    Option(["--worth"], is_flag=True, help="Measure what a message is worth instead."),
    seconds=1.7,
)
def main(options: Options) -> None:
    """Measure the costs, and who causes them; or the law; or the worth of messages."""
    if options.extra["worth"]:
        worth = measure_worth(options)
        options.show({"worth": worth}, worth_table(worth, options.runs))
        return
    if options.extra["law"]:
        extras = measure_law(options)
        options.show({"law": extras}, law_table(extras, options.runs))
        return
    cells, shares = measure_costs(options), measure_shares(options)
    options.show({"costs": cells, "who": shares}, table(cells, shares, options.runs))


if __name__ == "__main__":
    main()
