"""The coordinator's belief and behaviour when cells' speeds are late, lost, or do not come."""

import numpy as np
import pytest

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.recovery import Policy
from mdms_host.coordination.run_state import Phase
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.program import FieldProgram
from mdms_protocol import pdo
from mdms_protocol.codecs.frame import Frame

LAYOUT = Layout(6, 3, wheels=(WheelPlace(0.0, (0.0, 0.03)), WheelPlace(np.pi / 2, (0.03, 0.0))))
ALONG_X = np.tile([1.0, 0.0], LAYOUT.cells)
BOX, BOTTOM = Parcel("box", 0.36, 0.30), Rectangle(0.36, 0.30)


class Starting(FieldProgram):
    """A field along x whose reference grows by as much at every step, from when it is started."""

    def __init__(self, growth_m_s: float, most_m_s: float) -> None:
        super().__init__(np.zeros(len(ALONG_X)))
        self.started = False
        self._growth_m_s, self._most_m_s, self._now_m_s = growth_m_s, most_m_s, 0.0

    def references_m_s(self, poses, step_s, corrected=None):
        if self.started:
            self._now_m_s = min(self._now_m_s + self._growth_m_s, self._most_m_s)
        return ALONG_X * self._now_m_s


@pytest.fixture
def resting(rolling_array):
    """A coordinator that runs, its array, and its program, whose box has been found at rest."""

    def start(growth_m_s: float = 0.1, most_m_s: float = 0.1):
        program = Starting(growth_m_s, most_m_s)
        coordinator = Coordinator(LAYOUT, program, parcels=(BOX,), policy=Policy(pauses=0))
        array = rolling_array(LAYOUT, BOTTOM, (-0.05, 0.0, 0.0))
        array.run(coordinator, 1.0)
        assert coordinator.phase == Phase.RUNNING
        assert coordinator.estimate("box") is not None
        return coordinator, array, program

    return start


def losing(array, *node_ids: int, frames: float = np.inf) -> None:
    """Loses so many speed frames of each of these nodes."""
    left = {pdo.ACTUAL_VELOCITY.can_id(node_id): frames for node_id in node_ids}

    def lost(frame: Frame) -> bool:
        if left.get(frame.can_id, 0) <= 0:
            return False
        left[frame.can_id] -= 1
        return True

    array.lost = lost


def texts(coordinator: Coordinator, word: str) -> list[tuple[float, str]]:
    return [event for event in coordinator.events if word in event[1]]


def test_cells_that_still_report_show_how_the_parcel_moves(resting) -> None:
    coordinator, array, program = resting()
    truth_m, belief_m = array.pose[0], coordinator.estimate("box").x_m
    losing(array, 2, 4, 8, 9, 10, 14, 15)
    program.started = True
    array.run(coordinator, array.now_s + 0.09)
    assert array.pose[0] - truth_m > 0.003
    way_m = coordinator.estimate("box").x_m - belief_m
    assert way_m == pytest.approx(array.pose[0] - truth_m, abs=0.0015)


def test_every_answer_reaches_the_tracker_once_and_with_the_time_of_its_sync(
    resting, monkeypatch
) -> None:
    coordinator, array, program = resting(growth_m_s=0.001, most_m_s=0.2)
    arrived: list[tuple[float, float]] = []
    taken: list[tuple[float, float]] = []
    inner = coordinator.tracker.on_speeds

    def watch(frame: Frame) -> bool:
        if frame.can_id == pdo.ACTUAL_VELOCITY.can_id(1):
            arrived.append((array.now_s, pdo.ACTUAL_VELOCITY.decode(frame.data)[0] / 1e6))
        return False

    def on_speeds(now_s, speed_m_s, *others):
        taken.append((now_s, float(speed_m_s[0])))
        return inner(now_s, speed_m_s, *others)

    monkeypatch.setattr(coordinator.tracker, "on_speeds", on_speeds)
    array.lost, program.started = watch, True
    for _ in range(10):
        array.run(coordinator, array.now_s + 0.046)
        array.stalled_s = array.now_s + 0.01
        array.run(coordinator, array.now_s + 0.021)
    assert len(taken) > 40
    for time_s, speed_m_s in taken[1:]:
        (answer,) = [each for each in arrived if abs(each[0] - time_s - 0.004) < 5e-4]
        assert speed_m_s == pytest.approx(answer[1])
        arrived.remove(answer)


def test_a_cell_that_misses_two_syncs_does_not_matter(resting) -> None:
    coordinator, array, program = resting()
    program.started = True
    losing(array, 9, frames=2)
    array.run(coordinator, array.now_s + 0.3)
    assert coordinator.phase == Phase.RUNNING
    assert texts(coordinator, "no speeds") == []


def test_the_tracker_learns_of_a_lost_frame_once(resting, monkeypatch) -> None:
    coordinator, array, _ = resting()
    lost: list[float] = []
    monkeypatch.setattr(coordinator.tracker, "on_loss", lost.append)
    array.run(coordinator, array.now_s + 0.1)
    assert lost == []
    since_s = array.now_s
    losing(array, 9, frames=3)
    array.run(coordinator, since_s + 0.2)
    (time_s,) = lost
    assert 0.0 <= time_s - since_s < 0.03


def test_a_cell_whose_speeds_do_not_come_is_reported_soon_and_then_a_fault(resting) -> None:
    coordinator, array, program = resting()
    program.started = True
    since_s = array.now_s
    losing(array, 9)
    array.run(coordinator, since_s + 1.0, lambda: coordinator.fault is not None)
    assert coordinator.fault == "cell 9 (node 9) has fallen silent: no speeds for 0.1 s"
    assert array.now_s - since_s < 0.13
    ((time_s, text),) = texts(coordinator, "no speeds for 3 SYNCs")
    assert text.endswith("cell 9 (node 9)")
    assert time_s - since_s < 0.05


def test_without_any_speeds_wheels_stand_after_a_tenth_of_a_second_and_then_it_is_a_fault(
    resting,
) -> None:
    coordinator, array, program = resting()
    program.started = True
    array.run(coordinator, array.now_s + 0.1)
    since_s = array.now_s
    losing(array, *LAYOUT.node_ids)
    array.run(coordinator, since_s + 0.14)
    assert (coordinator.phase, coordinator.references_m_s.any()) == (Phase.RUNNING, False)
    believed_m = coordinator.estimate("box").x_m
    array.run(coordinator, since_s + 0.5)
    assert "fallen silent: no speeds for 0.3 s" in coordinator.fault
    assert coordinator.estimate("box").x_m == believed_m
