"""Runs on firmware cells in virtual time; the link to them is the clock as well."""

import numpy as np
import pytest
from tests.host.cells_link import CellsLink

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.operation import Ending, operate
from mdms_host.coordination.phase import Phase
from mdms_host.coordination.schedule import Timing
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
    done = operate(one, link, link, 2.0, on_event=lambda _now_s, text: heard.append(text))
    assert (done.ending, done.fault) == (Ending.DONE, None)
    assert done.duration_s >= 2.0
    assert Phase.RUNNING in heard
    assert heard[-1] == Phase.STOPPED
    assert not any(cell.moving for cell in one.cells)


def test_an_interrupt_ends_in_order(link) -> None:
    one = coordinator()

    def interrupt(_now_s: float, text: str) -> None:
        if text == Phase.RUNNING:
            raise KeyboardInterrupt

    done = operate(one, link, link, 10.0, on_event=interrupt)
    assert done.ending == Ending.INTERRUPTED
    assert one.phase == Phase.STOPPED


def test_an_array_of_no_cells_is_told_as_such(link) -> None:
    link.power_off()
    done = operate(coordinator(Timing(phase_limit_s=0.2)), link, link, 10.0)
    assert done.ending == Ending.NO_CELLS


def test_a_missing_cell_is_a_fault(link) -> None:
    one = Coordinator(Layout(4, 1), FieldProgram(np.zeros(8)), timing=Timing(phase_limit_s=0.5))
    done = operate(one, link, link, 10.0)
    assert done.ending == Ending.FAULT
    assert done.fault == "not heard within 0.5 s: cell 4 (node 4)"


def test_a_second_run_takes_the_array_over_from_one_that_broke_off(link) -> None:
    class BrokenOffError(Exception):
        pass

    def break_off(_now_s: float, text: str) -> None:
        if text == Phase.RUNNING:
            raise BrokenOffError

    with pytest.raises(BrokenOffError):
        operate(coordinator(), link, link, 10.0, on_event=break_off)
    link.sleep(0.3)
    assert set(link.states.values()) == {nmt.OPERATIONAL}
    assert operate(coordinator(), link, link, 1.5).ending == Ending.DONE


def test_a_fault_names_what_was_held_up(link) -> None:
    def hold_up(_now_s: float, text: str) -> None:
        if text == Phase.RUNNING:
            link.sleep(0.5)

    done = operate(coordinator(), link, link, 10.0, on_event=hold_up)
    assert done.ending == Ending.FAULT
    assert "this program's own cycle was up to" in done.fault


def test_a_computer_that_was_held_up_once_is_a_pause_that_says_so(link) -> None:
    heard: list[str] = []

    def hold_up(_now_s: float, text: str) -> None:
        if text == Phase.RUNNING and text not in heard:
            link.sleep(0.5)
        heard.append(text)

    done = operate(coordinator(), link, link, 3.0, on_event=hold_up)
    assert (done.ending, done.fault) == (Ending.DONE, None)
    assert heard.count(Phase.RUNNING) == 2
    assert any("held up (this program's own cycle was up to" in text for text in heard)


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

    def fail(_now_s: float, text: str) -> None:
        if text == Phase.RUNNING:
            monkeypatch.setattr(one, "poll", lambda _now_s: 1 / 0)

    with pytest.raises(ZeroDivisionError):
        operate(one, link, link, 10.0, on_event=fail)
    link.sleep(0.3)
    assert set(link.states.values()) == {nmt.PRE_OPERATIONAL}
