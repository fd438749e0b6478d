"""A key that is said to have no effect has none: without it the trace is the same, byte for byte."""

from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from desim import Scenario, run
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.kernel.models.transport import TRANSPORTS
from desim.pursuit.byzantine.lies import LIES
from desim.pursuit.team.announcements import DISSEMINATIONS
from desim.pursuit.team.trust import TRUSTS
from desim.scenario.checks import warnings
from desim.scenario.scenario import PROTOCOLS
from protocols.rule import SCHEDULES

FIELDS = {kind: model.model_fields for kind, model in PROTOCOLS.choices().items()}
MEDIA: list[Any] = [
    None,
    {"kind": "bitrate", "bitrate": 1e5, "reception": {"kind": "capture"}},
    {"kind": "bitrate", "bitrate": 1e5, "half_duplex": True, "access": {"kind": "aloha"}},
    {"kind": "bitrate", "bitrate": 1e5, "access": {"kind": "csma", "p": 0.3, "slot": 0.002, "backoff": 0.003}},
    {"kind": "bitrate", "bitrate": 1e5, "access": {"kind": "csma", "persistence": "p_persistent", "attempts": 2}},
]
SENSING: list[dict[str, Any]] = [
    {},
    {"estimate": "hold", "period": 0.3, "track_timeout": 0.2, "on_lost": "stay", "relay": True, "interval": 0.03},
    {"radius": 4.0, "relay": True},
    {"radius": 6.0, "noise": 0.2, "estimator": {"kind": "kalman"}},
]


@st.composite
def lies(draw) -> dict[str, Any]:
    """Draw a Byzantine fault, as a table of a scenario file."""
    model = draw(st.sampled_from(LIES))
    optional = {
        "acts": st.sampled_from(["protocol", "stay"]),
        "action": st.sampled_from(["truth", "chase", "stay", "opposite"]),
        "phi": st.sampled_from([0.0, {"kind": "random"}]),
        "position": st.sampled_from([{"kind": "random"}, {"kind": "shifted"}]),
    }
    drawn = {key: draw(values) for key, values in optional.items() if key in model.model_fields and draw(st.booleans())}
    accused = {"accused": [2]} if "accused" in model.model_fields else {}
    return {"kind": model.model_fields["kind"].default, "node": 1, "start": 0.1, **accused, **drawn}


@st.composite
def tables(draw) -> dict[str, Any]:
    """Draw a scenario of four pursuers, rich in keys that may have no effect, as tables of a scenario file."""
    kind = draw(st.sampled_from(sorted(FIELDS)))
    schedules = st.sampled_from([None, *SCHEDULES.choices()])
    schedule = draw(schedules) if "schedule" in FIELDS[kind] else None
    medium = draw(st.sampled_from(MEDIA))
    trust = draw(
        st.sampled_from(
            [*TRUSTS.choices(), {"kind": "reputation", "threshold": 0.9}, {"kind": "accusations", "quorum": 1}]
        )
    )
    chosen: dict[str, Any] = {
        "horizon": 0.7,
        "team": {"count": 4, "speeds": [1.2, 1.3, 1.4, 1.5]},
        "evader": {"count": draw(st.integers(1, 2))},
        "protocol": {"kind": kind, **({} if schedule is None else {"schedule": {"kind": schedule}})},
        "announce": {
            "payload": draw(st.sampled_from(["action", "time", "state", "course"])),
            "trigger": draw(st.sampled_from(["both", "never", "change"])),
            "dissemination": {"kind": draw(st.sampled_from(sorted(DISSEMINATIONS.choices())))},
            "trust": trust if isinstance(trust, dict) else {"kind": trust},
        },
        "network": {
            "loss": 0.2,
            "latency": 0.01,
            "transport": {"kind": draw(st.sampled_from(sorted(TRANSPORTS.choices())))},
            **({"reception": {"kind": "quasi_unit_disk"}} if draw(st.booleans()) else {}),
            **({} if medium is None else {"medium": medium}),
        },
        "sensing": draw(st.sampled_from(SENSING)),
        "motion": {"static": draw(st.booleans())},
        "record": {"messages": True},
    }
    if draw(st.booleans()):
        chosen["environment"] = draw(
            st.sampled_from([{"flow": {"kind": "uniform", "velocity": [0.1, 0.2]}}, {"on": "pursuers"}])
        )
    if draw(st.booleans()):
        chosen["fault"] = [draw(lies())]
    return chosen


def traced(tables) -> list[Any]:
    """Return the events of a run, but for those that say that a fault begins or ends."""
    return [
        each
        for each in run(Scenario.model_validate(tables), 3).trace
        if not isinstance(each, FaultStarted | FaultEnded)
    ]


def without(tables, key: str) -> Any:
    """Return tables without a key."""
    head, _, rest = key.partition(".")
    if isinstance(tables, list):
        changed = [without(each, rest) if rest and k == int(head) else each for k, each in enumerate(tables)]
        return changed if rest else [each for k, each in enumerate(tables) if k != int(head)]
    return {
        name: without(each, rest) if name == head else each for name, each in tables.items() if rest or name != head
    }


def check(tables) -> set[str]:
    """Compare the runs with and without each key that has no effect; return the texts of the warnings."""
    scenario, texts, usual = Scenario.model_validate(tables), set(), None
    for key, text in warnings(scenario):
        if "no effect" in text or "none is ignored" in text:
            usual = traced(tables) if usual is None else usual
            assert traced(without(tables, key)) == usual, (key, text)
            texts.add(text)
    return texts


@pytest.mark.whole
@settings(max_examples=12)
@given(tables())
def test_a_key_that_is_said_to_have_no_effect_has_none(drawn):
    try:
        Scenario.model_validate(drawn)
    except ValidationError:
        assume(False)
    check(drawn)
