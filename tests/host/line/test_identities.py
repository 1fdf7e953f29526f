"""Which parcel has an announced identity: after a stop, after a mistake, and after a restart."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from tests.host.line.virtual_line import VirtualLine

from mdms_host.line.packml import Command, State
from mdms_host.programs.table_orders import TableOrders
from mdms_host.programs.table_parcel import ProgramError, TableParcel
from mdms_model.run.record import exit_of


@pytest.fixture
def line() -> Iterator[VirtualLine]:
    with VirtualLine() as line:
        yield line


def send(line: VirtualLine, number: int, exit: str = "north") -> None:
    """Announce a parcel, and order it to an exit."""
    line.do("coming", parcel=f"P-{number}", kind="")
    line.do("order", order={"key": f"o{number}", "parcel": f"P-{number}", "exit": exit})


def left_by_kind(parcel: str) -> str:
    """The exit for a parcel without an order."""
    return "east" if parcel.startswith("box") else "south"


def exits(line: VirtualLine) -> list[tuple[str, str]]:
    """Parcels that have left, by the simulator: names of the scenario, and exits."""
    return [(e.parcel, exit_of(e)) for e in line.simulation.world.events if e.kind == "exit"]


@pytest.mark.slow
def test_a_parcel_left_by_a_stop_takes_no_identity_that_was_announced(line) -> None:
    send(line, 1)
    send(line, 2)
    line.command(Command.RESET)
    line.until(lambda: "found" in line.events("P-1"), 10.0)
    line.command(Command.ABORT)
    line.until_state(State.ABORTED)
    line.command(Command.CLEAR)
    line.until_state(State.STOPPED)
    line.command(Command.RESET)
    line.until_state(State.IDLE)
    assert line.events("P-2") == ["unannounced"]
    line.do("coming", parcel="P-2", kind="")
    line.command(Command.START)
    line.until(lambda: "left" in line.of_order("o2"), 40.0)
    assert line.of_order("o1") == ["under way", "in doubt"]
    first, second = [e.parcel for e in line.simulation.world.events if e.kind == "arrival"][:2]
    assert exits(line)[:2] == [(first, left_by_kind(first)), (second, "north")]


@pytest.mark.slow
def test_a_parcel_that_a_hand_lifts_in_held_has_not_left_by_the_exit_of_its_order(line) -> None:
    send(line, 1)
    line.bring_to_execute()
    line.until(line.moving, 10.0)
    line.pass_s(0.3)
    line.command(Command.HOLD)
    line.until_state(State.HELD)
    line.begin("lift", parcel="box 1")
    line.pass_s(0.6)
    assert line.of_order("o1") == ["under way"]
    assert line.machine.figures.parcels_out == 0


@pytest.mark.slow
def test_a_parcel_that_came_to_a_clear_table_in_stopped_is_the_announced_one() -> None:
    with VirtualLine(("stream.0.start_s=8.0",)) as line:
        line.bring_to_execute()
        line.command(Command.STOP)
        line.until_state(State.STOPPED)
        assert line.now_s() < 8.0
        send(line, 1)
        line.pass_s(10.0 - line.now_s())
        line.bring_to_execute()
        line.until(lambda: "left" in line.of_order("o1"), 40.0)
        assert exits(line)[0][1] == "north"


@pytest.mark.slow
def test_after_a_restart_a_parcel_that_lies_there_has_no_identity(line) -> None:
    line.do("restore", figures={"parcels_in": 1, "of_a_later_version": 2}, spent_s={}, reason="")
    line.pass_s(1.5)
    assert [e.kind for e in line.simulation.world.events] == ["arrival"]
    line.command(Command.RESET)
    line.until_state(State.IDLE)
    send(line, 1)
    line.command(Command.START)
    line.until(lambda: "left" in line.of_order("o1"), 40.0)
    first, second = [e.parcel for e in line.simulation.world.events if e.kind == "arrival"][:2]
    assert exits(line)[:2] == [(first, left_by_kind(first)), (second, "north")]
    # The one that lay there had come before.
    assert line.machine.figures.parcels_in == [r.event for r in line.reports].count("found")


def parcel(name: str, kind: str = "box") -> TableParcel:
    return TableParcel(name, kind, 0.3, 0.3, "rectangle")


def test_a_parcel_that_was_another_kind_gives_its_identity_back() -> None:
    orders = TableOrders()
    orders.begin_run()
    for name in ("P-1", "P-2"):
        orders.expect(name)
    wrong, right, next_ = parcel("box 1"), parcel("disc 1", "disc"), parcel("box 2")
    orders.on_parcel(wrong)
    orders.on_withdrawn(wrong)
    orders.on_parcel(right)
    orders.on_parcel(next_)
    assert [orders.identity(each) for each in (right, next_)] == ["P-1", "P-2"]
    told = [(report.event, report.parcel) for report in orders.take_reports()]
    assert told == [("found", "P-1"), ("withdrawn", "P-1"), ("found", "P-1"), ("found", "P-2")]


def test_a_parcel_that_does_not_come_after_all_is_expected_no_more() -> None:
    orders = TableOrders()
    orders.begin_run()
    orders.expect("P-1")
    orders.expect("P-2")
    orders.expect_no_more("P-1")
    with pytest.raises(ProgramError, match="P-1 is not expected"):
        orders.expect_no_more("P-1")
    one = parcel("box 1")
    orders.on_parcel(one)
    assert orders.identity(one) == "P-2"


def test_of_two_scanned_parcels_of_a_kind_none_has_an_identity_in_the_next_recipe() -> None:
    orders = TableOrders()
    orders.begin_run()
    for name in ("P-1", "P-2", "P-3"):
        orders.expect(name)
    there = [parcel("box 1"), parcel("box 2")]
    for each in there:
        each._see(SimpleNamespace())  # type: ignore[arg-type]
        orders.on_parcel(each)
    orders.begin_run(orders.begin_again(there))
    assert orders.take_reports()[-1].event == "found"
    for each in there:
        orders.on_parcel(each, lay_there=True)
    assert [orders.identity(each) for each in there] == ["box 1", "box 2"]
    # Nobody knows whether P-3 is one of them.
    assert ("unannounced", "P-3") in [(each.event, each.parcel) for each in orders.take_reports()]
