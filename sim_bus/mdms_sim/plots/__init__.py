"""Pictures of a run: position over time for rows, a top view for the plane; and animations.

Where the true poses are unknown, they show the coordinator's belief, and say so.
"""

from dataclasses import replace
from math import sin
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mdms_sim.plots.animation import FORMS, GIF, MP4, find_encoder, write_gif, write_mp4
from mdms_sim.plots.canvas import FORMATS, MARK, form_of, save
from mdms_sim.plots.plane import draw_plane
from mdms_sim.plots.row import draw_row
from mdms_sim.plots.wheels import draw_wheels

__all__ = ["MARK", "check_name", "is_row", "save_picture", "save_wheels"]

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mdms_model.run.record import Record
    from mdms_model.scenario.scenario import Scenario


def is_row(scenario: "Scenario") -> bool:
    """Whether all there is to see is position along one line: a row of wheels that push along x."""
    return scenario.array.rows == 1 and all(
        abs(sin(wheel.direction_rad)) < 1e-9 for wheel in scenario.cell.wheel
    )


def check_name(path: Path, *, wheels: bool = False) -> None:
    """Raise PictureFormatError for a name of which no picture of a run, or its wheels, is drawn.

    Also EncoderMissingError without an encoder for its format.
    """
    if form_of(path, FORMATS if wheels else (*FORMATS, *FORMS)) == MP4:
        find_encoder()


def save_picture(path: Path, scenario: "Scenario", record: "Record") -> None:
    """Draw a run into a file, in the way that suits its array; an animation if its name ends so.

    The same bytes for the same run. Raises OSError, PictureFormatError and EncoderMissingError.
    """
    form = form_of(path, (*FORMATS, *FORMS))
    shown = drawable(scenario, record)
    if form in FORMS:
        (write_gif if form == GIF else write_mp4)(path, *shown)
    else:
        draw = draw_row if is_row(scenario) else draw_plane
        save(draw(*shown), path)


def save_wheels(path: Path, scenario: "Scenario", record: "Record") -> None:
    """Draw every wheel's contact, forces and slip into a file; see `save`."""
    save(draw_wheels(scenario, record), path)


def drawable(scenario: "Scenario", record: "Record") -> "tuple[Scenario, Record]":
    """A record of belief with a pose at every sample: before it is found, a parcel lies there.

    Not where parcels come and go: such a one is where it is believed, and else away. Parcels that
    were never found are left out.
    """
    if record.estimate is None or not record.is_belief:
        return scenario, record
    pose = record.estimate.copy()
    known = np.asarray(np.isfinite(pose).all(axis=2))
    found = np.flatnonzero(known.any(axis=0))
    for number in () if scenario.stream else found:
        times = np.flatnonzero(known[:, number])
        nearest = np.searchsorted(times, np.arange(len(pose)), side="right") - 1
        pose[:, number] = pose[times[nearest.clip(0)], number]
    parcels = tuple(scenario.parcel[number] for number in found)
    title = f"{scenario.title} (as the coordinator believes)"
    # The host's belief is drawn for the truth here.
    shown = replace(record, pose=pose[:, found], estimate=None)
    if shown.identity is not None:
        shown.identity = _renumbered(shown.identity, found)
    return replace(scenario, title=title, parcel=parcels), shown


def _renumbered(identity: "NDArray[np.int8]", found: "NDArray[np.intp]") -> "NDArray[np.int8]":
    """Identities of the parcels found from 1 on, as they are counted now; the others after them."""
    others = np.setdiff1d(np.arange(np.iinfo(np.int8).max), found)
    number = np.zeros(np.iinfo(np.int8).max + 1, np.int8)
    number[np.concatenate((found, others)) + 1] = np.arange(1, len(number), dtype=np.int8)
    return number[identity]
