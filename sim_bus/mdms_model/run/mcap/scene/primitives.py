"""The primitives of a scene, in the well-known schemas of Foxglove (docs.foxglove.dev)."""

from math import cos, sin
from typing import Any, TypeAlias

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.run.colours import unit_rgb

FRAME = "table"
#: Lists of primitives by kind; those left out are empty.
Parts: TypeAlias = dict[str, list[Any]]
KINDS = (
    *("metadata", "arrows", "cubes", "spheres", "cylinders"),
    *("lines", "triangles", "texts", "models"),
)
_OBJECTS = {"type": "array", "items": {"type": "object"}}
SCENE_SCHEMA = {"deletions": _OBJECTS, "entities": _OBJECTS}
_LINE_STRIP, _LINE_LOOP = 0, 1


def scene_update(time_s: float, name: str, parts: Parts) -> dict[str, Any]:
    """One entity in place of its last version; it stays until the next."""
    entity = {
        "timestamp": stamp(time_s),
        "frame_id": FRAME,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        **{kind: parts.get(kind, []) for kind in KINDS},
    }
    return {"deletions": [], "entities": [entity]}


def stamp(time_s: float) -> dict[str, int]:
    """A time as Foxglove has it."""
    time_ns = round(time_s * 1e9)
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def colour(name: str, opacity: float = 1.0) -> dict[str, float]:
    """A colour as Foxglove has it."""
    return dict(zip("rgba", (*unit_rgb(name), opacity), strict=True))


def pose_at(
    place_m: tuple[float, float, float], turn_rad: float = 0.0
) -> dict[str, dict[str, float]]:
    """A place, turned about the vertical."""
    return {
        "position": dict(zip("xyz", place_m, strict=True)),
        "orientation": {"x": 0.0, "y": 0.0, "z": sin(turn_rad / 2), "w": cos(turn_rad / 2)},
    }


def block(
    place_m: tuple[float, float, float],
    turn_rad: float,
    size_m: tuple[float, float, float],
    painted: dict[str, float],
) -> dict[str, Any]:
    """A cube or, with its scales, a cylinder."""
    size = dict(zip("xyz", size_m, strict=True))
    return {"pose": pose_at(place_m, turn_rad), "size": size, "color": painted}


def line(
    points_m: Floats, height_m: float, width_m: float, painted: dict[str, float], *, closed: bool
) -> dict[str, Any]:
    """A line through points (K, 2) at a height, back to the first if it is closed."""
    return {
        "type": _LINE_LOOP if closed else _LINE_STRIP,
        "pose": pose_at((0.0, 0.0, height_m)),
        "thickness": width_m,
        "scale_invariant": False,
        "points": [{"x": x_m, "y": y_m, "z": 0.0} for x_m, y_m in np.round(points_m, 4).tolist()],
        "color": painted,
        "colors": [],
        "indices": [],
    }


def text(
    words: str, place_m: tuple[float, float, float], size_m: float, painted: dict[str, float]
) -> dict[str, Any]:
    """Words that face whoever looks."""
    return {
        "pose": pose_at(place_m),
        "billboard": True,
        "font_size": size_m,
        "scale_invariant": False,
        "color": painted,
        "text": words,
    }
