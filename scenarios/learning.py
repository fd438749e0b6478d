"""Train a rule and compare it with the rules of the literature: the cross-entropy method, with numpy only.

A linear rule of six features, "chase if their weighted sum is positive", is trained at a latency of 0.1 s to minimise
the active time of the team plus three times the time in which nobody chases. Then it is compared with local_min,
Spatial Adaptive Play and pursuers that always chase, at several latencies, on seeds that the training has not seen.
With --delays, a rule trained without delay is compared instead with one trained with a delay of 1 s, each without and
with the delay.

An interrupted study goes on where it was, because OUT/NAME.progress.json has what it has measured. The weights of the
rule are in OUT/learning.weights.json, for `protocol = { kind = "policy", file = "learning.weights.json" }`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click
from click import Option

from desim.analysis.drawing import palette
from desim.analysis.tables import aligned
from scenarios.studies.learning_runs import (
    CANDIDATES,
    DELAY,
    LATENCIES,
    LATENCY,
    NO_DELAY,
    RIVALS,
    Cell,
    Generation,
    compare,
    costs_table,
    in_words,
    linear,
    notebook,
    train,
)
from scenarios.studies.study import Options, study

if TYPE_CHECKING:
    from desim.analysis.drawing.plots import Axes, Figure

WITHOUT, WITH = "trained without delay", f"trained with {DELAY:g} s"


def weights_table(weights: Sequence[float]) -> str:
    """Return the weights in words."""
    rows = [(name, f"{weight:+.2f}", meaning) for name, weight, meaning in in_words(weights)]
    return f"Weights, the strongest first\n{aligned([('feature', 'weight', 'the pursuer'), *rows])}"


def picture(generations: Sequence[Generation], cells: Sequence[Cell]) -> "Figure":
    """Draw the learning curve, the costs over the latency, and the weights in words."""
    from desim.analysis.drawing import plots

    with plots.styled(figsize=(9.0, 6.0)) as figure:
        rows: Any = figure.subfigures(2, 1)
        above, below = rows
        (curve, costs), words = above.subplots(1, 2), below.subplots()
        numbers = range(1, len(generations) + 1)
        curve.plot(numbers, [generation.typical for generation in generations], color=palette.GREY, label="all")
        best = [generation.best for generation in generations]
        curve.plot(numbers, best, color=palette.SERIES[0], label=f"least of {CANDIDATES} candidates")
        rival = next((cell.cost for cell in cells if (cell.rule, cell.latency) == ("local_min", LATENCY)), None)
        if rival is not None:
            curve.axhline(rival, color=palette.SERIES[1], ls=":", label="local_min, unseen seeds")
        curve.set(xlabel="generation", ylabel="cost (s)", yscale="log")
        curve.legend(fontsize=7)
        _draw_costs(costs, cells)
        _draw_words(words, generations[-1].mean)
    return figure


def _draw_costs(axes: "Axes", cells: Sequence[Cell]) -> None:
    """Draw the cost of each rule over the latency."""
    rules = dict.fromkeys(cell.rule for cell in cells)
    for colour, mark, rule in zip(palette.SERIES, palette.MARKERS, rules, strict=False):
        line = [cell for cell in cells if cell.rule == rule]
        axes.errorbar(
            [cell.latency for cell in line],
            [cell.cost for cell in line],
            yerr=[cell.standard_error for cell in line],
            color=colour,
            marker=mark,
            ms=3,
            label=rule,
        )
    axes.set(xlabel="latency (s)", ylabel="cost, unseen seeds (s)", yscale="log")
    axes.legend(fontsize=7)


def _draw_words(axes: "Axes", weights: Sequence[float]) -> None:
    """Draw each weight as a bar, with its meaning."""
    named = in_words(weights)
    axes.barh(range(len(named)), [weight for _, weight, _ in named], color=palette.SERIES[0])
    axes.set_yticks(range(len(named)), [meaning for _, _, meaning in named])
    axes.invert_yaxis()
    axes.axvline(0.0, color="black", lw=0.8)
    axes.set(xlabel="weight")


def _with_delays(options: Options) -> None:
    """Train a rule without delay and one with it, and compare both without and with the delay."""
    options = replace(options, name="learning_delays")
    notes = notebook(options)
    trained = {WITHOUT: train(options, notes, NO_DELAY), WITH: train(options, notes, DELAY)}
    rules = {name: linear(generations[-1].mean) for name, generations in trained.items()}
    cells = compare(options, notes, rules | {"local_min": RIVALS["local_min"]}, (NO_DELAY, DELAY))
    tables = (f"{name}\n{weights_table(generations[-1].mean)}" for name, generations in trained.items())
    text = "\n\n".join([costs_table(cells, options.runs), *tables])
    content: dict[str, Any] = {name: {"training": generations, "costs": []} for name, generations in trained.items()}
    options.show(content | {"costs": cells}, text)


@study(
    "learning",
    __doc__,
    30,
    Option(["--delays"], is_flag=True, help="Compare training with and without delay instead."),
    seconds=0.4,
    once=30,
)
def main(options: Options) -> None:
    """Train, compare and draw."""
    if options.extra["delays"]:
        _with_delays(options)
        return
    notes = notebook(options)
    generations = train(options, notes, LATENCY)
    learned = linear(generations[-1].mean)
    cells = compare(options, notes, {"learned": learned, **RIVALS}, LATENCIES)
    text = f"{costs_table(cells, options.runs)}\n\n{weights_table(generations[-1].mean)}"
    options.show({"training": generations, "costs": cells}, text, lambda: picture(generations, cells))
    click.echo(f"wrote {learned.write(options.out / 'learning.weights.json')}", err=True)


if __name__ == "__main__":
    main()
