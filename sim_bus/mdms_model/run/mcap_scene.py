"""The scene of a run, in the well-known schemas of Foxglove (docs.foxglove.dev).

It has a topic for each layer: the table, wheels, reports of cells, parcels, goals and plans. Each
message of a topic stands for itself. A viewer that seeks shows the last message of each topic
before that time. So a layer that stays as it is comes again after a while.
"""

from collections.abc import Hashable, Iterator, Mapping
from math import cos, sin
from typing import Any, Protocol, TypeAlias

import numpy as np

from mdms_model.array import build_wheels, cell_centres, edge_m, sensor_places_m
from mdms_model.arrays import Floats
from mdms_model.outline import outline_m, own_outline_m
from mdms_model.run.colours import (
    AHEAD,
    BACK,
    COVERED,
    SLIPS,
    between,
    colours_of,
    parcel_colour,
    unit_rgb,
)
from mdms_model.run.derived import goals_at, plan_at, shared_belief
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Parcel, Scenario, goal_of
from mdms_protocol.neighbours import frames as wire

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


#: The tops of cells lie so far below those of their wheels, on which parcels lie [m].
DECK_M = -0.006
#: Of the pitch.
CELL_SHARE = 0.94
_PLATE_M, _BASE_M, _WHEEL_WIDTH_M, _DOT_M, _NUMBER_M = 0.012, 0.01, 0.012, 0.006, 0.016
#: An exit's line, and how much farther out than that its name is.
_EXIT_M, _BEYOND = 0.008, 1.08
_BASE, _PLATE, _DOT, _NUMBER_INK = "#aab4bd", "#e6ebef", "#9aa5ae", "#5b6670"
_STILL = "#b4bdc5"
#: Colours from slow to fast.
_STEPS = 6
#: What is faster than nearly all that was seen has the colour of that; none is less [m/s].
_FAST_SHARE, _LEAST_FAST_M_S = 99.0, 0.05
#: A wheel under a parcel slips from this speed of its surface over it on [m/s].
SLIPS_M_S = 5e-3


class TableSurface:
    """Cells with their numbers and sensors, and the exits; they do not change."""

    topic, rate_hz = "/scene/table", 1.0

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return 0

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        array, cell = self._scenario.array, self._scenario.cell
        side_m = CELL_SHARE * array.pitch_m
        size_m = (array.columns * array.pitch_m, array.rows * array.pitch_m, _BASE_M)
        under_m = DECK_M - _PLATE_M
        cubes = [block((0.0, 0.0, under_m - _BASE_M / 2), 0.0, size_m, colour(_BASE))]
        plate, ink = colour(_PLATE), colour(_NUMBER_INK)
        centres_m = cell_centres(array).round(5).tolist()
        cubes += [
            block((x_m, y_m, DECK_M - _PLATE_M / 2), 0.0, (side_m, side_m, _PLATE_M), plate)
            for x_m, y_m in centres_m
        ]
        dot = colour(_DOT)
        cubes += [
            block((x_m, y_m, DECK_M), 0.0, (_DOT_M, _DOT_M, 0.002), dot)
            for x_m, y_m in sensor_places_m(array, cell).reshape(-1, 2).round(5).tolist()
        ]
        corner_m = 0.36 * array.pitch_m
        texts = [
            text(str(number), (x_m - corner_m, y_m - corner_m, DECK_M + 0.002), _NUMBER_M, ink)
            for number, (x_m, y_m) in enumerate(centres_m, 1)
        ]
        lines = []
        for each in self._scenario.exit:
            ends_m = edge_m(array, each.side, each.from_m, each.to_m)
            lines.append(line(ends_m, DECK_M, _EXIT_M, ink, closed=False))
            x_m, y_m = (ends_m.mean(axis=0) * _BEYOND).tolist()
            texts.append(text(each.name, (x_m, y_m, 0.0), 2 * _NUMBER_M, ink))
        return {"cubes": cubes, "lines": lines, "texts": texts}


class WheelBlocks:
    """Wheels as blocks: grey at rest, blue ahead, violet back, stronger if faster; red slips."""

    topic, rate_hz = "/scene/wheels", 10.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        speed_m_s = np.nan_to_num(record.speed_m_s)
        seen = abs(speed_m_s[abs(speed_m_s) > _LEAST_FAST_M_S / _STEPS])
        fast_m_s = np.percentile(seen, _FAST_SHARE) if len(seen) else 0.0
        share = speed_m_s / max(fast_m_s, _LEAST_FAST_M_S)
        self._codes = np.round(share * _STEPS).clip(-_STEPS, _STEPS).astype(np.int8)
        if record.slip_m_s is not None:
            self._codes[abs(record.slip_m_s) > SLIPS_M_S] = _STEPS + 1
        wheels, radius_m = build_wheels(scenario), scenario.cell.wheel_radius_m
        size_m = (1.5 * radius_m, _WHEEL_WIDTH_M, radius_m)
        turns = np.arctan2(wheels.direction[:, 1], wheels.direction[:, 0]).round(5).tolist()
        places_m = wheels.position_m.round(5).tolist()
        self._blocks = [
            block((x_m, y_m, -radius_m / 2), turn, size_m, {})
            for (x_m, y_m), turn in zip(places_m, turns, strict=True)
        ]
        self._colours = {code: _paint(code) for code in range(-_STEPS, _STEPS + 2)}

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return bytes(self._codes[instant])

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        codes: list[int] = self._codes[instant].tolist()
        cubes: list[dict[str, Any]] = [
            each | {"color": self._colours[code]}
            for each, code in zip(self._blocks, codes, strict=True)
        ]
        return {"cubes": cubes}


def _paint(code: int) -> dict[str, float]:
    if code > _STEPS:
        return colour(SLIPS)
    return colour(between(_STILL, AHEAD if code > 0 else BACK, abs(code) / _STEPS))


_HELD_PLATE_M, _FRAME_M, _COVERED_DOT_M = 0.002, 0.006, 0.010


class CoveredSensors:
    """A dot on each presence sensor that is covered."""

    topic, rate_hz = "/scene/presence", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        if record.presence is None:
            raise ValueError("no cell reported what its sensors show")
        places_m = sensor_places_m(scenario.array, scenario.cell)
        bits = np.arange(places_m.shape[1])
        self._covered = (record.presence[:, :, None] >> bits & 1).astype(bool)
        self._places_m = places_m.round(5)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return bytes(self._covered[instant])

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        places_m = self._places_m[self._covered[instant]].tolist()
        size_m, painted = (_COVERED_DOT_M, _COVERED_DOT_M, 0.004), colour(COVERED)
        cubes = [block((x_m, y_m, DECK_M), 0.0, size_m, painted) for x_m, y_m in places_m]
        return {"cubes": cubes}


class HeldCellsLayer:
    """A cell under a parcel is a plate in its colour, and a promised cell is a frame."""

    topic, rate_hz = "/scene/cells", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        if record.identity is None or record.state is None:
            raise ValueError("no cell reported a parcel")
        # A cell that is merely near a parcel has nothing to do with it.
        self._held = np.where(record.state >= wire.PROMISED, record.identity, 0)
        self._under = record.state == wire.UNDER
        self._side_m = CELL_SHARE * scenario.array.pitch_m
        self._centres_m = cell_centres(scenario.array)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        return bytes(self._held[instant]), bytes(self._under[instant])

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        parts: Parts = {"cubes": [], "lines": []}
        half_m = self._side_m / 2
        corners_m = half_m * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        for cell in np.flatnonzero(self._held[instant]).tolist():
            painted = colour(parcel_colour(int(self._held[instant, cell]) - 1))
            centre_m = self._centres_m[cell]
            if self._under[instant, cell]:
                place_m = (*centre_m.round(5).tolist(), DECK_M)
                size_m = (self._side_m, self._side_m, _HELD_PLATE_M)
                parts["cubes"].append(block(place_m, 0.0, size_m, painted))
            else:
                frame = line(
                    centre_m + corners_m, DECK_M + _HELD_PLATE_M, _FRAME_M, painted, closed=True
                )
                parts["lines"].append(frame)
        return parts


HEIGHT_M = 0.06
BODY_OPACITY, GHOST_OPACITY = 0.5, 0.2
#: A ghost stands out above the body that it is of.
_GHOST_M = HEIGHT_M + 0.004
_LINE_M, _NAME_M = 0.004, 0.035
_INK = "#1c2733"


class ParcelsLayer:
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


def parcel_layers(scenario: Scenario, record: Record) -> Iterator[ParcelsLayer]:
    """Parcels in a scene: where they are, and where host and cells believe them."""
    if np.isfinite(record.pose).any():
        yield ParcelsLayer("/scene/parcels", scenario, record.pose, ghosts=False)
    if record.estimate is not None and np.isfinite(record.estimate).any():
        yield ParcelsLayer("/scene/beliefs", scenario, record.estimate, ghosts=True)
    if record.identity is not None:
        believed = [shared_belief(record, number) for number in range(len(scenario.parcel))]
        poses: Floats = np.stack(believed, axis=1)
        yield ParcelsLayer("/scene/cell_beliefs", scenario, poses, ghosts=True)


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


_GOAL_M, _WAY_M, _TILE_M = 0.004, 0.003, -0.003
_WIDTH_M, _CROSS_M = 0.005, 0.03
_TILE_OPACITY = 0.3


class Goals:
    """The outline of each parcel at its goal, with a cross in its middle."""

    topic, rate_hz = "/scene/goals", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        self._scenario, self._record = scenario, record
        self._numbers = _numbers(scenario)
        self._colours = colours_of(scenario)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        goals = goals_at(self._scenario, self._record, self._record.time_s[instant])
        return tuple((name, pose.tobytes()) for name, pose in goals.items())

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        goals = goals_at(self._scenario, self._record, self._record.time_s[instant])
        # A thing that somebody has named on the way is not known by its shape.
        known = (
            (self._numbers[name], goal) for name, goal in goals.items() if name in self._numbers
        )
        return {"lines": [each for goal in known for each in self._marks(*goal)]}

    def _marks(self, number: int, goal: Floats) -> list[dict[str, object]]:
        painted = colour(between(self._colours[number], _INK, 0.3))
        arms_m = _CROSS_M * np.array([[(-1, 0), (1, 0)], [(0, -1), (0, 1)]])
        marks = [
            line(goal[:2] + arm_m, _GOAL_M, _WIDTH_M, painted, closed=False) for arm_m in arms_m
        ]
        outline = outline_m(np.nan_to_num(goal), self._scenario.parcel[number])
        return [*marks, line(outline, _GOAL_M, _WIDTH_M, painted, closed=True)]


class Plans:
    """The ways of the plan in effect, and its tiles in the colour of the next parcel on each."""

    topic, rate_hz = "/scene/plans", 30.0

    def __init__(self, scenario: Scenario, record: Record) -> None:
        self._record = record
        self._numbers = _numbers(scenario)
        self._colours = colours_of(scenario)

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        plan = plan_at(self._record, self._record.time_s[instant])
        return None if plan is None else plan.time_s

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        plan = plan_at(self._record, self._record.time_s[instant])
        if plan is None:
            return {}
        lines = [
            line(poses[:, :2], _WAY_M, _WIDTH_M, self._paint(name), closed=False)
            for name, poses in plan.ways.items()
        ]
        tiles = [
            block(
                (round(tile.x_m, 5), round(tile.y_m, 5), _TILE_M),
                0.0,
                (tile.side_m, tile.side_m, 0.001),
                self._paint(tile.parcels[0], _TILE_OPACITY),
            )
            for tile in plan.tiles
            if tile.parcels
        ]
        return {"lines": lines, "cubes": tiles}

    def _paint(self, name: str, opacity: float = 1.0) -> dict[str, float]:
        number = self._numbers.get(name)
        return colour(_INK if number is None else self._colours[number], opacity)


def _numbers(scenario: Scenario) -> Mapping[str, int]:
    return {parcel.name: number for number, parcel in enumerate(scenario.parcel)}


AGAIN_S = 1.0


class SceneLayer(Protocol):
    """One kind of thing in a scene: a topic with so many messages a second at most."""

    @property
    def topic(self) -> str:
        """Its name."""
        ...

    @property
    def rate_hz(self) -> float:
        """Eyes need no more."""
        ...

    def state(self, instant: int) -> Hashable:
        """What is shown: the same as long as nothing changes."""
        ...

    def parts(self, instant: int) -> Parts:
        """The entities at a sample of the record."""
        ...


def layers(scenario: Scenario, record: Record) -> list[SceneLayer]:
    """All that there is to be seen of a run."""
    found: list[SceneLayer] = [TableSurface(scenario), WheelBlocks(scenario, record)]
    if record.presence is not None:
        found.append(CoveredSensors(scenario, record))
    if record.identity is not None:
        found.append(HeldCellsLayer(scenario, record))
    if any(plan.goals for plan in record.plans) or any(
        goal_of(scenario, parcel) for parcel in scenario.parcel
    ):
        found.append(Goals(scenario, record))
    if any(plan.ways or plan.tiles for plan in record.plans):
        found.append(Plans(scenario, record))
    return [*found, *parcel_layers(scenario, record)]


def scene_messages(layer: SceneLayer, record: Record) -> Iterator[tuple[float, dict[str, Any]]]:
    """Times [s] and messages of one topic, as `foxglove.SceneUpdate`."""
    name = layer.topic.rpartition("/")[2]
    shown: Hashable = object()
    due_s = again_s = -np.inf
    for instant, time_s in enumerate(record.time_s.tolist()):
        if time_s < due_s:
            continue
        state = layer.state(instant)
        if state == shown and time_s < again_s:
            continue
        shown, due_s, again_s = state, time_s + 1 / layer.rate_hz - 1e-9, time_s + AGAIN_S - 1e-9
        yield time_s, scene_update(time_s, name, layer.parts(instant))
