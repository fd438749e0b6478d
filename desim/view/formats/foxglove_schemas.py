"""JSON schemas of the messages in an MCAP file: those of Foxglove that `foxglove` writes, and two of desim.

Foxglove recognises a schema by its name (https://docs.foxglove.dev/docs/visualization/message-schemas/introduction).
Of the primitives of a scene, the schema lists only those that `foxglove` draws.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

Schema = dict[str, Any]


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "properties": properties}


def _list_of(items: Schema) -> Schema:
    return {"type": "array", "items": items}


NUMBER: Schema = {"type": "number"}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
FLAG: Schema = {"type": "boolean"}
TIME = _object(sec=INTEGER, nsec=INTEGER) | {"title": "time"}
DURATION = _object(sec=INTEGER, nsec=INTEGER) | {"title": "duration"}
VECTOR = _object(x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = _object(position=VECTOR, orientation=QUATERNION)
COLOR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
BODY = _object(pose=POSE, size=VECTOR, color=COLOR)
LINE = _object(
    type=INTEGER,
    pose=POSE,
    thickness=NUMBER,
    scale_invariant=FLAG,
    points=_list_of(VECTOR),
    color=COLOR,
    colors=_list_of(COLOR),
    indices=_list_of(INTEGER),
)
LABEL = _object(pose=POSE, billboard=FLAG, font_size=NUMBER, scale_invariant=FLAG, color=COLOR, text=TEXT)
ENTITY = _object(
    timestamp=TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime=DURATION,
    frame_locked=FLAG,
    cubes=_list_of(BODY),
    spheres=_list_of(BODY),
    lines=_list_of(LINE),
    texts=_list_of(LABEL),
)
DELETION = _object(timestamp=TIME, type=INTEGER, id=TEXT)
TRANSFORM = _object(timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR, rotation=QUATERNION)
SCHEMAS: Mapping[str, Schema] = MappingProxyType(
    {
        "foxglove.FrameTransforms": _object(transforms=_list_of(TRANSFORM)),
        "foxglove.SceneUpdate": _object(deletions=_list_of(DELETION), entities=_list_of(ENTITY)),
        "foxglove.Log": _object(timestamp=TIME, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=INTEGER),
        "Message": _object(
            timestamp=TIME,
            transmission=INTEGER,
            src=INTEGER,
            dst=INTEGER,
            size=INTEGER,
            waited=NUMBER,
            latency=NUMBER,
            body=TEXT,
        ),
        "Belief": _object(timestamp=TIME, pursuer=INTEGER, teammate=INTEGER, active=INTEGER, age=NUMBER),
    }
)
"""The schemas by name."""
