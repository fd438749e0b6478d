"""The walls of a scenario: `[[wall]]`, what each blocks, and the segments that block radio, sight or motion."""

from collections.abc import Sequence
from functools import cached_property, lru_cache
from math import inf
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from desim.config.model import Coordinate, FirstError, Length, Limit, NotEmpty, Positive, Value
from desim.config.trust import resolve_path
from desim.kernel.walls.crossings import Segments, WallShape, first_contact, segments_of
from desim.kernel.walls.materials import Material, slab_loss
from desim.kernel.walls.outlines import Outline, check_outlines, svg_outlines, without_repeat, wkt_outlines
from desim.kernel.walls.wall_file import wkt_in

Corner = tuple[Coordinate, Coordinate]
"""The position [x, y] of a corner, m."""
What = Literal["radio", "sight", "motion", "start"]
"""What a wall may block."""
Thickness = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False, strict=True)]
"""m: a greater number is one in cm or mm."""
SHAPE_KEYS = ("line", "polygon", "wkt", "svg", "file")
"""The keys of which exactly one describes the shapes of a wall."""


def _each_once(blocks: tuple[What, ...]) -> tuple[What, ...]:
    if len(set(blocks)) < len(blocks):
        raise ValueError("should have each name once")
    return blocks


class Wall(Value):
    """A wall: lines or solid polygons that block radio, sight or motion.

    Exactly one of `line`, `polygon`, `wkt`, `svg` and `file` describes its shapes.
    """

    line: Annotated[tuple[Corner, ...], FirstError()] | None = None
    """Corners [x, y] of a line, m; a line has no thickness, and both of its sides can be reached."""
    polygon: Annotated[tuple[Corner, ...], FirstError()] | None = None
    """Corners [x, y] of a polygon, m; its inside is solid. The last corner is joined to the first, or is the same."""
    wkt: str | None = None
    """Shapes as WKT: LINESTRING, POLYGON, MULTILINESTRING, MULTIPOLYGON or GEOMETRYCOLLECTION. In Python also an object
    that has its WKT as `wkt`, such as a geometry of shapely."""
    svg: str | None = None
    """Shapes as the data of an SVG path, with the commands M, L, H, V and Z; a closed part is a polygon. The y axis of
    SVG points down, so y changes its sign."""
    file: str | None = None
    """Path of a file, relative to the scenario file: WKT, a drawing in SVG, or corners x y in lines, with empty
    lines between shapes. The file is read once, when the wall is created."""
    scale: Length = 1.0
    """Factor by which all coordinates are multiplied, to have them in m."""
    offset: Corner = (0.0, 0.0)
    """Displacement [x, y] that is added after scaling, m."""
    blocks: Annotated[tuple[What, ...], NotEmpty(), AfterValidator(_each_once)] = ("radio", "sight", "motion")
    """What the wall blocks: radio, sight of evaders and of pursuers, motion, start. No random start is on or inside a
    wall that blocks motion or start; one that blocks start alone lets players through."""
    loss: Limit = inf
    """Loss of radio at each crossing of a line or of an edge of a polygon, dB; inf: nothing is received through it. The
    straight line from sender to receiver is counted. A solid polygon is entered and left, so it counts twice."""
    material: Material | None = None
    """Instead of a loss: a material of ITU-R P.2040-3, of which the wall is a slab of some thickness."""
    thickness: Thickness = 0.1
    """Thickness of the slab, m; only with a material. The wall keeps the shape of its lines or polygons."""
    frequency: Positive = 2.4e9
    """Frequency of the radio, Hz; only with a material.

    If in doubt, 2.4e9 for Wi-Fi, 868e6 or 915e6 for LoRa.
    """

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        """Replace a geometry, or a file if nothing else describes the shapes, by WKT."""
        if not isinstance(data, dict):
            return data
        if isinstance(text := getattr(data.get("wkt"), "wkt", None), str):
            data = data | {"wkt": text}
        if [key for key in SHAPE_KEYS if data.get(key) is not None] != ["file"]:
            return data
        wkt = wkt_in(resolve_path(data["file"], info), is_scaled="scale" in data)
        return {name: value for name, value in data.items() if name != "file"} | {"wkt": wkt}

    @model_validator(mode="after")
    def _is_valid(self) -> Self:
        forms = [key for key in SHAPE_KEYS if getattr(self, key) is not None]
        if len(forms) != 1:
            has = f" (has {' and '.join(forms)})" if forms else ""
            raise ValueError(f"should have exactly one of {', '.join(SHAPE_KEYS)}{has}")
        if self.material is not None and self.loss != inf:
            raise ValueError("should have a loss or a material, not both")
        if not self._outlines:
            raise ValueError("SVG path: has no line")
        check_outlines(self._outlines)
        if self.scale != 1.0 or self.offset != (0.0, 0.0):
            for k, shape in enumerate(self.shapes):
                placed = Outline(tuple(map(tuple, shape.corners.tolist())), shape.closed)
                check_outlines([placed], f"shape {k}, scaled and displaced: ")
        self._check_rings()
        if self.material is not None:
            slab_loss(self.material, self.thickness, self.frequency)  # raises ValueError for a wrong frequency
        return self

    @property
    def unused_fields(self) -> dict[str, str]:
        """All fields about radio if the wall does not block radio, or those of a slab if there is no material."""
        if "radio" not in self.blocks:
            return dict.fromkeys(("loss", "material", "thickness", "frequency"), f"blocks {list(self.blocks)}")
        return dict.fromkeys(("thickness", "frequency"), "no material") if self.material is None else {}

    @cached_property
    def _outlines(self) -> list[Outline]:
        """The shapes as they are written."""
        if self.line is not None:
            return [Outline(self.line, closed=False)]
        if self.polygon is not None:
            return [Outline(without_repeat(self.polygon), closed=True)]
        return wkt_outlines(self.wkt) if self.wkt is not None else svg_outlines(self.svg or "")

    @property
    def shapes(self) -> tuple[WallShape, ...]:
        """The shapes, in m; a hole of a polygon is a polygon of its own."""
        return _shapes_of(self)

    @cached_property
    def decibels(self) -> float:
        """The loss of radio at each crossing, dB; 0 if the wall does not block radio."""
        if "radio" not in self.blocks:
            return 0.0
        return self.loss if self.material is None else slab_loss(self.material, self.thickness, self.frequency)

    def _check_rings(self) -> None:
        """Raise ValueError if a polygon touches itself, or another one of this wall."""
        contact = first_contact((k, shape) for k, shape in enumerate(self.shapes) if shape.closed)
        if contact is None:
            return
        a, b, c, d = (f"[{x:g}, {y:g}]" for x, y in contact.ends)
        where = f"the edge from {a} to {b} meets that from {c} to {d}"
        if contact.first != contact.second:
            which = f"polygons {contact.first} and {contact.second} touch each other"
            raise ValueError(f"{which}: {where}; give each a wall of its own, or unite them")
        raise ValueError(f"a polygon should not cross or touch itself: {where}")


@lru_cache(maxsize=256)  # not in the wall itself: arrays cannot be compared as the fields of a value are
def _shapes_of(wall: Wall) -> tuple[WallShape, ...]:
    offset = np.array(wall.offset)
    shapes = tuple(WallShape(np.array(corners) * wall.scale + offset, closed) for corners, closed in wall._outlines)
    for shape in shapes:
        shape.corners.setflags(write=False)
    return shapes


def blocking(walls: Sequence[Wall], use: What) -> Segments:
    """Return the edges of the walls that block something; their owners are the indices of the walls."""
    barriers = ((index, wall) for index, wall in enumerate(walls) if use in wall.blocks)
    return segments_of((index, shape) for index, wall in barriers for shape in wall.shapes)
