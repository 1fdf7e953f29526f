"""What of a table does not change from snapshot to snapshot, as its description has it."""

from math import cos, sin
from typing import Any

import numpy as np

from mdms_host.coordination.phase import Phase
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.page.bus_watch import KINDS, CellState
from mdms_host.page.signals import Signals

#: The phases by the numbers that snapshots have; 0 is no program.
PHASES = ("no program", *(phase.value for phase in Phase))
#: What is known of a parcel, by the numbers that snapshots have.
PARCEL_STATES = ("not found", "found", "doubtful", "arrived")
_DISC_CORNERS = 48


def describe(
    title: str,
    layout: Layout,
    outlines_m: dict[str, Any],
    signals: Signals,
    offers: tuple[str, ...],
) -> dict[str, Any]:
    """The message `table`; places in the table frame [m], outlines of parcels in their own."""
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
        "parcels": [{"name": name, "outline_m": corners} for name, corners in outlines_m.items()],
        "cell_states": [state.name.lower() for state in CellState],
        "parcel_states": PARCEL_STATES,
        "phases": PHASES,
        "frame_kinds": KINDS,
        "signals": signals.describe(),
    }


def outlines_of(parcels: tuple[Parcel, ...]) -> dict[str, Any]:
    """The corners of each parcel's outline, by its name."""
    return {parcel.name: outline_m(parcel) for parcel in parcels}


def outline_m(parcel: Parcel) -> list[list[float]]:
    """The corners of a parcel's outline in its own frame; a disc has many."""
    if parcel.shape == "polygon":
        return [list(corner) for corner in parcel.corners_m]
    if parcel.shape == "disc":
        turns = np.linspace(0.0, 2 * np.pi, _DISC_CORNERS, endpoint=False)
        radius_m = parcel.length_m / 2
        return [[radius_m * cos(turn), radius_m * sin(turn)] for turn in turns.tolist()]
    half_m = parcel.length_m / 2, parcel.width_m / 2
    return [[x * half_m[0], y * half_m[1]] for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
