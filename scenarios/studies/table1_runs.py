"""The scenarios of Table I of Lee & Bakolas, and its published figures; `python -m scenarios.table1` compares them."""

from desim import Announcements, Motion, Scenario, load
from desim.pursuit.team.agent import Behaviour
from protocols.centralised import Centralised
from protocols.sap import SpatialAdaptivePlay
from protocols.schedules.periodic import SharedSeed
from scenarios.studies.study import SCENARIOS

DELTAS = (0.1, 0.01, 0.001)
"""The slots of the table, s."""
PUBLISHED = {
    ("centralised", 20, 0.1): 4.6000,
    ("centralised", 20, 0.01): 4.5700,
    ("centralised", 20, 0.001): 4.5580,
    ("centralised", 40, 0.1): 4.8000,
    ("centralised", 40, 0.01): 4.6900,
    ("centralised", 40, 0.001): 4.6700,
    ("decentralised", 20, 0.1): 55.5900,
    ("decentralised", 20, 0.01): 11.6580,
    ("decentralised", 20, 0.001): 5.2088,
    ("decentralised", 40, 0.1): 116.4590,
    ("decentralised", 40, 0.01): 39.0082,
    ("decentralised", 40, 0.001): 7.9598,
}
"""Sum of active times (Lee & Bakolas, Table I), s, by algorithm, N and delta (s)."""


def configuration(count: int) -> Scenario:
    """Load the scenario of Table I with `count` = 20 or 40 pursuers."""
    return load(SCENARIOS / f"table1_{count}.toml")


def centralised(base: Scenario, delta: float) -> Scenario:
    """Return a configuration under Algorithm 3, with slot and motion step `delta`, s."""
    return _with_protocol(base, Centralised(slot=delta), delta)


def decentralised(base: Scenario, delta: float, active_at_start: float = 1.0) -> Scenario:
    """Return a configuration under Algorithm 2, with slot and motion step `delta`, s."""
    start = base.team.model_copy(update={"active_at_start": active_at_start})
    protocol = SpatialAdaptivePlay(schedule=SharedSeed(slot=delta))
    return _with_protocol(base.model_copy(update={"team": start}), protocol, delta)


def _with_protocol(base: Scenario, protocol: Behaviour, delta: float) -> Scenario:
    once = Announcements(trigger="change")  # no message is lost, and Algorithm 2 repeats none
    return base.model_copy(update={"protocol": protocol, "motion": Motion(step=delta), "announce": once})
