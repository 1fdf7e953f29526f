"""A run in the plane made by hand, to keep, draw and export."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_model.run.record import Contact, Event, Record
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.neighbours import frames as wire

SAMPLES = 41


@pytest.fixture
def plane() -> Scenario:
    return load_scenario("array18", ["run.duration_s=4"])


@pytest.fixture
def plane_record(plane) -> Record:
    """The box glides to its goal; half of its wheels slip half of the time."""
    parcel, wheels = plane.parcel[0], 2 * plane.array.columns * plane.array.rows
    time_s = np.linspace(0.0, 4.0, SAMPLES)
    share = np.clip(time_s / 3, 0, 1)[:, None]
    start = np.array([parcel.x_m, parcel.y_m, parcel.yaw_rad])
    pose = start + share * (np.array([0.1, 0.0, 0.5236]) - start)
    estimate = pose + 0.001
    estimate[:5] = np.nan
    contact = np.full((SAMPLES, wheels), Contact.ROLLING, dtype=np.int8)
    contact[:, : wheels // 2] = Contact.NONE
    contact[::2, -wheels // 4 :] = Contact.SLIDING_BACKWARD
    numbers = np.random.default_rng(7).normal(size=(5, SAMPLES, wheels))
    return Record(
        time_s=time_s,
        pose=pose[:, None],
        twist=np.gradient(pose, time_s, axis=0)[:, None],
        reference_m_s=numbers[0],
        speed_m_s=numbers[1],
        voltage_v=numbers[2],
        normal_n=numbers[3],
        force_n=numbers[4],
        contact=contact,
        estimate=estimate[:, None],
        events=[
            Event(0.5, "coordinator", "running"),
            Event(1 / 3, "contact", "slips", parcel="box", cell=3, axis=2),
        ],
    )


@pytest.fixture
def believed_record(plane_record) -> Record:
    """The same as a coordinator on hardware sees it: no truth."""
    nothing, nowhere = (
        np.full_like(plane_record.speed_m_s, np.nan),
        np.full((SAMPLES, 1, 3), np.nan),
    )
    return replace(
        plane_record,
        pose=nowhere,
        twist=nowhere,
        voltage_v=nothing,
        normal_n=nothing,
        force_n=nothing,
        contact=np.full_like(plane_record.contact, Contact.UNKNOWN),
    )


#: Cells, from 0, at the box.
UNDER, PROMISED, NEAR = [7, 8], [9], [10]


@pytest.fixture
def held_record(plane_record) -> Record:
    """Cells 8 and 9 have the box and believe it 1 and 3 mm too far along x; 10 is promised to it.

    Nobody has reported anything in the first five samples.
    """
    samples, cells = len(plane_record.time_s), 18
    identity, state = (np.zeros((samples, cells), np.int8) for _ in range(2))
    for code, held in ((wire.UNDER, UNDER), (wire.PROMISED, PROMISED), (wire.NEAR, NEAR)):
        identity[5:, held] = 1
        state[5:, held] = code
    belief = np.full((samples, cells, 3), np.nan)
    for cell, ahead_m in zip([*UNDER, *PROMISED], (0.001, 0.003, 0.5), strict=True):
        belief[5:, cell] = plane_record.pose[5:, 0] + [ahead_m, 0.0, 0.01]
    return replace(plane_record, identity=identity, state=state, belief=belief)
