"""A run as a scene that Foxglove's 3D panel shows: the table, its wheels and the moving parcels.

Messages follow the well-known schema `foxglove.SceneUpdate` (docs.foxglove.dev).
"""

from collections.abc import Iterator
from math import cos, sin
from typing import Any

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.outline import own_outline_m
from mdms_model.run.record import Record
from mdms_model.run.scene_cells import SceneCells
from mdms_model.scenario.scenario import Parcel, Scenario

FRAME = "table"
#: Eyes need no more pictures than this.
FRAMES_PER_S = 30.0
TABLE_DEPTH_M, WHEEL_WIDTH_M, PARCEL_HEIGHT_M = 0.02, 0.012, 0.06
Colour = tuple[float, float, float, float]
TABLE_COLOUR: Colour = (0.90, 0.92, 0.94, 1.0)
WHEEL_COLOUR: Colour = (0.18, 0.43, 0.71, 1.0)
PARCEL_COLOUR: Colour = (0.84, 0.37, 0.0, 0.85)
#: What an entity may be made of.
PRIMITIVES = (
    "metadata",
    "arrows",
    "cubes",
    "spheres",
    "cylinders",
    "lines",
    "triangles",
    "texts",
    "models",
)
_OBJECTS = {"type": "array", "items": {"type": "object"}}
SCENE_SCHEMA = {"deletions": _OBJECTS, "entities": _OBJECTS}


def scene_messages(scenario: Scenario, record: Record) -> Iterator[tuple[float, dict[str, Any]]]:
    """Times [s] and messages: the table with the first, the parcels with all.

    Cells that steer are shown by whom they have, when that has changed.
    """
    due_s = -np.inf
    cells = SceneCells(scenario, record)
    shown: set[str] = set()
    for instant, time_s in enumerate(record.time_s.tolist()):
        if time_s < due_s:
            continue
        poses = zip(scenario.parcel, record.pose[instant], strict=True)
        there = [(parcel, pose) for parcel, pose in poses if np.isfinite(pose).all()]
        entities = [_entity(time_s, each.name, _parcel_body(each, pose)) for each, pose in there]
        gone, shown = shown - {each.name for each, _ in there}, {each.name for each, _ in there}
        if not instant:
            cubes = [_table_cube(scenario), *_wheel_cubes(scenario)]
            entities.append(_entity(time_s, "the table", {"cubes": cubes}))
        entities += [_entity(time_s, name, parts) for name, parts in cells.changed(instant)]
        due_s = time_s + 1 / FRAMES_PER_S - 1e-9
        yield time_s, {"deletions": _deletions(time_s, gone), "entities": entities}


def _deletions(time_s: float, names: set[str]) -> list[dict[str, Any]]:
    """What is to be seen no more: parcels that have left."""
    return [{"timestamp": _stamp(time_s), "type": 0, "id": name} for name in sorted(names)]


def _stamp(time_s: float) -> dict[str, int]:
    time_ns = round(time_s * 1e9)
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def _entity(time_s: float, name: str, parts: dict[str, list[Any]]) -> dict[str, Any]:
    """A named thing; `parts` are lists of primitives by kind, those left out are empty."""
    return {
        "timestamp": _stamp(time_s),
        "frame_id": FRAME,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        **{kind: parts.get(kind, []) for kind in PRIMITIVES},
    }


def _parcel_body(parcel: Parcel, pose: Floats) -> dict[str, list[Any]]:
    x_m, y_m, yaw_rad = pose.tolist()
    if parcel.shape == "polygon":
        return {"triangles": [_prism(parcel, _pose((x_m, y_m, 0.0), yaw_rad))]}
    size_m = (parcel.length_m, parcel.width_m, PARCEL_HEIGHT_M)
    block = _block((x_m, y_m, PARCEL_HEIGHT_M / 2), yaw_rad, size_m, PARCEL_COLOUR)
    if parcel.shape == "disc":
        return {"cylinders": [block | {"bottom_scale": 1.0, "top_scale": 1.0}]}
    return {"cubes": [block]}


def _prism(parcel: Parcel, pose: dict[str, Any]) -> dict[str, Any]:
    """A polygon's upright body: a fan of triangles for its top, two for each of its sides."""
    corners = own_outline_m(parcel).tolist()
    count = len(corners)
    points = [(x_m, y_m, z_m) for z_m in (0.0, PARCEL_HEIGHT_M) for x_m, y_m in corners]
    indices = [
        index for one in range(1, count - 1) for index in (count, count + one, count + one + 1)
    ]
    for one in range(count):
        two = (one + 1) % count
        indices += [one, two, count + two, one, count + two, count + one]
    return {
        "pose": pose,
        "points": [dict(zip("xyz", point, strict=True)) for point in points],
        "color": dict(zip("rgba", PARCEL_COLOUR, strict=True)),
        "colors": [],
        "indices": indices,
    }


def _table_cube(scenario: Scenario) -> dict[str, Any]:
    array = scenario.array
    size_m = (array.columns * array.pitch_m, array.rows * array.pitch_m, TABLE_DEPTH_M)
    below_m = -scenario.cell.wheel_radius_m - TABLE_DEPTH_M / 2
    return _block((0.0, 0.0, below_m), 0.0, size_m, TABLE_COLOUR)


def _wheel_cubes(scenario: Scenario) -> list[dict[str, Any]]:
    """Each wheel as a block along its direction, its top at the height of the parcels' bottoms."""
    wheels, radius_m = build_wheels(scenario), scenario.cell.wheel_radius_m
    size_m = (2 * radius_m, WHEEL_WIDTH_M, radius_m)
    turns = np.arctan2(wheels.direction[:, 1], wheels.direction[:, 0]).tolist()
    return [
        _block((x_m, y_m, -radius_m / 2), turn, size_m, WHEEL_COLOUR)
        for (x_m, y_m), turn in zip(wheels.position_m.tolist(), turns, strict=True)
    ]


def _block(
    place_m: tuple[float, float, float],
    turn_rad: float,
    size_m: tuple[float, float, float],
    colour: Colour,
) -> dict[str, Any]:
    """A cube or, with its scales, a cylinder, turned about the vertical."""
    return {
        "pose": _pose(place_m, turn_rad),
        "size": dict(zip("xyz", size_m, strict=True)),
        "color": dict(zip("rgba", colour, strict=True)),
    }


def _pose(place_m: tuple[float, float, float], turn_rad: float) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", place_m, strict=True)),
        "orientation": {"x": 0.0, "y": 0.0, "z": sin(turn_rad / 2), "w": cos(turn_rad / 2)},
    }
