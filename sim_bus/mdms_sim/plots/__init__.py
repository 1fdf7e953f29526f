"""Pictures of a run: position over time for rows, a top view for the plane.

Where the true poses are unknown, they show the coordinator's belief, and say so.
"""

from dataclasses import replace
from math import sin
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mdms_sim.plots.canvas import MARK, save
from mdms_sim.plots.plane import draw_plane
from mdms_sim.plots.row import draw_row
from mdms_sim.plots.wheels import draw_wheels

__all__ = ["MARK", "is_row", "save_picture", "save_wheels"]

if TYPE_CHECKING:
    from mdms_model.run.record import Record
    from mdms_model.scenario.scenario import Scenario


def is_row(scenario: "Scenario") -> bool:
    """Whether all there is to see is position along one line: a row of wheels that push along x."""
    return scenario.array.rows == 1 and all(
        abs(sin(wheel.direction_rad)) < 1e-9 for wheel in scenario.cell.wheel
    )


def save_picture(path: Path, scenario: "Scenario", record: "Record") -> None:
    """Draw a run into a file, in the way that suits its array; see `save`."""
    draw = draw_row if is_row(scenario) else draw_plane
    save(draw(*drawable(scenario, record)), path)


def save_wheels(path: Path, scenario: "Scenario", record: "Record") -> None:
    """Draw every wheel's contact, forces and slip into a file; see `save`."""
    save(draw_wheels(scenario, record), path)


def drawable(scenario: "Scenario", record: "Record") -> "tuple[Scenario, Record]":
    """A record of belief with a pose at every sample: before it is found, a parcel lies there.

    Parcels that were never found are left out.
    """
    if record.estimate is None or not record.is_belief:
        return scenario, record
    pose = record.estimate.copy()
    known = np.asarray(np.isfinite(pose).all(axis=2))
    found = np.flatnonzero(known.any(axis=0))
    for number in found:
        times = np.flatnonzero(known[:, number])
        nearest = np.searchsorted(times, np.arange(len(pose)), side="right") - 1
        pose[:, number] = pose[times[nearest.clip(0)], number]
    parcels = tuple(scenario.parcel[number] for number in found)
    title = f"{scenario.title} (as the coordinator believes)"
    shown = replace(record, pose=pose[:, found], estimate=record.estimate[:, found])
    return replace(scenario, title=title, parcel=parcels), shown
