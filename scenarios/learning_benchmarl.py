"""Train a rule with BenchMARL on TorchRL, and compare it with the rules of the literature.

MAPPO trains one network for all pursuers, each of which observes what it knows; the critic, which is needed in training
only, sees the true state. The game is that of `python -m scenarios.learning`, in rounds. The protocol `policy` then
runs the network from the file OUT/NAME.weights.json, and is compared on seeds that the training has not seen.
"""

from click import IntRange, Option

from scenarios.studies.library_runs import require, show
from scenarios.studies.study import Options, study


@study(
    "learning_benchmarl",
    __doc__,
    30,
    Option(
        ["--steps"], type=IntRange(min=1), default=250_000, show_default=True, help="Steps of pursuers in training."
    ),
    seconds=0.4,
    once=360,
)
def main(options: Options) -> None:
    """Train and compare."""
    require("torch", "torchrl", "benchmarl")
    from scenarios.studies.benchmarl_runs import train

    rule, curve = train(options.seed, options.extra["steps"])
    show(options, "learned with BenchMARL", rule, curve)


if __name__ == "__main__":
    main()
