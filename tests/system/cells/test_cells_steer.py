"""Cells steer a box by themselves: the traffic of the bus, and the way of the box without host."""

from contextlib import closing
from math import degrees, hypot
from types import SimpleNamespace

import numpy as np
import pytest

from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.neighbours import frames as wire
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

CELLS = range(1, 19)
GOAL = (0.0, 0.0, 0.2)
#: 0.10 m, and a turn: shorter than the demo's way.
SHORT = tuple(
    f"parcel.0.goal.{name}={value}"
    for name, value in zip(("x_m", "y_m", "yaw_rad"), GOAL, strict=True)
)
HOST_HEARTBEAT = cob.HEARTBEAT_BASE + cob.HOST_NODE
LOST = 0x8130
GONE_S = 1.1
#: Limit by friction where the wheels along the way carry half of the weight: mu g / 2.
FRICTION_M_S2 = 0.3 * 9.81 / 2


def run(until_s, *overrides):
    """A run, with all frames as (time [s], frame)."""
    scenario = load_scenario("neighbours", [*SHORT, *overrides])
    coordinator, frames = coordinator_of(scenario), []
    with closing(PythonBank(CELLS)) as bank:
        simulation = Simulation(scenario, bank, [coordinator])
        simulation.bus.observe(lambda frame, now_ns: frames.append((now_ns / 1e9, frame)))
        simulation.run_until(until_s)
        outcome = simulation.outcome()
    return SimpleNamespace(coordinator=coordinator, frames=frames, record=outcome.record)


def away(record):
    x_m, y_m, yaw_rad = record.pose[-1, 0] - GOAL
    return hypot(x_m, y_m), abs(degrees(yaw_rad))


def speed_m_s(record):
    return np.hypot(*record.twist[:, 0, :2].T)


@pytest.fixture(scope="module")
def steered():
    return run(3.6)


def test_cells_bring_the_box_to_its_goal_and_the_coordinator_agrees(steered):
    assert steered.coordinator.fault is None
    off_m, off_deg = away(steered.record)
    assert off_m < 0.005
    assert off_deg < 2.0
    assert steered.coordinator.finished
    assert "box has arrived" in [text for _, text in steered.coordinator.events]
    assert not steered.coordinator.troubles


def test_host_sends_the_program_until_it_is_acknowledged_and_no_setpoint_ever(steered):
    setpoints = {pdo.TARGET_VELOCITY.can_id(node) for node in CELLS}
    assert not any(frame.can_id in setpoints for _, frame in steered.frames)
    pages_s = [time_s for time_s, frame in steered.frames if frame.can_id == cob.PROGRAM]
    assert 3 <= len(pages_s) <= 12
    from_cells = {base + node for base in (*cob.TPDO_BASES, 0x080, 0x700) for node in CELLS}
    others = {
        frame.can_id
        for time_s, frame in steered.frames
        if time_s > pages_s[-1] and frame.can_id not in from_cells
    }
    assert others == {cob.SYNC, HOST_HEARTBEAT}


def test_record_shows_the_cells_that_have_the_box_as_it_passes(steered):
    record = steered.record
    assert record.identity.shape == record.state.shape == (len(record.time_s), 18)
    under = record.state == wire.UNDER
    assert set(np.unique(record.identity)) == {0, 1}
    # The box lies over columns 2 to 4, less than 10 mm from sensors of the first. It leaves that,
    # and comes to the fifth, whose cells are promised to it before.
    begun = np.flatnonzero(under.any(axis=1))[0]
    fifth = record.state[:, [4, 10, 16]]
    assert set(np.flatnonzero(under[begun + 10]) % 6 + 1) == {1, 2, 3, 4}
    assert not (fifth[begun + 10] == wire.UNDER).any()
    assert (fifth[-1] == wire.UNDER).any()
    assert not (record.state[-1, [0, 6, 12]] == wire.UNDER).any()
    promised = (fifth == wire.PROMISED).any(axis=1)
    assert np.flatnonzero(promised)[0] < np.flatnonzero((fifth == wire.UNDER).any(axis=1))[0]
    believed = np.nanmedian(record.belief[-1], axis=0)
    assert believed == pytest.approx(record.pose[-1, 0], abs=0.01)


def test_motion_ends_when_the_host_is_gone():
    gone = run(1.9, f"fault=[{{kind='host', start_s={GONE_S}}}]")
    heartbeats = [time_s for time_s, frame in gone.frames if frame.can_id == HOST_HEARTBEAT]
    errors = {
        frame.can_id - cob.EMCY_BASE: time_s
        for time_s, frame in gone.frames
        if frame.can_id - cob.EMCY_BASE in CELLS
        and int.from_bytes(frame.data[:2], "little") == LOST
    }
    assert set(errors) == set(CELLS)
    assert max(errors.values()) - heartbeats[-1] < 0.1
    record = gone.record
    before = record.time_s < GONE_S
    assert speed_m_s(record)[before][-1] > 0.05
    braking = record.time_s > heartbeats[-1] + 0.1
    assert speed_m_s(record)[braking][0] < speed_m_s(record)[before][-1]
    assert speed_m_s(record)[-1] < 1e-3
    assert away(record)[0] > 0.01
    reacted_s = min(errors.values())
    speed = np.interp(reacted_s, record.time_s, speed_m_s(record))
    start = [np.interp(reacted_s, record.time_s, record.pose[:, 0, axis]) for axis in (0, 1)]
    way_m = hypot(*(record.pose[-1, 0, :2] - start))
    assert way_m < 1.3 * speed**2 / (2 * FRICTION_M_S2)


def test_box_that_is_to_go_on_gets_to_its_goal_without_the_host():
    gone = run(3.6, "motion.go_on=true", f"fault=[{{kind='host', start_s={GONE_S}}}]")
    syncs = [time_s for time_s, frame in gone.frames if frame.can_id == cob.SYNC]
    assert np.diff(syncs).max() < 0.03 + 0.002
    # Cells that it only comes to later are as ready as those that have it.
    states = {
        frame.data
        for time_s, frame in gone.frames
        if time_s > GONE_S and frame.can_id - cob.HEARTBEAT_BASE in CELLS
    }
    assert states == {bytes((nmt.OPERATIONAL,))}
    off_m, off_deg = away(gone.record)
    assert off_m < 0.005
    assert off_deg < 2.0
    assert speed_m_s(gone.record)[-1] < 1e-3
