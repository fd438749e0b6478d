"""Train a rule with Stable-Baselines3, and compare it with the rules of the literature.

PPO with masks (the package sb3-contrib) trains one network for all pursuers, each of which observes what it knows. The
game is that of `python -m scenarios.learning`, in rounds. The protocol `policy` then runs the network from the file
OUT/NAME.weights.json, and is compared on seeds that the training has not seen.
"""

from click import IntRange, Option

from scenarios.studies.library_runs import require, show
from scenarios.studies.study import Options, study


@study(
    "learning_sb3",
    __doc__,
    30,
    Option(
        ["--steps"], type=IntRange(min=1), default=250_000, show_default=True, help="Steps of pursuers in training."
    ),
    seconds=0.4,
    once=180,
)
def main(options: Options) -> None:
    """Train and compare."""
    require("stable_baselines3", "sb3_contrib")
    from scenarios.studies.sb3_runs import train

    rule, curve = train(options.seed, options.extra["steps"])
    show(options, "learned with SB3", rule, curve)


if __name__ == "__main__":
    main()
