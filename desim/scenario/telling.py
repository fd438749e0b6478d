"""What pursuers tell each other in a scenario, as far as that is known before a run; the warnings depend on it."""

from typing import Any

from desim.config.choice import choices_of
from desim.pursuit.core.traits import DisseminationTraits
from desim.pursuit.team.announcements import DISSEMINATIONS
from desim.scenario.scenario import PROTOCOLS, Scenario


def is_built_in(scenario: Scenario) -> bool:
    """Return whether protocol, schedule and dissemination are built in, so that it is known what they send."""
    protocol: Any = scenario.protocol
    if not (PROTOCOLS.holds(protocol) and DISSEMINATIONS.holds(scenario.announce.dissemination)):
        return False
    fields = type(protocol).model_fields
    return "schedule" not in fields or all(kind.holds(protocol.schedule) for kind in choices_of(fields["schedule"]))


def tells_nothing(scenario: Scenario) -> bool:
    """Return whether no message has the action or the state of a pursuer: no announcement, report or token."""
    has_token = scenario.schedule_traits.spreads_to is not None
    return is_built_in(scenario) and not (scenario.announces or scenario.protocol_traits.reckons or has_token)


def announces_start(scenario: Scenario) -> bool:
    """Return whether several pursuers announce their first actions at the start."""
    return scenario.announces and scenario.announce.start == "announced" and scenario.team.count > 1


def sends_announcements(scenario: Scenario) -> bool:
    """Return whether announcements are sent as messages, not published."""
    traits = DisseminationTraits.of(scenario.announce.dissemination)
    return traits.transport is not None or traits.relays


def has_heartbeats(scenario: Scenario) -> bool:
    """Return whether pursuers announce their actions periodically."""
    return scenario.announces and scenario.announce.has_heartbeats
