"""Floating car data (FCD) of SUMO: where each vehicle and each person is at each time step.

<fcd-export>
    <timestep time="1.00">
        <vehicle id="car.0" x="6.54" y="-1.65" angle="90.00" speed="1.44" .../>
    </timestep>
</fcd-export>
"""

import re
from collections import defaultdict
from decimal import Decimal
from itertools import pairwise
from math import hypot
from pathlib import Path
from typing import NamedTuple
from xml.parsers.expat import ExpatError, ParserCreate

from desim.config.number_files import converted, number_of
from desim.kernel.measured.measurements import start_of, time_of
from desim.pursuit.mobility.mobility import MobilityFile, NodeName, NodeTrack, Waypoint, append, coordinate, time

TRAVELLERS = frozenset({"vehicle", "person", "container"})
"""The elements of a time step that have a position."""
LEAST_SHARE = 0.01
"""Least share of their speeds at which vehicles move. Positions in degrees give a share of 1e-5."""

GEO = re.compile(r'<fcd-output\.geo value="(?:true|yes|on|1|x|t)"', re.IGNORECASE)
"""The option in the comment at the head of the file, which shows degrees also if nothing moves."""


class _Place(NamedTuple):
    """The place of a traveller in a time step: the time as it is written, the attributes, and the line."""

    t: str
    attributes: dict[str, str]
    line: int


class FcdFile(MobilityFile):
    """A file of FCD; its nodes are named by the ids of vehicles and persons."""

    def __init__(self, file: Path, text: str):
        self._places = defaultdict[str, list[_Place]](list)
        step_time = ""
        parser = ParserCreate("utf-8")  # not in the declared encoding: the text has been decoded

        def start(name: str, attributes: dict[str, str]) -> None:
            nonlocal step_time
            line = parser.CurrentLineNumber
            needed = ["time"] if name == "timestep" else ["id", "x", "y"] if name in TRAVELLERS else []
            if missing := [key for key in needed if key not in attributes]:
                raise ValueError(f"{file}, line {line}: <{name}> has no {missing[0]}")
            if name == "timestep":
                step_time = attributes["time"]
            elif name in TRAVELLERS:
                self._places[attributes["id"]].append(_Place(step_time, attributes, line))

        def refuse(*_: object) -> None:
            raise ValueError(f"{file}: it should declare no document type (<!DOCTYPE ...>)")

        parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, refuse
        try:
            parser.Parse(text.encode(), True)
        except ExpatError as error:
            raise ValueError(f"{file} is not valid XML: {error}") from error
        super().__init__(file, self._places)
        steps = {place.t: place.line for places in self._places.values() for place in places}
        self._start = start_of((self._time(t, line) for t, line in steps.items()), file)
        if GEO.search(text):
            raise ValueError(f"{file} has positions in degrees: SUMO wrote it with fcd-output.geo, as its comment says")
        self._check_is_in_metres()

    def _time(self, text: str, line: int) -> Decimal:
        return converted(time_of, text, f"{self.file}, line {line}")

    def _check_is_in_metres(self) -> None:
        """Raise ValueError if vehicles move at a tiny share of their speeds: `--fcd-output.geo` writes degrees."""
        moved = expected = 0.0
        for places in self._places.values():
            for before, after in pairwise(places):
                place = f"{self.file}, line {after.line}"
                speed = converted(number_of, after.attributes.get("speed", "0"), place)
                expected += speed * float(self._time(after.t, after.line) - self._time(before.t, before.line))
                x, y = (
                    coordinate(after.attributes[axis], place) - coordinate(before.attributes[axis], place)
                    for axis in "xy"
                )
                moved += hypot(x, y)
        if moved < LEAST_SHARE * expected:
            raise ValueError(
                f"{self.file} has positions in degrees (fcd-output.geo): vehicles move by {moved:.2g} in all, and their"
                f" speeds say {expected:.2g} m"
            )

    def _track(self, node: NodeName) -> NodeTrack:
        waypoints, has_heights = list[Waypoint](), False
        for t, attributes, line in self._places[str(node)]:
            place = f"{self.file}, line {line}"
            x, y = coordinate(attributes["x"], place), coordinate(attributes["y"], place)
            append(waypoints, Waypoint(time(t, place, self._start), x, y, line), place)
            has_heights |= coordinate(attributes.get("z", "0"), place) != 0.0
        return NodeTrack(waypoints, has_heights)
