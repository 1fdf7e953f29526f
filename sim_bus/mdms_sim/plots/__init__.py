"""Pictures of a run: position over time for rows, a top view for the plane."""

from math import sin
from pathlib import Path
from typing import TYPE_CHECKING

from mdms_sim.plots.canvas import save
from mdms_sim.plots.plane import draw_plane
from mdms_sim.plots.row import draw_row
from mdms_sim.plots.wheels import draw_wheels

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
    save(draw(scenario, record), path)


def save_wheels(path: Path, scenario: "Scenario", record: "Record") -> None:
    """Draw every wheel's contact, forces and slip into a file; see `save`."""
    save(draw_wheels(scenario, record), path)
