"""A table as plain values: the message `table`, the signals of a snapshot, the message `plan`.

The message `table` holds all that stays from snapshot to snapshot, signals included. A snapshot
packs the values of the signals in that order.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import Phase
from mdms_host.estimation.parcel import Parcel, outline_corners_m
from mdms_host.estimation.size import Size
from mdms_host.layout import Layout
from mdms_host.page.bus_watch import KINDS, CellState
from mdms_host.page.flow import NO_ENDS, Ends
from mdms_host.programs.program import TableProgram
from mdms_model.arrays import Floats

#: An outline that changes by less is the same for the eye [m].
_STEP_M = 0.005


@dataclass(frozen=True, slots=True)
class Thing:
    """A parcel, or a thing that may be one: its corners in its own frame [m].

    `size` is how large something unknown is, as far as its outline shows a rectangle.
    """

    corners_m: tuple[tuple[float, float], ...]
    unknown: bool = False
    size: Size | None = field(default=None, compare=False)


def things_of(told: tuple[Parcel, ...], coordinator: Coordinator | None) -> dict[str, Thing]:
    """All that a coordinator has to do with, those first that it was told of at the start."""
    things = {parcel.name: Thing(outline_corners_m(parcel)) for parcel in told}
    if coordinator is None:
        return things
    for name, parcel in coordinator.tracker.parcels.items():
        if name not in things:
            things[name] = Thing(outline_corners_m(parcel))
    for name, unknown in coordinator.tracker.unknown.items():
        rounded = (np.array(unknown.outline.corners_m) / _STEP_M).round() * _STEP_M
        things[name] = Thing(tuple((x, y) for x, y in rounded.tolist()), unknown=True)
    return things


def sized(things: dict[str, Thing], coordinator: Coordinator | None) -> dict[str, Thing]:
    """The same, each that is unknown with its size; takes milliseconds."""
    if coordinator is None:
        return things
    return {
        name: replace(thing, size=coordinator.tracker.size(name)) if thing.unknown else thing
        for name, thing in things.items()
    }


def described(things: dict[str, Thing]) -> list[dict[str, Any]]:
    """The same as the description of a table has it."""
    return [
        {
            "name": name,
            "outline_m": [list(corner) for corner in thing.corners_m],
            "unknown": thing.unknown,
            "size": None if thing.size is None else _described_size(thing.size),
        }
        for name, thing in things.items()
    ]


def _described_size(size: Size) -> dict[str, float]:
    return {
        "length_m": round(size.length_m, 4),
        "width_m": round(size.width_m, 4),
        "spread_m": round(max(size.deviation_m) / 2, 4),
    }


HEAD = struct.Struct("<II")
_TYPES: dict[str, np.dtype[Any]] = {
    "f8": np.dtype("<f8"),
    "f4": np.dtype("<f4"),
    "u1": np.dtype("u1"),
}


@dataclass(frozen=True, slots=True)
class SnapshotSignal:
    """A named array: its type (f8, f4 or u1), its shape, and the SI unit of its numbers.

    A number that is not known is NaN, and 0 in an array of bytes.
    """

    name: str
    type: str
    shape: tuple[int, ...]
    unit: str = ""


class SnapshotSignals:
    """The arrays of a table of this layout, with so many parcels and exits."""

    def __init__(self, layout: Layout, parcels: int, exits: int = 0) -> None:
        cells, wheels, buses = layout.cells, len(layout.wheel_cells), layout.bus_count
        self._signals = (
            SnapshotSignal("time", "f8", (1,), "s"),
            SnapshotSignal("speed", "f4", (1,), "1"),
            SnapshotSignal("real_time_factor", "f4", (1,), "1"),
            SnapshotSignal("jitter", "f4", (1,), "s"),
            SnapshotSignal("bus_load", "f4", (buses,), "1"),
            SnapshotSignal("bus_frames", "f4", (buses, len(KINDS)), "1/s"),
            SnapshotSignal("bus_errors", "f4", (buses,)),
            SnapshotSignal("bus_error_rate", "f4", (buses,), "1/s"),
            SnapshotSignal("bus_counters", "f4", (buses, 2)),
            SnapshotSignal("wheel_speed", "f4", (wheels,), "m/s"),
            SnapshotSignal("wheel_reference", "f4", (wheels,), "m/s"),
            SnapshotSignal("wheel_slip", "f4", (wheels,), "m/s"),
            SnapshotSignal("wheel_normal", "f4", (wheels,), "N"),
            SnapshotSignal("parcel_believed", "f4", (parcels, 3), "m, m, rad"),
            SnapshotSignal("parcel_spread", "f4", (parcels, 4), "m2, m2, m2, rad2"),
            SnapshotSignal("parcel_true", "f4", (parcels, 3), "m, m, rad"),
            SnapshotSignal("parcel_goal", "f4", (parcels, 3), "m, m, rad"),
            SnapshotSignal("parcels_came", "f4", (1,)),
            SnapshotSignal("parcels_left", "f4", (exits,)),
            SnapshotSignal("flow_time", "f4", (1,), "s"),
            SnapshotSignal("cell_state", "u1", (cells,)),
            SnapshotSignal("cell_presence", "u1", (cells,)),
            SnapshotSignal("cell_promise", "u1", (cells,)),
            SnapshotSignal("cell_promise_state", "u1", (cells,)),
            SnapshotSignal("parcel_state", "u1", (parcels,)),
            SnapshotSignal("phase", "u1", (1,)),
            SnapshotSignal("paused", "u1", (1,)),
        )

    def describe(self) -> list[dict[str, Any]]:
        """The arrays in their order, as JSON has them."""
        return [asdict(signal) for signal in self._signals]

    def pack(self, version: int, sequence: int, values: Mapping[str, Any]) -> bytes:
        """A snapshot of these values by name; a missing one is not known.

        Raises ValueError for a value of another shape.
        """
        return b"".join((HEAD.pack(version, sequence & 0xFFFF_FFFF), *self._arrays(values)))

    def _arrays(self, values: Mapping[str, Any]) -> Iterator[bytes]:
        for signal in self._signals:
            kind = _TYPES[signal.type]
            value: Any = values.get(signal.name)
            if value is None:
                value = np.full(signal.shape, 0 if signal.type == "u1" else np.nan)
            array = np.asarray(value, kind).reshape(signal.shape)
            yield array.tobytes()


def plan_of(coordinator: Coordinator | None) -> dict[str, Any]:
    """The message `plan`, empty where the program has neither ways nor tiles."""
    program = None if coordinator is None else coordinator.program
    if not isinstance(program, TableProgram):
        return planned({}, ())
    return planned(program.traffic.ways, program.traffic.reserved)


def planned(
    ways: Mapping[str, Floats], reserved: Iterable[tuple[float, float, float, tuple[str, ...]]]
) -> dict[str, Any]:
    """The message `plan` of the poses (K, 3) that are before each parcel, and of square tiles.

    A tile has its middle and side [m; table frame], and the parcels that pass over it in turn.
    """
    return {
        "kind": "plan",
        "paths": {name: poses.round(4).tolist() for name, poses in ways.items()},
        "tiles": [
            {"x_m": x_m, "y_m": y_m, "size_m": side_m, "parcels": list(parcels)}
            for x_m, y_m, side_m, parcels in reserved
            if parcels
        ],
    }


#: The phase while another program drives the cells.
OTHER_HOST = "another host drives"
#: The phases by the numbers that snapshots have; 0 is no program.
PHASES = ("no program", *(phase.value for phase in Phase), OTHER_HOST)
#: The knowledge of a parcel, by the numbers that snapshots have.
PARCEL_STATES = ("not found", "found", "doubtful", "arrived", "unknown", "in stock")


def describe(
    title: str,
    layout: Layout,
    things: dict[str, Thing],
    signals: SnapshotSignals,
    offers: tuple[str, ...],
    *,
    ends: Ends = NO_ENDS,
) -> dict[str, Any]:
    """The message `table`; places in the table frame [m], outlines in the parcels' own."""
    return {
        "kind": "table",
        "title": title,
        "simulated": False,
        "recorded": False,
        "offers": list(offers),
        "pitch_m": layout.pitch_m,
        "columns": layout.columns,
        "rows": layout.rows,
        "axes": len(layout.wheels),
        "node_ids": list(layout.node_ids),
        "buses": list(layout.buses),
        "bus_count": layout.bus_count,
        "cells_m": layout.cell_positions_m.round(6).tolist(),
        "wheels_m": layout.wheel_positions_m.round(6).tolist(),
        "wheel_directions": layout.wheel_directions.round(6).tolist(),
        "sensors_m": np.round(layout.sensor_offsets_m, 6).tolist(),
        "parcels": described(things),
        "cell_states": [state.name.lower() for state in CellState],
        "parcel_states": PARCEL_STATES,
        "phases": PHASES,
        "frame_kinds": KINDS,
        "signals": signals.describe(),
        **ends.describe(),
    }


NOT_FOUND, IN_STOCK = PARCEL_STATES.index("not found"), PARCEL_STATES.index("in stock")
_FOUND, _DOUBTFUL, _ARRIVED, _UNKNOWN = (
    PARCEL_STATES.index(state) for state in ("found", "doubtful", "arrived", "unknown")
)


def believed_signals(names: Iterable[str], coordinator: Coordinator) -> dict[str, Any]:
    """Pose, spread, goal and state of things with these names, in their order, and the phase."""
    names, goals = list(names), coordinator.goals
    believed, goal = np.full((2, len(names), 3), np.nan)
    spread, state = np.full((len(names), 4), np.nan), np.zeros(len(names), np.uint8)
    for number, name in enumerate(names):
        if name in goals:
            wanted = goals[name]
            yaw_rad = np.nan if wanted.yaw_rad is None else wanted.yaw_rad
            goal[number] = wanted.x_m, wanted.y_m, yaw_rad
        unknown = coordinator.tracker.unknown.get(name)
        if unknown is not None:
            believed[number], state[number] = unknown.pose, _UNKNOWN
        elif (estimate := coordinator.estimate(name)) is not None:
            believed[number] = estimate.x_m, estimate.y_m, estimate.yaw_rad
            covariance = coordinator.tracker.covariance(name)
            spread[number] = covariance[[0, 0, 1, 2], [0, 1, 1, 2]]
            state[number] = _state_of(name, coordinator)
    return {
        "phase": [PHASES.index(coordinator.phase.value)],
        "parcel_believed": believed,
        "parcel_spread": spread,
        "parcel_goal": goal,
        "parcel_state": state,
    }


def _state_of(name: str, coordinator: Coordinator) -> int:
    """The number of the state of a parcel that is believed somewhere."""
    if name in coordinator.tracker.doubtful:
        return _DOUBTFUL
    return _ARRIVED if name in coordinator.arrived_s else _FOUND


def stocked(state: Any, names: Iterable[str], ends: Ends) -> Any:
    """States of parcels with these names; those that may come and are not there are in stock."""
    states = np.array(state, np.uint8)
    waits = np.array([name in ends.stock for name in names], bool)
    states[waits & (states == NOT_FOUND)] = IN_STOCK
    return states
