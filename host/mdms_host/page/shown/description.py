"""What of a table does not change from snapshot to snapshot, as its description has it."""

from typing import Any

import numpy as np

from mdms_host.coordination.phase import Phase
from mdms_host.layout import Layout
from mdms_host.page.shown.bus_watch import KINDS, CellState
from mdms_host.page.shown.signals import Signals
from mdms_host.page.shown.things import Thing, described

#: What is so while another program drives the cells.
OTHER_HOST = "another host drives"
#: The phases by the numbers that snapshots have; 0 is no program.
PHASES = ("no program", *(phase.value for phase in Phase), OTHER_HOST)
#: What is known of a parcel, by the numbers that snapshots have.
PARCEL_STATES = ("not found", "found", "doubtful", "arrived", "unknown")


def describe(
    title: str,
    layout: Layout,
    things: dict[str, Thing],
    signals: Signals,
    offers: tuple[str, ...],
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
    }
