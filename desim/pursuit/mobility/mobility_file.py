"""Mobility files: the recorded motion of nodes, from a file of BonnMotion, ns-2 or SUMO, or from a table.

Motion is in the plane: heights are dropped.
"""

from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from math import hypot
from pathlib import Path

from desim.config.column_names import header_of
from desim.config.number_files import check_comments, number_of, text_of_file
from desim.kernel.measured.csv_tables import csv_text
from desim.pursuit.mobility.bonnmotion_file import BonnMotionFile, Dimensions
from desim.pursuit.mobility.fcd_file import FcdFile
from desim.pursuit.mobility.mobility import MobilityFile
from desim.pursuit.mobility.mobility_table import MobilityTable, header_in
from desim.pursuit.mobility.ns2_file import Ns2File, is_ns2


def read_mobility(
    file: Path, dimensions: Dimensions | None = None, *, is_scaled: bool = False, needs_times: bool = True
) -> MobilityFile:
    """Return the nodes of a mobility file; its content determines the format.

    Args:
        file: the path; the file may be compressed by gzip, and a table may be in Parquet.
        dimensions: number of coordinates of each waypoint in a file of BonnMotion; None: as the file says.
        is_scaled: whether the caller scales the places; if not, comments may name no other unit than m.
        needs_times: whether a table should have times; see `MobilityTable`.

    Raises:
        ValueError: if the file cannot be read or has another format; the message names the file.
    """
    text = csv_text(file, None, units="") if file.suffix.lower() == ".parquet" else text_of_file(file)
    for unit in "s" if is_scaled else "sm":
        check_comments(text, file, unit)
    mobility = _nodes_of(file, text, dimensions, needs_times=needs_times)
    if dimensions is not None and not isinstance(mobility, BonnMotionFile):
        raise ValueError(f"{file}: dimensions are of a file of BonnMotion, which this is not")
    return mobility


def _nodes_of(file: Path, text: str, dimensions: Dimensions | None, *, needs_times: bool) -> MobilityFile:
    """Return the nodes of a mobility file, whose content is `text`; see `read_mobility`."""
    lines = text.split("\n")
    first_line = next((line.strip() for line in lines if line.strip()), "")
    if first_line.startswith("<") and "<fcd-export" in text:
        return FcdFile(file, text)
    for beginning, advice in UNREAD.items():
        if first_line.startswith(beginning):
            hint = next((why for tag, why in XML_ADVICE.items() if tag in "\n".join(lines[:50])), advice)
            raise ValueError(f"{file} is not a mobility file of BonnMotion, ns-2 or SUMO, or a table: {hint}")
    if is_ns2(lines):
        return Ns2File(file, lines)
    if (header := header_in(lines)) is not None:
        return MobilityTable(file, lines, *header, needs_times=needs_times)
    if has_poses(lines):
        return MobilityTable(file, lines, -1, "", header_of(POSE))
    return BonnMotionFile(file, lines, dimensions)


POSE = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
"""The columns of a trajectory of the TUM RGB-D benchmark (Sturm et al. 2012), which has no header."""


def has_poses(lines: Sequence[str]) -> bool:
    """Return whether each line has a later time than the line before, a position and a quaternion of length 1."""
    rows = [row for line in lines if (row := line.split()) and not row[0].startswith("#")]
    if len(rows) < 2 or any(len(row) != len(POSE) for row in rows):
        return False
    with suppress(ValueError):
        poses = [[number_of(cell) for cell in row] for row in rows]
        has_length_1 = all(abs(hypot(*pose[4:]) - 1.0) < 0.01 for pose in poses)
        return has_length_1 and all(before[0] < after[0] for before, after in pairwise(poses))
    return False


TABLE_ADVICE = "write it as a table with the columns t, node, x, y (s, m)"
UNREAD = {
    "<": f"XML is not read; {TABLE_ADVICE}",
    "{": f"JSON is not read; {TABLE_ADVICE}",
    "[": TABLE_ADVICE,
    "$GP": f"NMEA has positions in degrees; project them to m, and {TABLE_ADVICE}",
    "$GN": f"NMEA has positions in degrees; project them to m, and {TABLE_ADVICE}",
}
"""What to do about files that are not read, by their beginning."""
XML_ADVICE = {
    "<gpx": f"GPX has positions in degrees; project them to m, and {TABLE_ADVICE}",
    "<tripinfo": "the trips of SUMO have no positions; its option --fcd-output writes them",
    "<routes": "the routes of SUMO have no positions; its option --fcd-output writes them",
    "<kml": f"KML has positions in degrees; project them to m, and {TABLE_ADVICE}",
}
