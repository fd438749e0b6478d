"""The errors of a scenario file: what a user wrote is in them as it was written, and they say no more than helps."""

from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError, field_validator

from desim.config.error_texts import text_of
from desim.scenario.overrides import ScenarioError
from desim.scenario.toml import load

PHRASES = ["valid ", "invalid ", "a valid tuple", "Input should be ", "Value error, ", "a valid integer", "should be"]
"""Words that messages of pydantic have, and that other words replace there."""
TEXTS = st.lists(st.sampled_from([*PHRASES, "x", "ms", " "]), min_size=2, max_size=5).map(" ".join).map(str.strip)


def latency(**keys: str) -> dict[str, Any]:
    """Return a file with a latency."""
    return {"network": {"latency": keys}}


PLACES = {
    "the column of a file": lambda text: {
        "network": {"latency": {"kind": "trace", "table": "t,y\n0,1", "value": text}}
    },
    "a column that there is": lambda text: {"network": {"latency": {"kind": "trace", "table": f't,"{text}"\n0,1'}}},
    "a file of latencies": lambda text: {"network": {"latency": {"kind": "empirical", "file": text}}},
    "a table of netem": lambda text: {"network": {"latency": {"kind": "netem", "file": text}}},
    "a file of losses": lambda text: {"network": {"loss": {"kind": "trace", "file": text}}},
    "a graph": lambda text: {"network": {"graph": {"kind": "edges", "file": text}}},
    "a record": lambda text: {"evader": {"strategy": {"kind": "recorded", "file": text}}},
    "a flow": lambda text: {"environment": {"flow": {"kind": "recorded", "file": text}}},
    "a kind": lambda text: latency(kind=text),
    "a protocol": lambda text: {"protocol": text},
    "a module": lambda text: {"protocol": f"{text}:x"},
    "a key": lambda text: {"team": {text: 1}},
    "a key at the top": lambda text: {text: 1},
    "a metric": lambda text: {"record": {"metrics": [text]}},
    "a base": lambda text: {"base": text},
    "a choice": lambda text: {"prune": text},
    "a number": lambda text: {"horizon": text},
    "a preset": lambda text: {"network": {"preset": text}},
}


@pytest.mark.slow
@pytest.mark.whole_but_one
@pytest.mark.parametrize("place", PLACES)
@given(text=TEXTS)
def test_what_a_user_wrote_is_in_the_message_as_it_was_written(tmp_path_factory, place, text):
    file = tmp_path_factory.mktemp("f") / "f.toml"
    file.write_text(tomli_w.dumps(PLACES[place](text)))
    with pytest.raises(ScenarioError) as refused:
        load(file)
    message = str(refused.value)
    shown = text if len(text) < 55 or "(got " not in message else text[:50]  # a long value is cut
    assert shown in message


@pytest.mark.slow
@given(text=TEXTS)
def test_the_name_of_a_file_is_in_the_message_as_it_is(tmp_path_factory, text):
    file = tmp_path_factory.mktemp("f") / f"{text}.toml"
    file.write_text("horizon = -1.0")
    with pytest.raises(ScenarioError) as refused:
        load(file)
    assert str(refused.value).startswith(f"{file}:1: horizon: should be greater than 0; ")


@pytest.mark.parametrize(
    "key", ["network.latency = { kind = 'empirical', file = 'a.txt' }", "protocol.kind = 'aside:f'"]
)
def test_what_a_link_names_is_looked_up_beside_the_link_and_that_is_said(tmp_path, key):
    for folder in ("there", "here"):
        (tmp_path / folder).mkdir()
    (tmp_path / "there" / "f.toml").write_text(key)
    link = tmp_path / "here" / "f.toml"
    link.symlink_to(Path("..", "there", "f.toml"))
    with pytest.raises(
        ScenarioError, match=r"here/f\.toml is a link to \.\./there/f\.toml, and what it names is looked"
    ):
        load(link, allow_import=True)
    with pytest.raises(ScenarioError) as refused:
        load(tmp_path / "there" / "f.toml", allow_import=True)
    assert "is a link" not in str(refused.value)


def test_a_message_of_python_is_whole(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\x80")
    file = tmp_path / "f.toml"
    file.write_text("network.latency = { kind = 'empirical', file = 'a.txt' }")
    with pytest.raises(ScenarioError, match="invalid start byte"):
        load(file)


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("horizon = -1.0", "; Time t_f at which the pursuit ends at the latest, s (got -1.0)"),
        (
            "network.latency = { kind = 'empirical', file = 'no.txt' }",
            "no.txt cannot be read: No such file or directory",
        ),
        ("network.latency = { kind = 'uniform', low = 2.0, high = 1.0 }", "low should be at most high (got 2 and 1)"),
        ("network.latency.kind = 'unifrom'", "netem, propagation, per_pair, matrix, trace"),
    ],
)
def test_the_description_of_a_key_follows_a_bound_or_a_type_only(tmp_path, text, end):
    """It has the unit of a number; after a sentence about a file or a list of kinds it says nothing new."""
    file = tmp_path / "f.toml"
    file.write_text(text)
    with pytest.raises(ScenarioError) as refused:
        load(file)
    assert str(refused.value).endswith(end)


class Wrong(BaseModel):
    """A model that refuses everything with the words of its input."""

    said: str = ""
    asserted: str = ""
    number: float = 0.0

    @field_validator("said")
    @classmethod
    def _raise(cls, value):
        raise ValueError(value)

    @field_validator("asserted")
    @classmethod
    def _assert(cls, value):
        raise AssertionError(value)


@pytest.mark.slow
@given(text=TEXTS)
def test_the_text_of_an_exception_is_unchanged(text):
    with pytest.raises(ValidationError) as refused:
        Wrong(said=text, asserted=text, number="x")
    said, asserted, number = map(text_of, refused.value.errors())
    assert (said, asserted) == (text, text)
    assert number.startswith("should be a number, unable to parse")
