"""The check of a protocol in a scenario: `assert_holds`."""

import shlex
from collections.abc import Iterable

from desim.analysis.properties import Stated, judge, stated
from desim.config.arguments import naming_arguments, scenario_argument
from desim.kernel.core.seeds import seed_list
from desim.scenario.properties import CANNOT_FAIL, recording
from desim.scenario.scenario import Scenario
from desim.simulation.run import run


@naming_arguments
def assert_holds(scenario: Scenario, prop: Stated, seeds: Iterable[int] = range(20)) -> None:
    """Check that runs of a scenario keep a property; use it in a test of your protocol.

        def test_my_protocol_leaves_no_evader_alone():
            assert_holds(load("relay.toml"), "idle never longer than 1 against centralised", seeds=range(10))

    Args:
        scenario: the scenario.
        prop: the property, or its text.
        seeds: the seeds of the runs; a property with a reference takes two runs for each.

    Raises:
        AssertionError: if a run violates the property; the text has the seed, the margin and when it happened.
        ValueError: if the property does not fit the scenario, no run of it can violate the property, or there is no
            seed.
    """
    scenario_argument(Scenario).check(scenario, "assert_holds")
    prop = stated(prop, scenario)
    if not prop.can_fail(scenario):
        raise ValueError(f"property {prop.text!r} says nothing: {CANNOT_FAIL}")
    recorded = recording(scenario, [prop])
    if not (seeds := seed_list(seeds)):
        raise ValueError("assert_holds needs a seed: without a run, any property holds")
    for seed in seeds:
        verdict = judge(prop, run(recorded, seed))
        if not verdict.holds:
            reference = "" if verdict.reference is None else f", {verdict.reference:g} under {prop.against}"
            raise AssertionError(
                f"{scenario.protocol_name} in {scenario.name} with seed {seed} violates {shlex.quote(prop.text)} by"
                f" {-verdict.margin:g} {prop.unit}, from {verdict.at:g} s on (measured: {verdict.measure:g}{reference})"
            )
