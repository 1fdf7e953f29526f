"""All parcels stand while somebody keeps them, on cells of real firmware."""

from tests.host.coordination.care.test_care import LAYOUT, Minding, Run, silence

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import Phase


def test_no_wheel_turns_while_parcels_are_kept_and_all_do_afterwards() -> None:
    run = Run()
    assert all(run.moving())
    run.coordinator.keep(True)
    run.pass_s(0.3)
    assert run.coordinator.phase is Phase.KEEPING
    assert not any(run.moving())
    run.pass_s(20.0)  # longer than any pause may last
    assert run.coordinator.fault is None
    run.coordinator.keep(False)
    run.until_running()
    run.pass_s(0.1)
    assert all(run.moving())


def test_a_run_that_is_kept_from_its_beginning_moves_nothing() -> None:
    run = Run()
    run.coordinator.stop()
    run.until(lambda: run.coordinator.stopped)
    run.coordinator = Coordinator(LAYOUT, Minding())
    run.coordinator.keep(True)
    moved = []
    run.until(lambda: moved.append(any(run.moving())) or run.coordinator.phase is Phase.KEEPING)
    run.pass_s(1.0)
    assert not any(moved[1:])
    assert not any(run.moving())


def test_cells_that_come_back_move_nothing_that_is_kept() -> None:
    run = Run()
    run.coordinator.keep(True)
    run.pass_s(6.0)
    silence(run)
    run.until(lambda: run.coordinator.phase is Phase.KEEPING)
    run.pass_s(1.0)
    assert run.coordinator.pauses == 1
    assert not any(run.moving())
    assert run.coordinator.fault is None


def test_a_run_that_is_kept_stops_in_order() -> None:
    run = Run()
    run.coordinator.keep(True)
    run.pass_s(0.1)
    run.coordinator.stop()
    run.until(lambda: run.coordinator.phase is Phase.STOPPED)
