"""JSON schemas of the messages that a log of `play` has as MCAP.

Source: the schemas that Foxglove documents for a pose and for a scene; `touchfield.Tick` is our own.
"""

from __future__ import annotations

from typing import Any, Final

POSE_TOPIC: Final = "/hand/pose"
TICK_TOPIC: Final = "/hand/tick"
ARROW_TOPIC: Final = "/hand/arrow"
PRIMITIVES: Final = ("cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
"""Kinds of shapes, besides arrows, that an entity of a scene lists."""


def _object(title: str, **properties: Any) -> dict[str, Any]:
    """Return a schema in which every property is required."""
    named = {"title": title} if title else {}
    return {**named, "type": "object", "properties": properties, "required": [*properties]}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
_NSEC: Final = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIME: Final = {
    "type": "object", "title": "time", "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": _NSEC}
}  # fmt: skip
_DURATION: Final = {
    "type": "object", "title": "duration", "properties": {"sec": {"type": "integer"}, "nsec": _NSEC}
}  # fmt: skip
_VECTOR_SCHEMA: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION_SCHEMA: Final = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE_SCHEMA: Final = _object("foxglove.Pose", position=_VECTOR_SCHEMA, orientation=_QUATERNION_SCHEMA)
_WRENCH_SCHEMA: Final = _object("", force=_VECTOR_SCHEMA, torque=_VECTOR_SCHEMA)
_COLOR_SCHEMA: Final = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_ARROW_SCHEMA: Final = _object(
    "foxglove.ArrowPrimitive",
    pose=_POSE_SCHEMA,
    shaft_length=_NUMBER,
    shaft_diameter=_NUMBER,
    head_length=_NUMBER,
    head_diameter=_NUMBER,
    color=_COLOR_SCHEMA,
)
_ENTITY_SCHEMA: Final = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked={"type": "boolean"},
    metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
    arrows=_list(_ARROW_SCHEMA),
    **{name: _list({"type": "object"}) for name in PRIMITIVES},  # always empty
)

SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    POSE_TOPIC: _object("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE_SCHEMA),
    TICK_TOPIC: _object(
        "touchfield.Tick",
        timestamp=_TIME,
        frame_id=_TEXT,
        field=_WRENCH_SCHEMA,
        friction=_VECTOR_SCHEMA,
        device=_WRENCH_SCHEMA,
        velocity=_VECTOR_SCHEMA,
        gripper_m=_NUMBER,
        media_s=_NUMBER,
        buttons={"type": "integer"},
        state=_TEXT,
    ),
    ARROW_TOPIC: _object(
        "foxglove.SceneUpdate",
        deletions=_list({"type": "object"}),  # always empty
        entities=_list(_ENTITY_SCHEMA),
    ),
}
"""The schema of each topic."""
