"""A run as an MCAP file for Foxglove (https://foxglove.dev): positions, messages, decisions and beliefs over time.

The messages are JSON with the schemas in `desim.view.formats.foxglove_schemas`, which the panels of Foxglove know. The
times of messages are those of the run, which begins at the Unix epoch. The topics are

- /tf: the frame of each player in the frame `world`, at the start and at each sample of positions; the x axis of a
  player with inertia is its heading;
- /players: a sphere for each pursuer and a diamond for each evader, in their frames, with the colours of the replay;
- /in_flight: for each message a line from sender to receiver while it is in flight, and a red line when it is lost;
- /log: changes of actions, captures, faults, losses, and the end of the run;
- /messages: each transmission to each receiver;
- /beliefs: the action of a teammate as a pursuer believes it, at each update of the belief.
"""

import json
from cmath import phase
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from heapq import merge
from math import cos, sin
from pathlib import Path
from typing import Any, ClassVar, Literal

from desim.analysis.drawing.palette import ACTIVE, ACTIVE_WITH_OTHERS, EVADER, IN_FLIGHT, INACTIVE, LOST
from desim.analysis.knowledge import Pieces, knowledge
from desim.config.arguments import value_text
from desim.config.model import Value
from desim.kernel.core.events import LOST as NO_ARRIVAL
from desim.kernel.core.events import Broadcast, Event, Lost, Sent, Trace
from desim.kernel.core.trace_file import body_json
from desim.kernel.core.units import SECOND, nanoseconds, seconds
from desim.kernel.models.traced_faults import FaultEnded, FaultStarted
from desim.pursuit.core.events import BrokeDown, Captured, Decided, Ended, Sampled, Started, TracePoint
from desim.results.run_folder import StreamedResult
from desim.simulation.run import Result
from desim.view.formats.foxglove_schemas import SCHEMAS
from desim.view.headings import Headings

Message = dict[str, Any]
Entry = tuple[int, str, Message]
"""The time (ns), the topic and the content of a message."""
TOPICS = {
    "/tf": "foxglove.FrameTransforms",
    "/players": "foxglove.SceneUpdate",
    "/in_flight": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
    "/messages": "Message",
    "/beliefs": "Belief",
}
"""The schema of the messages of each topic."""
WORLD = "world"
"""The frame of reference of the positions."""
DEBUG, INFO, WARNING = 1, 2, 3
"""Levels of log messages."""
SHOWN = nanoseconds(0.1)
"""Time for which a lost message is shown, ns."""
PART = 0.02
"""Size of a player as a share of the extent of the initial positions."""
UPRIGHT: Message = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
DIAMOND: Message = {"x": 0.0, "y": 0.0, "z": 0.3826834323650898, "w": 0.9238795325112867}
"""The rotation by 45 degrees about the z axis, as (0, 0, sin 22.5 degrees, cos 22.5 degrees)."""


def write(events: Iterable[Event], file: Path, beliefs: Pieces | None = None, headings: Headings | None = None) -> int:
    """Write a run to an MCAP file, and return the number of messages; events are not held in memory.

    Args:
        events: the events of the run, in order.
        file: the path of the file.
        beliefs: the beliefs in the run, from `desim.analysis.knowledge.knowledge`; None: the topic is left out.
        headings: new `Headings` of the run; None: all players head along the x axis.

    Raises:
        ImportError: if the package mcap is not installed.
    """
    from mcap.writer import Writer

    count = 0
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="desim")
        schemas = {
            name: writer.register_schema(name, "jsonschema", json.dumps({"title": name} | schema).encode())
            for name, schema in SCHEMAS.items()
        }
        channels = {topic: writer.register_channel(topic, "json", schemas[name]) for topic, name in TOPICS.items()}
        for t, topic, message in merge(Scene(headings).entries(events), _beliefs(beliefs), key=lambda entry: entry[0]):
            data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
            writer.add_message(channels[topic], t, data, t)
            count += 1
        writer.finish()
    return count


class Mcap(Value):
    """An MCAP file for Foxglove: players, messages, beliefs and a log.

    It has beliefs only if `record.messages` is true: with "file", the trace may be too long for the memory.
    """

    kind: Literal["mcap"] = "mcap"

    suffix: ClassVar[str] = ".mcap"
    items: ClassVar[str] = "messages"
    streams: ClassVar[bool] = True
    requires: ClassVar[tuple[str, str]] = "mcap", "mcap"

    def __call__(self, result: Result | StreamedResult, file: Path) -> int:
        """Write the file, and return the number of its messages."""
        scenario, seed = result.scenario, result.seed
        if scenario is None or seed is None:  # a trace without its run.json
            return write(result.trace, file)
        if scenario.record.messages is not True:
            return write(result.trace, file, None, Headings(scenario, seed))
        whole = Trace()
        whole.events += result.trace
        return write(whole, file, knowledge(Result(scenario, seed, whole)), Headings(scenario, seed))


class Scene:
    """The players as they were last recorded; makes the messages from the events of a run."""

    def __init__(self, headings: Headings | None = None) -> None:
        self._headings = headings
        self._places: dict[str, TracePoint] = {}
        self._actions: list[int] = []
        self._captured: set[int] = set()
        self._size = 0.0
        self._must_draw = False  # whether an action has changed since the players were last drawn

    def entries(self, events: Iterable[Event]) -> Iterator[Entry]:
        """Yield the messages of the events of a run, in order of time."""
        for event in events:
            match event:
                case Started():
                    self._start(event)
                    yield from self._positions(event)
                case Sampled():
                    yield from self._positions(event)
                case Decided():
                    yield from self._decision(event.t, event.pursuer, event.active)
                case BrokeDown():
                    yield from self._decision(event.t, event.pursuer, 0, "breaks down")
                case Captured():
                    self._captured.add(event.evader)
                    self._actions = [0 if action == event.evader else action for action in self._actions]
                    self._must_draw = True
                    yield _log(event.t, f"pursuer {event.capturer}", f"captures evader {event.evader}")
                case Broadcast() | Sent():
                    yield from self._transmission(event)
                case Lost():
                    yield _log(event.t, f"pursuer {event.src}", f"message to {event.dst} lost: {event.cause}", DEBUG)
                    yield event.t, "/in_flight", _scene([self._line(event, event.dst, SHOWN, LOST)])
                case FaultStarted() | FaultEnded():
                    verb = "starts" if isinstance(event, FaultStarted) else "ends"
                    yield _log(event.t, "faults", f"{verb}: {value_text(event.fault)}", WARNING)
                case Ended():
                    if self._must_draw:
                        yield self._drawing(event.t)
                    yield _log(event.t, "run", f"ends: {event.reason}")

    def _start(self, event: Started) -> None:
        """Set the actions, and the size of the players, which depends on the initial positions."""
        self._actions = list(event.active)
        places = [*event.pursuers, *event.evaders]
        extent = max(max(axis) - min(axis) for axis in zip(*places, strict=True))
        self._size, self._must_draw = PART * extent or 1.0, True

    def _positions(self, event: Started | Sampled) -> Iterator[Entry]:
        """Yield the positions of all players and, if an action has changed, the drawing of the players."""
        pursuers = {f"pursuer {k}": place for k, place in enumerate(event.pursuers)}
        self._places = pursuers | {f"evader {k}": place for k, place in enumerate(event.evaders, start=1)}
        time, rotations = _time(event.t), [UPRIGHT] * len(self._places)
        if self._headings is not None:
            for player, heading in zip(self._headings.players, self._headings.at(event), strict=True):
                rotations[player] = _rotation(heading)
        transforms = [
            {"timestamp": time, "parent_frame_id": WORLD, "child_frame_id": name, "translation": _point(place)}
            | {"rotation": rotation}
            for (name, place), rotation in zip(self._places.items(), rotations, strict=True)
        ]
        yield event.t, "/tf", {"transforms": transforms}
        if self._must_draw:
            yield self._drawing(event.t)

    def _decision(self, t: int, pursuer: int, action: int, text: str = "") -> Iterator[Entry]:
        """Yield the log message of a decision if it changes the action."""
        if self._actions[pursuer] != action:
            self._actions[pursuer], self._must_draw = action, True
            yield _log(t, f"pursuer {pursuer}", text or (f"chases evader {action}" if action else "stops"))

    def _drawing(self, t: int) -> Entry:
        """Return the message that draws all players: after a seek, Foxglove reads only the last message of a topic."""
        self._must_draw = False
        chasers = Counter(self._actions)
        players = []
        for name in self._places:
            kind, number = name.split()
            is_evader = kind == "evader"
            evader_colour = _colour(EVADER, 0.4 if is_evader and int(number) in self._captured else 1.0)
            colour = evader_colour if is_evader else self._pursuer_colour(int(number), chasers)
            size = dict.fromkeys("xyz", self._size)
            body = {"pose": _pose(DIAMOND if is_evader else UPRIGHT), "size": size, "color": colour}
            label: Message = {"pose": _pose(), "billboard": True, "font_size": 12.0, "scale_invariant": True}
            label |= {"text": number, "color": _colour("#000000")}
            parts: dict[str, list[Message]] = {"cubes" if is_evader else "spheres": [body], "texts": [label]}
            players.append(_entity(t, name, parts, frame=name))
        return t, "/players", _scene(players)

    def _pursuer_colour(self, pursuer: int, chasers: Mapping[int, int]) -> Message:
        """Return the colour of a pursuer, given the number of pursuers with each action."""
        action = self._actions[pursuer]
        if not action:
            return _colour(INACTIVE, 0.4)
        return _colour(ACTIVE if chasers[action] == 1 else ACTIVE_WITH_OTHERS)

    def _transmission(self, event: Broadcast | Sent) -> Iterator[Entry]:
        """Yield a message for each receiver of a transmission, and the lines to the receivers that it may reach."""
        body, lines = body_json(event.body), []
        for dst, arrival in event.fates():
            content = {"timestamp": _time(event.t), "transmission": event.transmission, "src": event.src, "dst": dst}
            content |= {"size": event.size, "body": body, "waited": seconds(event.t - event.created)}
            if arrival != NO_ARRIVAL:
                lines.append(self._line(event, dst, arrival - event.t, IN_FLIGHT))
                content["latency"] = seconds(arrival - event.t)
            yield event.t, "/messages", content
        if lines:
            yield event.t, "/in_flight", _scene(lines)

    def _line(self, event: Broadcast | Sent | Lost, dst: int, lifetime: int, colour: str) -> Message:
        """Return the line of a message from its sender to its receiver, at their last recorded positions."""
        ends = [_point(self._places[f"pursuer {node}"]) for node in (event.src, dst)]
        line = {"type": 0, "pose": _pose(), "thickness": 2.0, "scale_invariant": True, "points": ends}
        line |= {"color": _colour(colour), "colors": [], "indices": []}
        name = f"{event.transmission} to {dst}"
        return _entity(event.t, name, {"lines": [line]}, lifetime=max(lifetime, 1))  # 0 would mean for ever


def _beliefs(pieces: Pieces | None) -> Iterator[Entry]:
    """Yield the messages about beliefs, in order of time."""
    for piece in [] if pieces is None else pieces[pieces["begin"].argsort(kind="stable")]:
        t = int(piece["begin"])
        content = {"pursuer": int(piece["reader"]), "teammate": int(piece["source"]), "active": int(piece["active"])}
        age = seconds(t - int(piece["created"]))
        yield t, "/beliefs", {"timestamp": _time(t), **content, "age": age}


def _log(t: int, name: str, text: str, level: int = INFO) -> Entry:
    return t, "/log", {"timestamp": _time(t), "level": level, "message": text, "name": name, "file": "", "line": 0}


def _scene(entities: list[Message]) -> Message:
    return {"deletions": [], "entities": entities}


def _entity(
    t: int, name: str, primitives: dict[str, list[Message]], *, frame: str = WORLD, lifetime: int = 0
) -> Message:
    """Return an entity of a scene, with its primitives by kind; with a lifetime of 0 ns it stays until replaced."""
    header = {"timestamp": _time(t), "frame_id": frame, "id": name, "lifetime": _time(lifetime), "frame_locked": True}
    return header | {"cubes": [], "spheres": [], "lines": [], "texts": []} | primitives


def _pose(orientation: Message = UPRIGHT) -> Message:
    return {"position": _point((0.0, 0.0)), "orientation": orientation}


def _rotation(heading: complex) -> Message:
    """Return the rotation about the z axis by the angle of a heading."""
    half = phase(heading) / 2.0
    return {"x": 0.0, "y": 0.0, "z": sin(half), "w": cos(half)}


def _point(place: TracePoint) -> Message:
    return {"x": place[0], "y": place[1], "z": 0.0}


def _time(t: int) -> Message:
    return dict(zip(("sec", "nsec"), divmod(t, SECOND), strict=True))


def _colour(code: str, alpha: float = 1.0) -> Message:
    """Return a colour, given its code #RRGGBB and its opacity in [0, 1]."""
    return {name: int(code[k : k + 2], 16) / 255 for name, k in zip("rgb", (1, 3, 5), strict=True)} | {"a": alpha}
