"""The machine of a line on cells of real firmware, in virtual time; wheels by the simulator."""

import math
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from tests.host.line.virtual_line import TABLE, VirtualLine

from mdms_host.line import machine
from mdms_host.line.packml import Command, CommandRefusedError, Mode, State
from mdms_host.page.commands import PageRefusedError
from mdms_host.programs.table import Table
from mdms_host.programs.table_parcel import ProgramError
from mdms_model.scenario.file import load_scenario

pytestmark = pytest.mark.slow


@pytest.fixture
def line() -> Iterator[VirtualLine]:
    with VirtualLine() as line:
        yield line


@pytest.fixture
def impatient(monkeypatch) -> None:
    """The machine waits seconds where it would half a minute."""
    for name in ("BLOCKED_S", "STARVED_S", "_ACTING_LIMIT_S"):
        monkeypatch.setattr(machine, name, 2.0)


def order(key: str, parcel: str, **where: object) -> dict[str, object]:
    return {"order": {"key": key, "parcel": parcel, **where}}


def test_reset_starts_nothing_and_start_carries_parcels_to_their_exits(line) -> None:
    line.command(Command.RESET)
    line.until_state(State.IDLE)
    line.pass_s(3.0)
    assert line.state is State.IDLE
    with pytest.raises(CommandRefusedError, match="Reset is not possible in Idle; possible: Start"):
        line.command(Command.RESET)
    assert not line.moving()
    assert line.machine.figures.parcels_in == 1
    line.command(Command.START)
    line.until(lambda: line.machine.figures.parcels_out == 2, 20.0)
    line.command(Command.STOP)
    line.until_state(State.STOPPED)
    assert set(line.machine.figures.out) <= {"east", "south"}
    line.pass_s(2.0)  # wheels that are off are braked, and not at once at rest
    assert not line.moving()


def test_an_order_sends_a_parcel_of_a_scanned_identity_to_its_exit(line) -> None:
    line.do("coming", parcel="P-1", kind="")
    line.do("order", **order("o1", "P-1", exit="north"))
    line.bring_to_execute()
    line.until(lambda: "left" in line.of_order("o1"), 20.0)
    assert line.machine.figures.out["north"] == 1
    assert line.of_order("o1") == ["under way", "left"]
    left = next(report for report in line.reports if report.event == "left")
    assert (left.parcel, left.exit) == ("P-1", "north")


def test_a_lost_heartbeat_suspends_and_nothing_moves_before_unsuspend(line) -> None:
    line.bring_to_execute()
    line.until(line.moving, 10.0)
    line.beats = False
    line.until_state(State.SUSPENDED, 2.5)
    assert "heartbeat" in line.machine.states.reason
    line.pass_s(0.2)
    assert not line.moving()
    with pytest.raises(CommandRefusedError, match="without a heartbeat"):
        line.machine.command(Command.UNSUSPEND, "plc")
    line.beats = True
    line.pass_s(3.0)
    assert line.state is State.SUSPENDED
    assert not line.moving()
    line.command(Command.UNSUSPEND)
    line.until(line.moving, 5.0)


def test_hold_stops_parcels_under_way_and_unhold_takes_them_on(line) -> None:
    line.bring_to_execute()
    line.until(line.moving, 10.0)
    line.command(Command.HOLD)
    line.until_state(State.HELD, 3.0)
    line.pass_s(2.0)
    assert not line.moving()
    assert line.machine.snapshot()["alarm"] is None
    line.command(Command.UNHOLD)
    line.until(lambda: line.machine.figures.parcels_out >= 1, 20.0)


@pytest.mark.parametrize("is_first", [True, False])
def test_in_held_the_alarm_names_the_trouble_and_a_cure_that_is_taken(is_first) -> None:
    with VirtualLine(("run.on_lost_cell=hold",)) as line:
        line.bring_to_execute()
        if not is_first:
            line.command(Command.HOLD)
            line.until_state(State.HELD, 3.0)
        else:
            line.until(line.moving, 10.0)
            line.pass_s(0.2)
        off = line.begin("off", cells=(9,))
        line.until(lambda: line.machine.snapshot()["alarm"] is not None, 3.0)
        line.until_state(State.HELD, 3.0)
        alarm = line.machine.snapshot()["alarm"]
        assert "cell 9" in alarm["text"]
        assert alarm["cure"] == "mend it, then Unhold (or Stop)"
        line.simulation.faults.end(off)
        line.pass_s(3.0)
        line.command(Command.UNHOLD)
        line.until_state(State.EXECUTE)
        assert line.machine.snapshot()["alarm"] is None


def test_in_idle_the_alarm_names_the_cell_for_which_start_is_refused() -> None:
    with VirtualLine(("run.on_lost_cell=hold",)) as line:
        line.command(Command.RESET)
        line.until_state(State.IDLE)
        off = line.begin("off", cells=(9,))
        line.until(lambda: line.machine.snapshot()["alarm"] is not None, 3.0)
        with pytest.raises(CommandRefusedError, match=r"cell 9 .* give Start when it is back"):
            line.command(Command.START)
        alarm = line.machine.snapshot()["alarm"]
        assert line.state is State.IDLE
        assert "cell 9" in alarm["text"]
        assert alarm["cure"] == "mend it; Start is refused until then"
        line.simulation.faults.end(off)
        line.until(lambda: line.machine.snapshot()["alarm"] is None, 5.0)
        line.command(Command.START)
        line.until_state(State.EXECUTE)


def test_an_emergency_stop_aborts_and_its_release_moves_nothing(line) -> None:
    line.bring_to_execute()
    line.until(line.moving, 10.0)
    pressed = line.begin("supply", supply_v=0.0)
    line.until_state(State.ABORTED, 8.0)
    alarm = line.machine.snapshot()["alarm"]
    assert "supply" in alarm["text"]
    assert alarm["cure"]
    line.simulation.faults.end(pressed)
    line.pass_s(3.0)
    assert line.state is State.ABORTED
    assert not line.moving()
    with pytest.raises(CommandRefusedError, match="possible: Clear"):
        line.command(Command.RESET)
    line.command(Command.CLEAR)
    line.until_state(State.STOPPED)
    line.command(Command.RESET)
    line.until_state(State.IDLE)
    line.pass_s(1.0)
    assert not line.moving()
    line.command(Command.START)
    line.until_state(State.EXECUTE)


@pytest.mark.parametrize(
    ("command", "state"),
    [(Command.STOP, State.STOPPING), (Command.COMPLETE, State.COMPLETED)],
)
def test_a_stop_whose_cells_fall_silent_aborts(line, command, state) -> None:
    line.bring_to_execute()
    line.command(command)
    line.until_state(state)
    cut = line.begin("cut", cells=(1, 2, 3))
    line.until_state(State.ABORTED)
    assert line.machine.snapshot()["alarm"]["text"] == (
        "not confirmed to be off: cell 1 (node 1), cell 2 (node 2), cell 3 (node 3); "
        "cut the motors' power"
    )
    line.simulation.faults.end(cut)
    line.command(Command.CLEAR)
    line.until_state(State.STOPPED)
    line.bring_to_execute()


def test_a_full_exit_stops_its_own_parcels_only_and_all_of_them_suspend(line, impatient) -> None:
    line.do("exit", exit="east", full=True)
    line.do("exit", exit="south", full=True)
    line.bring_to_execute()
    line.until_state(State.SUSPENDED, 40.0)
    assert line.machine.states.reason == "no parcel can go on; full exits: east, south"
    assert line.machine.figures.parcels_out == 0
    line.do("exit", exit="east", full=False)
    line.do("exit", exit="south", full=False)
    line.until(lambda: line.machine.figures.parcels_out >= 2, 40.0)
    assert line.state is State.EXECUTE


@pytest.fixture
def waiting(line, impatient) -> VirtualLine:
    """A line in Suspended: the box P-1 waits before the full exit north, by its order."""
    line.do("exit", exit="north", full=True)
    line.do("coming", parcel="P-1", kind="box")
    line.do("order", **order("o1", "P-1", exit="north"))
    line.bring_to_execute()
    line.until_state(State.SUSPENDED, 40.0)
    return line


def test_a_parcel_before_a_full_exit_follows_its_next_order_once_that_is_cancelled(waiting) -> None:
    waiting.do("order", **order("o2", "P-1", exit="south", priority=9))
    waiting.pass_s(1.0)
    assert (waiting.state, waiting.of_order("o2")) == (State.SUSPENDED, [])
    waiting.do("cancel", key="o1")
    with pytest.raises(ProgramError, match="o1 is under way, or over"):
        waiting.do("cancel", key="o1")
    waiting.until(lambda: "left" in waiting.of_order("o2"), 20.0)
    assert waiting.of_order("o1") == ["under way"]
    assert waiting.of_order("o2") == ["under way", "left"]
    assert waiting.machine.figures.out["south"] == 1
    left = next(report for report in waiting.reports if report.event == "left")
    assert not left.rejected
    with pytest.raises(ProgramError, match="o2 is under way, or over"):
        waiting.do("cancel", key="o2")


@pytest.mark.parametrize(("first", "exit"), [("free", "north"), ("cancel", "east")])
def test_of_a_free_exit_and_a_cancellation_in_one_cycle_the_first_counts(
    waiting, first, exit
) -> None:
    if first == "cancel":
        waiting.do("cancel", key="o1")
    waiting.do("exit", exit="north", full=False)
    if first == "free":
        with pytest.raises(ProgramError, match="o1 is under way, or over"):
            waiting.do("cancel", key="o1")
    waiting.until(lambda: "left" in waiting.events("P-1"), 20.0)
    left = next(report for report in waiting.reports if report.event == "left")
    assert (left.parcel, left.exit, left.rejected) == ("P-1", exit, False)


def test_an_order_of_a_parcel_that_waited_by_the_program_is_cancelled_too(line) -> None:
    for exit in ("north", "east"):
        line.do("exit", exit=exit, full=True)
    line.bring_to_execute()
    line.until(lambda: "box 1" in line.machine.orders.waiting, 20.0)
    line.do("order", **order("o1", "box 1", exit="north"))
    line.pass_s(0.5)
    assert "box 1" in line.machine.orders.waiting
    line.do("order", **order("o2", "box 1", exit="south"))
    line.do("cancel", key="o1")
    line.until(lambda: "left" in line.of_order("o2"), 20.0)
    assert line.machine.figures.out["south"] >= 1


@pytest.mark.parametrize(
    ("by", "end"), [(Command.HOLD, State.STOPPED), (Command.START, State.ABORTED)]
)
def test_a_parcel_that_somebody_takes_off_counts_as_lost_once_the_run_ends(line, by, end) -> None:
    line.bring_to_execute()
    line.until(line.moving, 10.0)
    line.pass_s(0.5)
    if by is Command.HOLD:
        line.command(Command.HOLD)
        line.until_state(State.HELD, 3.0)
    line.take_parcels_off()
    if by is Command.HOLD:
        line.pass_s(2.0)
        line.command(Command.STOP)
    line.until_state(end, 12.0)
    assert line.events("box 1")[-1] == "lost"
    figures = line.machine.figures
    assert (figures.parcels_lost, figures.parcels_rejected) == (1, 1)
    assert line.machine.snapshot()["quality"] == 0.0


def test_a_program_gets_what_the_plant_reports_as_signals() -> None:
    heard: list[tuple[str, str]] = []

    async def main(table: Table) -> None:
        for signal in ("exit full", "exit free", "parcel coming", "parcel not coming"):
            heard.append((signal, await table.signal(signal)))

    with VirtualLine(recipes={TABLE.stem: (load_scenario(str(TABLE)), main)}) as line:
        line.bring_to_execute()
        line.do("exit", exit="east", full=True)
        line.do("exit", exit="east", full=True)  # nothing new
        line.do("exit", exit="east", full=False)
        line.do("coming", parcel="P-1")
        line.do("not_coming", parcel="P-1")
        line.until(lambda: len(heard) == 4, 10.0)
    assert heard == [
        ("exit full", "east"),
        ("exit free", "east"),
        ("parcel coming", "P-1"),
        ("parcel not coming", "P-1"),
    ]


def test_a_thing_in_the_infeed_is_named_where_no_parcel_comes(line, impatient) -> None:
    line.bring_to_execute()
    line.until(lambda: any(p["pose"][0] > -0.13 for p in line.machine.snapshot()["parcels"]), 10.0)
    line.command(Command.STOP)
    line.until_state(State.STOPPED)
    line.bring_to_execute()
    line.until_state(State.SUSPENDED, 40.0)
    reason = "no parcel comes; nobody knows unknown-1 at -0.06, 0.00 m: take it off"
    assert line.machine.states.reason == reason
    line.take_parcels_off()
    line.until(lambda: line.state is State.EXECUTE, 20.0)


def test_stop_leaves_an_order_under_way_in_doubt_and_does_not_repeat_it(line) -> None:
    line.do("coming", parcel="P-1", kind="")
    line.do("order", **order("o1", "P-1", exit="north"))
    line.bring_to_execute()
    line.until(lambda: "under way" in line.of_order("o1"), 10.0)
    line.until(line.moving, 10.0)
    line.command(Command.STOP)
    line.until_state(State.STOPPED)
    # A client that sees Stopped is told by then.
    assert line.of_order("o1") == ["under way", "in doubt"]
    line.bring_to_execute()
    line.pass_s(5.0)
    assert line.of_order("o1") == ["under way", "in doubt"]


def test_a_parcel_is_taken_to_the_pose_of_its_order(line) -> None:
    line.do("coming", parcel="P-1", kind="")
    line.do("order", **order("o1", "P-1", x_m=0.1, y_m=0.0))
    line.bring_to_execute()
    line.until(lambda: "arrived" in line.of_order("o1"), 20.0)
    (parcel,) = [one for one in line.machine.snapshot()["parcels"] if one["parcel"] == "P-1"]
    assert parcel["pose"][:2] == pytest.approx((0.1, 0.0), abs=0.012)


def test_maintenance_takes_no_reset_and_leaves_the_bus_to_others(line) -> None:
    line.do("mode", mode=2)
    with pytest.raises(CommandRefusedError, match="maintenance"):
        line.command(Command.RESET)
    assert not line.slot.busy
    line.do("mode", mode=1)
    line.bring_to_execute()
    with pytest.raises(CommandRefusedError, match="not changed in Execute, but in Stopped alone"):
        line.do("mode", mode=2)
    # A controller that has restarted writes its whole image again.
    line.do("mode", mode=1)
    line.do("recipe", recipe=TABLE.stem)
    assert line.state is State.EXECUTE


def test_a_run_that_is_stopped_by_hand_stops_the_machine(line) -> None:
    line.bring_to_execute()
    line.slot.stop()
    line.until_state(State.STOPPED)
    assert line.machine.states.reason == "stopped by hand"


def test_a_run_that_is_started_by_hand_moves_nothing_before_start(line) -> None:
    line.slot.start()
    line.until_state(State.IDLE)
    line.pass_s(3.0)
    assert not line.moving()


@pytest.mark.parametrize(
    ("mode", "command", "says"),
    [
        (Mode.MAINTENANCE, None, "the line is in Maintenance; change its mode"),
        (Mode.PRODUCTION, Command.ABORT, "the line is in Aborted, and .* in Stopped alone"),
    ],
)
def test_a_start_by_hand_that_the_machine_cannot_take_is_refused(line, mode, command, says) -> None:
    line.do("mode", mode=int(mode))
    if command is not None:
        line.command(command)
        line.until_state(State.ABORTED)
    state = line.state
    with pytest.raises(PageRefusedError, match=says):
        line.slot.start()
    line.pass_s(0.5)
    assert (line.state, line.slot.busy) == (state, False)


def test_a_run_that_the_machine_cannot_take_on_is_stopped_with_the_reason(line) -> None:
    line.do("mode", mode=int(Mode.MAINTENANCE))
    line.slot.begin()
    line.pass_s(2.0)
    assert (line.state, line.slot.busy, line.moving()) == (State.STOPPED, False, False)
    assert "maintenance" in line.machine.states.reason


def test_a_scanner_that_reports_a_parcel_twice_does_not_name_the_next_one(line) -> None:
    line.do("coming", parcel="P-1", kind="")
    with pytest.raises(ProgramError, match="expected already"):
        line.do("coming", parcel="P-1", kind="")
    line.bring_to_execute()
    line.until(lambda: "found" in line.events("P-1"), 10.0)
    with pytest.raises(ProgramError, match="on the table already"):
        line.do("coming", parcel="P-1", kind="")


@pytest.mark.parametrize(("turned_rad", "arrived"), [(0.0, True), (0.1, False)])
def test_an_order_in_doubt_is_confirmed_by_place_and_turn_alone(line, turned_rad, arrived) -> None:
    line.command(Command.RESET)
    line.until_state(State.IDLE)
    line.until(lambda: bool(line.machine.snapshot()["parcels"]), 10.0)
    (parcel,) = line.machine.snapshot()["parcels"]
    x_m, y_m, yaw_rad = parcel["pose"]
    pose = {"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad + turned_rad}
    line.do("in_doubt", **order("o1", parcel["parcel"], **pose))
    line.pass_s(0.5)
    assert line.of_order("o1") == (["arrived"] if arrived else [])


@pytest.mark.parametrize(
    ("reference_m_s", "speed_m_s", "rests"),
    [(0.0, 0.007, True), (0.0, 0.02, False), (0.05, 0.0, False), (0.0, math.nan, True)],
)
def test_wheels_stand_beside_the_noise_of_their_encoders(reference_m_s, speed_m_s, rests) -> None:
    wheels = np.zeros(108)
    run = SimpleNamespace(references_m_s=wheels + reference_m_s, speeds_m_s=wheels - speed_m_s)
    assert machine._stands(run) is rests


@pytest.fixture
def told() -> list[str]:
    """The recipes that programs were begun with."""
    return []


@pytest.fixture
def choosing(told) -> Iterator[VirtualLine]:
    """A line with the recipe `slow` beside its own: no parcel of it moves."""

    async def main(table: Table) -> None:
        told.append(table.recipe)
        await table.sleep(math.inf)

    scenario = load_scenario(str(TABLE), ["run.fidelity=firmware", "motion.speed_m_s=0.2"])
    with VirtualLine(recipes={"slow": (scenario, main)}) as line:
        yield line


def test_a_recipe_chosen_in_idle_is_that_of_the_next_start(choosing, told) -> None:
    choosing.command(Command.RESET)
    choosing.until_state(State.IDLE)
    choosing.do("recipe", recipe="slow")
    assert choosing.machine.snapshot()["recipe"] == "slow"
    choosing.pass_s(1.0)
    assert (choosing.state, told) == (State.IDLE, [])
    choosing.command(Command.START)
    choosing.until_state(State.EXECUTE)
    choosing.pass_s(3.0)
    assert told == ["slow"]
    assert choosing.slot.coordinator.program.table.recipe == "slow"
    assert not choosing.moving()
    with pytest.raises(CommandRefusedError, match="not chosen in Execute, but in Idle alone"):
        choosing.do("recipe", recipe="table")
    choosing.command(Command.STOP)
    choosing.until_state(State.STOPPED)
    with pytest.raises(CommandRefusedError, match="not chosen in Stopped, but in Idle alone"):
        choosing.do("recipe", recipe="table")
    choosing.command(Command.RESET)
    choosing.until_state(State.IDLE)
    choosing.do("recipe", recipe="table")
    choosing.command(Command.START)
    choosing.until_state(State.EXECUTE)
    choosing.until(lambda: choosing.machine.figures.parcels_out == 1, 20.0)
    assert dict(choosing.machine.shown()["counters"])["recipe"] == "table"


def test_a_recipe_chosen_in_idle_keeps_the_order_of_the_scanned_parcel(choosing) -> None:
    choosing.do("chosen", recipe="slow")
    choosing.do("coming", parcel="P-1", kind="")
    choosing.do("order", **order("o1", "P-1", exit="north"))
    choosing.command(Command.RESET)
    choosing.until(lambda: "under way" in choosing.of_order("o1"), 10.0)
    choosing.do("recipe", recipe="table")
    choosing.command(Command.START)
    choosing.until(lambda: "left" in choosing.of_order("o1"), 20.0)
    assert choosing.of_order("o1") == ["under way", "accepted", "under way", "left"]
    assert choosing.machine.figures.out["north"] == 1


def test_an_order_that_is_cancelled_in_idle_moves_nothing_after_start(choosing) -> None:
    choosing.do("chosen", recipe="slow")
    choosing.do("order", **order("o1", "box 1", exit="north"))
    choosing.command(Command.RESET)
    choosing.until(lambda: "under way" in choosing.of_order("o1"), 10.0)
    choosing.pass_s(0.5)
    choosing.do("cancel", key="o1")
    choosing.command(Command.START)
    choosing.until_state(State.EXECUTE)
    choosing.pass_s(2.0)
    assert not choosing.moving()
    choosing.do("order", **order("o2", "box 1", exit="north"))
    choosing.until(choosing.moving, 5.0)
    with pytest.raises(ProgramError, match="o2 is under way, or over"):
        choosing.do("cancel", key="o2")


def test_an_order_under_way_when_the_program_fails_is_in_doubt() -> None:
    async def main(table: Table) -> None:
        await table.arrival()
        await table.sleep(0.5)
        raise RuntimeError

    scenario = load_scenario(str(TABLE), ["run.fidelity=firmware"])
    with VirtualLine(recipes={"wrong": (scenario, main)}) as line:
        line.do("chosen", recipe="wrong")
        line.do("coming", parcel="P-1", kind="")
        line.do("order", **order("o1", "P-1", exit="north"))
        line.command(Command.RESET)
        line.until_state(State.IDLE)
        line.command(Command.START)
        line.until_state(State.ABORTED, 30.0)
        line.pass_s(0.1)
        assert line.of_order("o1") == ["under way", "in doubt"]
        assert "RuntimeError" in line.machine.states.reason


def test_a_stop_by_hand_while_the_recipe_changes_moves_nothing(choosing, told) -> None:
    choosing.command(Command.RESET)
    choosing.until_state(State.IDLE)
    choosing.do("recipe", recipe="slow")
    choosing.command(Command.START)
    choosing.pass_s(0.004)
    assert choosing.state is State.STARTING
    choosing.slot.stop_all()
    choosing.until_state(State.STOPPED)
    choosing.pass_s(2.0)
    assert (choosing.state, choosing.slot.busy, told) == (State.STOPPED, False, [])


def test_a_stop_by_hand_between_the_runs_of_two_recipes_moves_nothing(choosing) -> None:
    choosing.do("chosen", recipe="slow")
    choosing.command(Command.RESET)
    choosing.until_state(State.IDLE)
    choosing.do("recipe", recipe="table")
    choosing.command(Command.START)
    # The run of the old recipe has ended, and the machine has not seen that yet.
    kernel = choosing.simulation.kernel
    while choosing.slot.busy:
        choosing.machine.step()
        kernel.run_until(kernel.now_ns + 1_000_000)
    choosing.slot.stop_all()
    choosing.until_state(State.STOPPED)
    assert choosing.machine.states.reason == "stopped by hand"
    choosing.pass_s(5.0)
    assert (choosing.state, choosing.slot.busy, choosing.moving()) == (State.STOPPED, False, False)


def test_a_recipe_of_before_that_is_not_allowed_now_refuses_start(choosing, told) -> None:
    with pytest.raises(CommandRefusedError, match="no recipe 'gone'; there are: table, slow"):
        choosing.do("recipe", recipe="gone")
    choosing.do("chosen", recipe="gone")
    choosing.command(Command.RESET)
    choosing.until_state(State.IDLE)
    with pytest.raises(CommandRefusedError, match=r"'gone' was .* in Idle: table, slow"):
        choosing.command(Command.START)
    choosing.pass_s(2.0)
    assert (choosing.state, choosing.moving()) == (State.IDLE, False)
    choosing.do("recipe", recipe="slow")
    choosing.command(Command.START)
    choosing.until_state(State.EXECUTE)
    choosing.until(lambda: told == ["slow"], 5.0)


def test_a_recipe_is_not_chosen_in_completed() -> None:
    async def main(_table: Table) -> None:
        return

    job = load_scenario(str(TABLE)), main
    with VirtualLine(recipes={TABLE.stem: job, "other": job}) as line:
        line.bring_to_execute()
        line.until_state(State.COMPLETED)
        with pytest.raises(CommandRefusedError, match="not chosen in Completed, but in Idle alone"):
            line.do("recipe", recipe="other")
        assert line.machine.snapshot()["recipe"] == TABLE.stem


def test_a_cell_that_falls_out_in_suspended_holds_though_the_exits_become_free(impatient) -> None:
    with VirtualLine(("run.on_lost_cell=hold",)) as line:
        line.do("exit", exit="east", full=True)
        line.do("exit", exit="south", full=True)
        line.bring_to_execute()
        line.until_state(State.SUSPENDED, 40.0)
        off = line.begin("off", cells=(3,))
        line.until_state(State.HELD, 3.0)
        assert "cell 3" in line.machine.states.reason
        line.do("exit", exit="east", full=False)
        line.do("exit", exit="south", full=False)
        with pytest.raises(CommandRefusedError, match=r"cell 3 .* give Unhold when it is back"):
            line.command(Command.UNHOLD)
        line.pass_s(3.0)
        assert line.state is State.HELD
        line.simulation.faults.end(off)
        line.pass_s(3.0)
        assert line.state is State.HELD
        line.command(Command.UNHOLD)
        line.until(lambda: line.machine.figures.parcels_out >= 1, 20.0)


def test_a_parcel_that_lies_there_has_come_once_however_many_runs_find_it(line) -> None:
    line.command(Command.RESET)
    line.until(lambda: "found" in line.events("box 1"), 10.0)
    for _ in range(2):
        line.command(Command.STOP)
        line.until_state(State.STOPPED)
        line.command(Command.RESET)
        line.until_state(State.IDLE)
        line.pass_s(1.0)
    assert line.events("box 1").count("found") == 3
    assert line.machine.figures.parcels_in == 1
    line.command(Command.START)
    line.until(lambda: line.machine.figures.parcels_out == 1, 20.0)
    line.until(lambda: line.machine.figures.parcels_in == 2, 20.0)


def test_an_order_is_not_refused_because_there_was_no_place_to_wait_before_its_full_exit(
    line,
) -> None:
    line.do("coming", parcel="P-1", kind="")
    line.do("order", **order("o1", "P-1", exit="north"))
    line.bring_to_execute()
    line.until(line.moving, 10.0)
    line.pass_s(0.2)
    line.do("exit", exit="north", full=True)
    line.pass_s(1.0)
    line.command(Command.HOLD)
    line.until_state(State.HELD, 5.0)
    line.do("exit", exit="north", full=False)
    line.pass_s(1.0)
    line.command(Command.UNHOLD)
    line.until(lambda: len(line.of_order("o1")) > 1, 20.0)
    assert line.of_order("o1") == ["under way", "left"]


async def ends_soon(table: Table) -> None:
    await table.arrival()
    await table.sleep(0.3)


def test_the_job_is_done_once_the_orders_under_way_are_carried_out() -> None:
    with VirtualLine(recipes={TABLE.stem: (load_scenario(str(TABLE)), ends_soon)}) as line:
        line.do("coming", parcel="P-1", kind="")
        line.do("order", **order("o1", "P-1", exit="north"))
        line.bring_to_execute()
        line.until_state(State.COMPLETED, 20.0)
        assert line.of_order("o1") == ["under way", "left"]


def test_an_order_that_complete_has_broken_off_is_in_doubt_in_completed(line) -> None:
    line.do("coming", parcel="P-1", kind="")
    line.do("order", **order("o1", "P-1", exit="north"))
    line.bring_to_execute()
    line.until(line.moving, 10.0)
    line.command(Command.COMPLETE)
    line.until_state(State.COMPLETED)
    line.pass_s(1.0)
    assert line.of_order("o1") == ["under way", "in doubt"]


def test_a_person_sees_state_counters_and_orders_those_under_way_first(line) -> None:
    line.do("coming", parcel="P-1", kind="")
    line.do("exit", exit="east", full=True)
    line.do("order", **order("o0", "P-0", exit="east"))
    line.do("order", **order("o1", "P-1", exit="north"))
    shown = line.machine.shown()
    assert (shown["state"], shown["mode"], shown["alarm"]) == ("Stopped", "Production", None)
    assert shown["orders"][0] == ("o0", "P-0", "east", "accepted")
    line.bring_to_execute()
    line.until(lambda: line.machine.shown()["orders"][0][0] == "o1", 10.0)
    shown = line.machine.shown()
    assert shown["orders"][0] == ("o1", "P-1", "north", "under way")
    counters = dict(shown["counters"])
    assert (counters["parcels in"], counters["full exits"]) == ("1", "east")
    line.command(Command.ABORT)
    line.until_state(State.ABORTED)
    shown = line.machine.shown()
    assert shown["alarm"] == {
        "text": "Abort by plc",
        "cause": "a client's command",
        "cure": "Clear and Reset",
    }
    assert shown["orders"][0] == ("o1", "P-1", "north", "in doubt")
    line.do("cancel", key="o1")
    assert [row[0] for row in line.machine.shown()["orders"]] == ["o0"]
