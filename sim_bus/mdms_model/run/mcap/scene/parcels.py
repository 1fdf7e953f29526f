"""Parcels in a scene: as bodies where they truly are, and as ghosts where they are believed."""

from collections.abc import Hashable, Iterator
from typing import Any

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.outline import outline_m, own_outline_m
from mdms_model.run.colours import between, colours_of
from mdms_model.run.mcap.scene.primitives import Parts, block, colour, line, pose_at, text
from mdms_model.run.record import Record
from mdms_model.run.shared_belief import shared_belief
from mdms_model.scenario.scenario import Parcel, Scenario

HEIGHT_M = 0.06
BODY_OPACITY, GHOST_OPACITY = 0.5, 0.2
#: A ghost stands out above the body that it is of.
_GHOST_M = HEIGHT_M + 0.004
_LINE_M, _NAME_M = 0.004, 0.035
_INK = "#1c2733"


class Parcels:
    """Bodies with their names, at poses (T, P, 3); none where one is unknown or away."""

    rate_hz = 30.0

    def __init__(self, topic: str, scenario: Scenario, poses: Floats, *, ghosts: bool) -> None:
        self.topic = topic
        self._parcels, self._poses, self._ghosts = scenario.parcel, poses, ghosts
        self._colours = colours_of(scenario)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        poses: Floats = self._poses[instant]
        return poses.round(5).tobytes()

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        parts: Parts = {"cubes": [], "cylinders": [], "triangles": [], "lines": [], "texts": []}
        for number, parcel in enumerate(self._parcels):
            pose = self._poses[instant, number]
            if not np.isfinite(pose).all():
                continue
            kind, body = _body(parcel, pose, self._painted(number))
            parts[kind].append(body)
            if self._ghosts:
                parts["lines"].append(_rim(parcel, pose, between(self._colours[number], _INK, 0.6)))
            else:
                place_m = (*pose[:2].tolist(), HEIGHT_M + 0.02)
                parts["texts"].append(text(parcel.name, place_m, _NAME_M, colour(_INK)))
        return parts

    def _painted(self, number: int) -> dict[str, float]:
        return colour(self._colours[number], GHOST_OPACITY if self._ghosts else BODY_OPACITY)


def parcel_layers(scenario: Scenario, record: Record) -> Iterator[Parcels]:
    """Parcels in a scene: where they are, and where host and cells believe them."""
    if np.isfinite(record.pose).any():
        yield Parcels("/scene/parcels", scenario, record.pose, ghosts=False)
    if record.estimate is not None and np.isfinite(record.estimate).any():
        yield Parcels("/scene/beliefs", scenario, record.estimate, ghosts=True)
    if record.identity is not None:
        believed = [shared_belief(record, number) for number in range(len(scenario.parcel))]
        poses: Floats = np.stack(believed, axis=1)
        yield Parcels("/scene/cell_beliefs", scenario, poses, ghosts=True)


def _body(parcel: Parcel, pose: Floats, painted: dict[str, float]) -> tuple[str, dict[str, Any]]:
    """The kind of primitive, and the primitive."""
    x_m, y_m, yaw_rad = pose.tolist()
    if parcel.shape == "polygon":
        return "triangles", _prism(parcel, pose_at((x_m, y_m, 0.0), yaw_rad), painted)
    size_m = (parcel.length_m, parcel.width_m, HEIGHT_M)
    shape = block((x_m, y_m, HEIGHT_M / 2), yaw_rad, size_m, painted)
    if parcel.shape == "disc":
        return "cylinders", shape | {"bottom_scale": 1.0, "top_scale": 1.0}
    return "cubes", shape


def _rim(parcel: Parcel, pose: Floats, paint: str) -> dict[str, Any]:
    return line(outline_m(pose, parcel), _GHOST_M, _LINE_M, colour(paint), closed=True)


def _prism(parcel: Parcel, pose: dict[str, Any], painted: dict[str, float]) -> dict[str, Any]:
    """A polygon's upright body: a fan of triangles for its top, two for each of its sides."""
    corners = own_outline_m(parcel).tolist()
    count = len(corners)
    points = [(x_m, y_m, z_m) for z_m in (0.0, HEIGHT_M) for x_m, y_m in corners]
    indices = [
        index for one in range(1, count - 1) for index in (count, count + one, count + one + 1)
    ]
    for one in range(count):
        two = (one + 1) % count
        indices += [one, two, count + two, one, count + two, count + one]
    return {
        "pose": pose,
        "points": [dict(zip("xyz", point, strict=True)) for point in points],
        "color": painted,
        "colors": [],
        "indices": indices,
    }
