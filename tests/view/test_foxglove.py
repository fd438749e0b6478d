"""MCAP files, as the library mcap reads them: the messages are valid by their schemas, and nothing is missing."""

import json
from collections import Counter, defaultdict

import numpy as np
import pytest
from mcap.reader import make_reader

from desim.analysis.knowledge import knowledge
from desim.analysis.trace_index import started
from desim.kernel.core.events import LOST, Broadcast, Lost, Sent
from desim.kernel.core.units import SECOND
from desim.pursuit.core.events import Captured, Sampled
from desim.view.formats.foxglove import SHOWN, TOPICS, write
from desim.view.formats.foxglove_schemas import SCHEMAS
from desim.view.headings import Headings
from tests.golden import golden
from tests.view.by_hand import MS, history, pair

TYPES = {"number": (int, float), "integer": int, "string": str, "boolean": bool}


def matches(value, schema):
    """Return whether a value has the form that a schema of this module describes, with all keys of an object."""
    match schema["type"]:
        case "object":
            keys = schema["properties"]
            return set(value) == set(keys) and all(matches(value[key], keys[key]) for key in keys)
        case "array":
            return isinstance(value, list) and all(matches(each, schema["items"]) for each in value)
        case kind:
            return isinstance(value, TYPES[kind]) and isinstance(value, bool) == (kind == "boolean")


def read(file):
    """Return the (time in ns, content) of the messages of an MCAP file by topic, in order."""
    found = defaultdict(list)
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert schema.name == TOPICS[channel.topic]
            assert json.loads(schema.data) == {"title": schema.name, **SCHEMAS[schema.name]}
            assert message.log_time == message.publish_time
            content = json.loads(message.data)
            whole = {"latency": 0.0} | content if channel.topic == "/messages" else content  # a lost one has none
            assert matches(whole, SCHEMAS[schema.name])
            found[channel.topic].append((message.log_time, content))
    return found


def stamp(time):
    return time["sec"] * SECOND + time["nsec"]


@pytest.fixture
def exported(tmp_path):
    """Return a function from a result to the messages of its MCAP file."""

    def export(result, beliefs=None):
        count = write(result.trace, tmp_path / "x.mcap", beliefs)
        found = read(tmp_path / "x.mcap")
        assert count == sum(map(len, found.values()))
        return found

    return export


@pytest.mark.parametrize("run", [history, pair])
def test_the_messages_of_a_file_are_golden(exported, run):
    """With the sizes, colours and widths of what is drawn, which no schema bounds."""
    result = run()
    found = exported(result, knowledge(result))
    golden(
        f"foxglove/{run.__name__}.txt",
        {topic: "\n".join(f"{t} {json.dumps(content)}" for t, content in found[topic]) for topic in sorted(found)},
    )


def test_the_frames_of_the_players_are_at_the_recorded_positions(exported):
    result = pair()
    found = exported(result)["/tf"]
    samples = [result.trace.events[0], *result.trace.of(Sampled)]
    assert [t for t, _ in found] == [sample.t for sample in samples]
    for (t, content), sample in zip(found, samples, strict=True):
        places = {each["child_frame_id"]: tuple(each["translation"].values()) for each in content["transforms"]}
        wanted = {f"pursuer {k}": (*place, 0.0) for k, place in enumerate(sample.pursuers)}
        assert places == wanted | {f"evader {k}": (*place, 0.0) for k, place in enumerate(sample.evaders, start=1)}
        assert {each["parent_frame_id"] for each in content["transforms"]} == {"world"}
        assert {tuple(each["rotation"].values()) for each in content["transforms"]} == {(0.0, 0.0, 0.0, 1.0)}
        assert {stamp(each["timestamp"]) for each in content["transforms"]} == {t}


def test_the_frames_of_robots_with_inertia_are_turned_to_their_headings(tmp_path, run_of):
    result = run_of("inertia.toml", "horizon=1.0")
    write(result.trace, tmp_path / "x.mcap", headings=Headings(result.scenario, result.seed))
    headings, turned = Headings(result.scenario, result.seed), 0
    samples = [started(result), *result.trace.of(Sampled)]
    for (_, content), sample in zip(read(tmp_path / "x.mcap")["/tf"], samples, strict=True):
        rotations = [complex(each["rotation"]["w"], each["rotation"]["z"]) for each in content["transforms"]]
        assert {(each["rotation"]["x"], each["rotation"]["y"]) for each in content["transforms"]} == {(0.0, 0.0)}
        assert [each**2 for each in rotations] == pytest.approx(headings.at(sample))
        turned += rotations != [1.0] * len(rotations)
    assert turned == len(samples)


def test_the_colours_of_the_players_follow_their_actions(exported):
    """0 and 1 chase at first, 0 alone from 150 ms on, none from 400 ms on, 2 alone from 800 ms on until the capture.

    The players are spread over 10 m at the start; a body is a fiftieth of that.
    """
    shown = []
    for t, content in exported(history(samples=range(0, 1001, 100)))["/players"]:
        parts = {each["id"]: (*each["cubes"], *each["spheres"]) for each in content["entities"]}
        assert all(len(each) == 1 for each in parts.values())
        assert {tuple(each[0]["size"].values()) for each in parts.values()} == {(0.2, 0.2, 0.2)}
        assert {each["frame_id"] for each in content["entities"]} == set(parts)
        blues = [round(parts[f"pursuer {k}"][0]["color"]["b"] * 255) for k in range(3)]
        shown.append((t // MS, blues, parts["evader 1"][0]["color"]["a"]))
    alone, together, none = 0xB2, 0xE9, 0x99
    assert shown == [
        (0, [together, together, none], 1.0),
        (200, [alone, none, none], 1.0),
        (400, [none, none, none], 1.0),
        (800, [none, none, alone], 1.0),
        (1000, [none, none, none], 0.4),
    ]


def test_each_message_is_listed_and_drawn_while_it_is_in_flight(exported):
    result = history()
    found = exported(result)
    sent = [event for event in result.trace if isinstance(event, Broadcast | Sent)]
    wanted = [
        (event.t, event.transmission, event.src, dst, arrival) for event in sent for dst, arrival in event.fates()
    ]
    assert [t - round(each["waited"] * SECOND) for t, each in found["/messages"]] == [
        event.created for event in sent for _ in event.fates()
    ]
    listed = [
        (
            t,
            each["transmission"],
            each["src"],
            each["dst"],
            t + round(each["latency"] * SECOND) if "latency" in each else LOST,
        )
        for t, each in found["/messages"]
    ]
    assert listed == wanted
    lines = [(t, each) for t, content in found["/in_flight"] for each in content["entities"]]
    ends = {(t, each["id"]): t + stamp(each["lifetime"]) for t, each in lines}
    arrive = {(t, f"{number} to {dst}"): arrival for t, number, _, dst, arrival in wanted if arrival != LOST}
    lose = {(event.t, f"{event.transmission} to {event.dst}"): event.t + SHOWN for event in result.trace.of(Lost)}
    assert ends == arrive | lose
    first = dict(lines)[100 * MS]["lines"][0]
    assert [tuple(point.values()) for point in first["points"]] == [(0.0, 0.0, 0.0), (0.0, 10.0, 0.0)]  # that lost to 2


def test_the_log_tells_of_changes_captures_faults_and_losses(exported):
    log = [(t // MS, each["name"], each["message"]) for t, each in exported(history())["/log"]]
    assert (150, "pursuer 1", "stops") in log
    assert (160, "pursuer 1", "stops") not in log
    assert (400, "pursuer 0", "breaks down") in log
    assert (500, "pursuer 2", "message to 0 lost: crash") in log
    assert (800, "pursuer 2", "chases evader 1") in log
    assert (1000, "pursuer 2", "captures evader 1") in log
    assert log[-1] == (1000, "run", "ends: captured")
    assert [text for _, name, text in log if name == "faults"][1].startswith("ends: Crash(")


@pytest.mark.slow
def test_the_levels_of_the_log_are_those_of_foxglove(exported):
    """In the schema foxglove.Log, 1 is DEBUG, 2 INFO and 3 WARNING."""
    levels = {"faults": set(), "pursuer": set(), "run": set()}
    for _, entry in exported(history())["/log"]:
        levels[entry["name"].split()[0]].add(entry["level"])
    assert levels == {"faults": {3}, "pursuer": {1, 2}, "run": {2}}


def test_beliefs_are_those_of_the_analysis(exported, run_of):
    result = run_of("recorded.toml", "horizon=0.2")
    pieces = knowledge(result)
    found = exported(result, pieces)["/beliefs"]
    wanted = np.sort(pieces, order=["begin", "reader", "source"])
    assert sorted((t, each["pursuer"], each["teammate"], each["active"]) for t, each in found) == [
        (int(piece["begin"]), int(piece["reader"]), int(piece["source"]), int(piece["active"])) for piece in wanted
    ]
    assert "/beliefs" not in exported(result)


@pytest.mark.whole_but_one
@pytest.mark.slow
@pytest.mark.parametrize("name", ["faults.toml", "contention.toml", "many.toml", "search.toml"])
def test_a_run_of_many_events_is_readable(exported, run_of, name):
    result = run_of(name, "record.messages=true", "horizon=1.0")
    found = exported(result, knowledge(result))
    kinds = Counter(type(event).__name__ for event in result.trace)
    assert len(found["/tf"]) == kinds["Sampled"] + 1
    assert len(found["/messages"]) == sum(
        len(list(event.fates())) for event in result.trace if isinstance(event, Broadcast | Sent)
    )
    assert sum("captures" in each["message"] for _, each in found["/log"]) == len(result.trace.of(Captured))
