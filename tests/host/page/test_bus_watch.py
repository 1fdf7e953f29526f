"""The state of a cell follows from its frames, and from nothing else."""

import numpy as np
import pytest

from mdms_host.layout import Layout
from mdms_host.page.bus_watch import KINDS, BusWatch, CellState
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame

NODE, OTHER = 1, 2
#: A neighbour, whose node id is in the first byte of details, contradicts.
SUSPICION = bytes((0x01, 0xFF, 0x80, 0x00, NODE, 0, 0, 0))


@pytest.fixture
def watch() -> BusWatch:
    return BusWatch(Layout(2, 1), silence_s=0.3)


def heartbeat(node: int, state: int = nmt.OPERATIONAL) -> Frame:
    return nmt.heartbeat(node, state)


def status(node: int, statusword: int, presence: int = 0) -> Frame:
    return Frame(pdo.STATUS.can_id(node), pdo.STATUS.encode((statusword, statusword, presence)))


def state_of(watch: BusWatch, now_s: float) -> CellState:
    return CellState(watch.states(now_s)[0])


def test_cell_is_off_ready_running_at_fault_suspected_and_silent_by_its_frames(watch):
    assert state_of(watch, 0.0) is CellState.OFF
    watch.on_frame(heartbeat(NODE, nmt.PRE_OPERATIONAL), 0.0)
    assert state_of(watch, 0.1) is CellState.READY
    watch.on_frame(status(NODE, cia402.OPERATION_ENABLED), 0.1)
    # Where it is not operational no motor runs, whatever its drives say.
    assert state_of(watch, 0.1) is CellState.READY
    watch.on_frame(heartbeat(NODE), 0.1)
    assert state_of(watch, 0.1) is CellState.RUNNING
    watch.on_frame(Frame(cob.EMCY_BASE + OTHER, SUSPICION), 0.15)
    assert state_of(watch, 0.15) is CellState.SUSPECTED
    watch.on_frame(status(NODE, cia402.FAULT), 0.2)
    assert state_of(watch, 0.2) is CellState.FAULT
    assert state_of(watch, 0.5) is CellState.SILENT
    watch.on_frame(heartbeat(NODE), 0.5)
    assert state_of(watch, 0.5) is CellState.FAULT


def test_a_cell_that_was_stopped_or_restarted_is_not_shown_as_before(watch):
    watch.on_frame(heartbeat(NODE), 0.0)
    speeds = pdo.ACTUAL_VELOCITY.encode((100_000, -50_000))
    watch.on_frame(Frame(pdo.ACTUAL_VELOCITY.can_id(NODE), speeds), 0.0)
    watch.on_frame(status(NODE, cia402.OPERATION_ENABLED, presence=0b101), 0.0)
    watch.on_frame(heartbeat(NODE, nmt.PRE_OPERATIONAL), 0.1)
    assert np.isnan(watch.speeds_m_s(0.1)).all()
    assert watch.presence(0.1) == bytes(2)
    watch.on_frame(status(NODE, cia402.FAULT), 0.2)
    # A fault stands where the cell is only stopped; a restart ends it.
    watch.on_frame(heartbeat(NODE, nmt.PRE_OPERATIONAL), 0.2)
    assert state_of(watch, 0.2) is CellState.FAULT
    watch.on_frame(heartbeat(NODE, nmt.INITIALISING), 0.3)
    watch.on_frame(heartbeat(NODE, nmt.PRE_OPERATIONAL), 0.3)
    assert state_of(watch, 0.3) is CellState.READY


def test_a_silent_cell_is_not_shown_as_it_was_last(watch):
    watch.on_frame(heartbeat(NODE), 0.0)
    speeds = pdo.ACTUAL_VELOCITY.encode((100_000, -50_000))
    watch.on_frame(Frame(pdo.ACTUAL_VELOCITY.can_id(NODE), speeds), 0.0)
    watch.on_frame(status(NODE, cia402.OPERATION_ENABLED, presence=0b101), 0.0)
    assert watch.speeds_m_s(0.1)[:2] == pytest.approx([0.1, -0.05])
    assert watch.presence(0.1) == bytes((0b101, 0))
    assert np.isnan(watch.speeds_m_s(0.4)).all()
    assert watch.presence(0.4) == bytes(2)


def test_frames_are_counted_by_kind_and_garbage_changes_nothing(watch):
    watch.on_frame(heartbeat(NODE), 0.0)
    for frame in (
        Frame(pdo.STATUS.can_id(NODE), b"\x01"),
        Frame(pdo.ACTUAL_VELOCITY.can_id(NODE), b""),
        Frame(pdo.TARGET_VELOCITY.can_id(NODE), b"\x01\x02"),
        Frame(cob.HEARTBEAT_BASE + NODE, b"\x01\x02\x03"),
        Frame(cob.EMCY_BASE + NODE, b"\xff"),
        Frame(0x7FF, bytes(8)),
    ):
        watch.on_frame(frame, 0.1)
    counts = dict(zip(KINDS, watch.frames[0], strict=True))
    assert {kind: count for kind, count in counts.items() if count} == {
        **{"setpoints": 1, "speeds": 1, "states": 1},
        **{"heartbeats": 2, "emergencies": 1, "other": 1},
    }
    assert state_of(watch, 0.1) is CellState.READY
    assert np.isnan(watch.speeds_m_s(0.1)).all()
    assert watch.references_m_s.tolist() == [0.0] * 4
