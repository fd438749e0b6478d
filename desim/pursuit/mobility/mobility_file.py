"""Mobility files: the recorded motion of nodes, from a file of BonnMotion or ns-2, or from a table.

Motion is in the plane: heights are dropped.
"""

from pathlib import Path

from desim.config.number_files import check_comments, text_of_file
from desim.pursuit.mobility.bonnmotion_file import BonnMotionFile, Dimensions
from desim.pursuit.mobility.mobility import MobilityFile
from desim.pursuit.mobility.mobility_table import MobilityTable, header_in
from desim.pursuit.mobility.ns2_file import Ns2File, is_ns2


def read_mobility(file: Path, dimensions: Dimensions | None = None, *, is_scaled: bool = False) -> MobilityFile:
    """Return the nodes of a mobility file; its content determines the format.

    Args:
        file: the path; the file may be compressed by gzip.
        dimensions: coordinates of each waypoint in a file of BonnMotion; None: as the file says.
        is_scaled: whether the caller scales the places; if not, comments may name no other unit than m.

    Raises:
        ValueError: if the file cannot be read or has another format; the message names the file.
    """
    text = text_of_file(file)
    for unit in "s" if is_scaled else "sm":
        check_comments(text, file, unit)
    lines = text.split("\n")
    first = next((line.strip() for line in lines if line.strip()), "")
    for beginning, advice in UNREAD.items():
        if first.startswith(beginning):
            hint = next((why for tag, why in XML_ADVICE.items() if tag in "\n".join(lines[:50])), advice)
            raise ValueError(f"{file} is not a mobility file of BonnMotion or ns-2, or a table: {hint}")
    if is_ns2(lines):
        made: MobilityFile = Ns2File(file, lines)
    elif (header := header_in(lines)) is not None:
        made = MobilityTable(file, lines, *header)
    else:
        return BonnMotionFile(file, lines, dimensions)
    if dimensions is not None:
        raise ValueError(f"{file}: dimensions are of a file of BonnMotion, which this is not")
    return made


TABLE_ADVICE = "write it as a table with the columns t, node, x, y (s, m)"
UNREAD = {"<": f"XML is not read; {TABLE_ADVICE}", "{": f"JSON is not read; {TABLE_ADVICE}", "[": TABLE_ADVICE}
"""What to do about files that are not read, by their beginning."""
XML_ADVICE = {
    "<fcd-export": "SUMO's traceExporter.py --fcd-input FILE --ns2mobility-output OUT converts its FCD output",
    "<gpx": f"GPX has positions in degrees; project them to m, and {TABLE_ADVICE}",
    "<kml": f"KML has positions in degrees; project them to m, and {TABLE_ADVICE}",
}
