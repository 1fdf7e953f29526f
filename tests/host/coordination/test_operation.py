"""Runs on firmware cells in virtual time; the link to them is the clock as well."""

import numpy as np
import pytest
from tests.host.cells_link import CellsLink

from mdms_host.can_link.link import DeviceGoneError
from mdms_host.coordination.bring_up import ExpectedCells
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import Ending, operate
from mdms_host.coordination.run_state import Phase, Timing
from mdms_host.layout import Layout
from mdms_host.motion.program import FieldProgram
from mdms_protocol.codecs import nmt

LAYOUT = Layout(3, 1)


@pytest.fixture
def link() -> CellsLink:
    return CellsLink((1, 2, 3))


def coordinator(timing: Timing | None = None) -> Coordinator:
    return Coordinator(LAYOUT, FieldProgram(np.full(6, 0.05)), timing=timing)


def test_a_field_runs_for_its_time_on_real_cells_and_leaves_them_off(link) -> None:
    heard, one = [], coordinator()
    done = operate(one, link, link, 2.0, on_event=lambda _now_s, _kind, text: heard.append(text))
    assert (done.ending, done.fault) == (Ending.DONE, None)
    assert done.duration_s >= 2.0
    assert Phase.RUNNING in heard
    assert heard[-1] == Phase.STOPPED
    assert not any(cell.moving for cell in one.cells)


def test_an_interrupt_ends_in_order(link) -> None:
    one, asked = coordinator(), []

    def interrupt(_now_s: float, _kind: str, text: str) -> None:
        if text == Phase.RUNNING:
            asked.append(KeyboardInterrupt())

    done = operate(
        one, link, link, 10.0, on_event=interrupt, interrupted=lambda: asked[0] if asked else None
    )
    assert (done.ending, done.interrupt) == (Ending.INTERRUPTED, asked[0])
    assert one.phase == Phase.STOPPED


def test_an_interrupt_whose_stop_a_cell_does_not_confirm_is_a_fault(link) -> None:
    one, asked = coordinator(), []

    def interrupt(_now_s: float, _kind: str, text: str) -> None:
        if text == Phase.RUNNING:
            link.cut = {1}
            asked.append(KeyboardInterrupt())

    done = operate(
        one, link, link, 10.0, on_event=interrupt, interrupted=lambda: asked[0] if asked else None
    )
    assert (done.ending, done.interrupt) == (Ending.FAULT, asked[0])
    assert done.fault == "not confirmed to be off: cell 2 (node 2); cut the motors' power"


class Broken(FieldProgram):
    """A signal breaks one of its steps off; a later step is noted."""

    steps = 0
    entered_again = False

    def references_m_s(self, beliefs, step_s):
        self.steps += 1
        self.entered_again |= self.steps > 20
        if self.steps == 20:
            raise KeyboardInterrupt
        return super().references_m_s(beliefs, step_s)


def test_a_cycle_that_was_broken_off_is_not_entered_again_and_cells_are_off(link, caplog) -> None:
    program = Broken(np.full(6, 0.05))
    one = Coordinator(LAYOUT, program)
    polls = []
    poll, one.poll = one.poll, lambda now_s: polls.append(now_s) or poll(now_s)
    with pytest.raises(KeyboardInterrupt):
        operate(one, link, link, 10.0)
    broken_off_s = link.now_s()
    link.sleep(0.3)
    assert "nobody knows what is off; cut the motors' power" in caplog.text
    assert polls[-1] <= broken_off_s
    assert not program.entered_again
    assert set(link.states.values()) == {nmt.PRE_OPERATIONAL}
    assert [link.targets_um_s(cell) for cell in range(3)] == [[0, 0]] * 3


def test_cells_are_off_after_a_cycle_that_was_broken_off_though_the_command_is_lost_twice(
    link, monkeypatch
) -> None:
    program, send, lost = Broken(np.full(6, 0.05)), link.send, []

    def lose(frame, until_s=None) -> None:
        if program.steps == 20 and len(lost) < 2:
            lost.append(frame)
        else:
            send(frame, until_s)

    monkeypatch.setattr(link, "send", lose)
    with pytest.raises(KeyboardInterrupt):
        operate(Coordinator(LAYOUT, program), link, link, 10.0)
    link.sleep(0.3)
    assert len(lost) == 2
    assert set(link.states.values()) == {nmt.PRE_OPERATIONAL}


class HalfGone(CellsLink):
    """Two buses as one link: that of cell 3 loses its device, for which nothing gets through."""

    gone = left = False

    def send_polled(self, participant, now_s):
        for bus, frame in participant.poll_buses(now_s):
            if bus == 0:
                self.send(frame)
            elif self.gone and not self.left:
                raise DeviceGoneError("right: the CAN device is gone")
            elif not self.gone:
                self.send(frame)

    def leave_gone(self):
        self.left = True
        return True


def test_cells_on_the_other_buses_are_stopped_in_order_when_one_device_is_gone() -> None:
    link = HalfGone((1, 2, 3))
    layout = Layout(3, 1, node_ids=(1, 2, 3), buses=(0, 0, 1))
    one = Coordinator(layout, FieldProgram(np.full(6, 0.05)))
    on_frame = one.on_frame
    one.on_frame = lambda frame, now_s: on_frame(frame, now_s, int(frame.can_id & 0x7F == 3))
    heard = []

    def lose(_now_s: float, _kind: str, text: str) -> None:
        heard.append(text)
        if text == Phase.RUNNING:
            link.gone, _ = True, link.cut.add(2)

    with pytest.raises(DeviceGoneError, match="right"):
        operate(one, link, link, 10.0, on_event=lose)
    gone_s = next(time_s for time_s, text in one.events if text == Phase.RUNNING)
    stopping_s = next(time_s for time_s, text in one.events if text == Phase.STOPPING)
    assert stopping_s - gone_s < 0.05
    assert one.stopped
    assert not any(cell.moving for cell in one.cells[:2])
    assert [link.targets_um_s(cell) for cell in range(2)] == [[0, 0]] * 2


def test_an_array_of_no_cells_is_told_as_such(link) -> None:
    link.power_off()
    done = operate(coordinator(Timing(phase_limit_s=0.2)), link, link, 10.0)
    assert done.ending == Ending.NO_CELLS


def test_no_cells_within_a_short_limit_are_told_as_such(link) -> None:
    link.power_off()
    done = operate(coordinator(), link, link, 0.2)
    assert done.ending == Ending.NO_CELLS
    assert done.fault == "no cell was heard within the limit of 0.2 s; is the bus connected?"


def test_a_missing_cell_is_a_fault(link) -> None:
    one = Coordinator(Layout(4, 1), FieldProgram(np.zeros(8)), timing=Timing(phase_limit_s=0.5))
    done = operate(one, link, link, 10.0)
    assert done.ending == Ending.FAULT
    assert done.fault == "not heard within 0.5 s: cell 4 (node 4)"


def test_a_board_that_is_not_the_one_that_is_listed_is_a_fault_before_any_drive_is_on(link) -> None:
    listed = {1: 1, 2: 0xC0FFEE, 3: 3}
    one = Coordinator(
        LAYOUT, FieldProgram(np.full(6, 0.05)), expected=ExpectedCells(serials=listed)
    )
    done = operate(one, link, link, 10.0)
    assert done.ending == Ending.FAULT
    assert done.fault.startswith(
        "cell 2 (node 2) has serial number 00000002, but the array file lists 00C0FFEE there; "
    )
    assert "mdms commission" in done.fault
    assert not {Phase.STARTING, Phase.ENABLING} & {text for _, text in one.events}
    assert (
        operate(
            Coordinator(LAYOUT, FieldProgram(np.zeros(6)), expected=ExpectedCells(serials={2: 2})),
            link,
            link,
            1.0,
        ).ending
        == Ending.DONE
    )


def test_a_second_run_takes_the_array_over_from_one_that_broke_off(link) -> None:
    class BrokenOffError(Exception):
        pass

    def break_off(_now_s: float, _kind: str, text: str) -> None:
        if text == Phase.RUNNING:
            raise BrokenOffError

    with pytest.raises(BrokenOffError):
        operate(coordinator(), link, link, 10.0, on_event=break_off)
    link.sleep(0.3)
    assert set(link.states.values()) == {nmt.OPERATIONAL}
    assert operate(coordinator(), link, link, 1.5).ending == Ending.DONE


def test_a_fault_names_the_parts_that_were_held_up(link) -> None:
    def hold_up(_now_s: float, _kind: str, text: str) -> None:
        if text == Phase.RUNNING:
            link.sleep(0.5)

    done = operate(coordinator(), link, link, 10.0, on_event=hold_up)
    assert done.ending == Ending.FAULT
    assert "the host's own cycle was up to" in done.fault


def test_a_computer_that_was_held_up_once_is_a_pause_that_says_so(link) -> None:
    heard: list[str] = []

    def hold_up(_now_s: float, _kind: str, text: str) -> None:
        if text == Phase.RUNNING and text not in heard:
            link.sleep(0.5)
        heard.append(text)

    done = operate(coordinator(), link, link, 3.0, on_event=hold_up)
    assert (done.ending, done.fault) == (Ending.DONE, None)
    assert heard.count(Phase.RUNNING) == 2
    assert any("held up (the host's own cycle was up to" in text for text in heard)


def test_an_error_in_the_cycle_leaves_the_array_off_and_is_raised(link) -> None:
    class Failing(FieldProgram):
        steps = 0

        def references_m_s(self, beliefs, step_s):
            self.steps += 1
            if self.steps == 20:
                raise ZeroDivisionError
            return super().references_m_s(beliefs, step_s)

    one = Coordinator(LAYOUT, Failing(np.full(6, 0.05)), timing=Timing())
    with pytest.raises(ZeroDivisionError):
        operate(one, link, link, 10.0)
    assert one.phase == Phase.STOPPED
    assert not any(cell.moving for cell in one.cells)


def test_an_ending_that_fails_as_well_takes_the_cells_out_of_operational(link, monkeypatch) -> None:
    one = coordinator()

    def fail(_now_s: float, _kind: str, text: str) -> None:
        if text == Phase.RUNNING:
            monkeypatch.setattr(one, "poll", lambda _now_s: 1 / 0)

    with pytest.raises(ZeroDivisionError):
        operate(one, link, link, 10.0, on_event=fail)
    link.sleep(0.3)
    assert set(link.states.values()) == {nmt.PRE_OPERATIONAL}
