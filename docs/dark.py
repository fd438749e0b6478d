"""The figures of the studies for the dark theme: dark ink becomes light, and white paper becomes nothing.

What lies on a heat map keeps its colours, because the map does.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

from desim.analysis.drawing.palette import ON_DARK

SVG, XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
FOLDER = "_dark"
COLOURS = {colour.lower(): on_dark for colour, on_dark in ON_DARK.items()}
"""The colours of figures, and those of the same meaning that are legible on a dark page."""
INK = COLOURS["#000000"]
COLOUR = re.compile("|".join(COLOURS))


def write(docs: Path, scenarios: Path) -> None:
    """Write the dark variant of each figure of the studies into the folder `_dark`."""
    ET.register_namespace("", SVG)
    ET.register_namespace("xlink", XLINK)
    (docs / FOLDER).mkdir(exist_ok=True)
    for figure in scenarios.glob("*.svg"):
        (docs / FOLDER / figure.name).write_text(dark(figure.read_text(encoding="utf-8")), encoding="utf-8")


def dark(text: str) -> str:
    """Return a figure of matplotlib, whose text is text, in colours for a dark page."""
    root = ET.fromstring(text)
    kept = {part for axes in root.iter(f"{{{SVG}}}g") if _is_map(axes) for part in _on_map(axes)}
    for part in root.iter():
        if part.get("id") == "patch_1":  # the paper of the whole figure
            part[0].set("style", "fill: none")
        style = part.get("style", "")
        if part not in kept:
            style = COLOUR.sub(lambda colour: COLOURS[colour[0]], style)
        if part.tag == f"{{{SVG}}}text" and "fill" not in style and part not in kept:
            style += f"; fill: {INK}"
        if style:
            part.set("style", style)
    return ET.tostring(root, encoding="unicode")


def _is_map(part: ET.Element) -> bool:
    """Return whether an element is a pair of axes with a heat map."""
    return part.get("id", "").startswith("axes_") and any(
        child.tag == f"{{{SVG}}}image" or child.get("id", "").startswith("QuadMesh") for child in part.iter()
    )


def _on_map(axes: ET.Element) -> Iterator[ET.Element]:
    """Yield the elements that are drawn on the heat map of axes: not the axis, the frame, the title and the legend."""
    top = min(float(y) for y in re.findall(r"[ML] \S+ (\S+)", axes[0][0].get("d", "")))
    for part in axes:
        # A text of several lines has its place in a transformation.
        moved = [re.search(r"translate\(\S+ (\S+)\)", inner.get("transform", "")) for inner in part.iter()]
        heights = [float(place[1]) for place in moved if place]
        heights += [float(text.get("y", "inf")) for text in part.iter(f"{{{SVG}}}text")]
        if (
            not part.get("id", "").startswith(("matplotlib.axis", "patch_", "legend"))
            and min(heights, default=top) >= top
        ):
            yield from part.iter()
