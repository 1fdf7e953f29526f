"""Orders of a plant beside those of the program, for parcels that come, wait and are withdrawn."""

import pytest
from tests.host.programs.hands import Stage

from mdms_host.programs.table_orders import LineOrder
from mdms_host.programs.table_parcel import ProgramError


@pytest.mark.parametrize("ordered", [True, False])
@pytest.mark.parametrize("refused", [None, "no way to where it is to wait"])
def test_a_false_newcomer_before_a_full_exit_ends_neither_its_order_nor_the_program(
    ordered, refused
):
    async def main(table):
        async for parcel in table.arrivals():
            table.start(parcel.leave("east"))

    stage = Stage(main, coming=["box 1"])
    table = stage.program.table
    table.orders.begin_run()
    table.orders.full.add("east")
    if ordered:
        table.orders.give(LineOrder("o1", "box 1", "east"))
    stage.program.serve_orders()
    stage.run()
    stage.come("box 1")
    stage.run(0.1)
    assert table.orders.waiting == {"box 1"}
    stage.hands.orders["box 1"].refused = refused
    stage.withdraw("box 1")
    stage.run(0.1)
    assert stage.program.stuck is None
    events = [report.event for report in table.orders.take_reports()]
    assert "refused" not in events
    assert list(table.orders.open) == (["o1"] if ordered else [])
    table.orders.full.clear()
    stage.hands.log.clear()
    stage.come("box 1")
    stage.run(0.1)
    assert stage.log == [("box 1", "east")]


@pytest.mark.parametrize("order", ["move", "leave"])
def test_a_program_that_orders_a_parcel_of_the_plant_in_a_loop_waits_a_cycle_each_time(order):
    rounds = []

    async def main(table):
        box = table["box 1"]
        while True:
            await (box.move(0.2, 0.0) if order == "move" else box.leave("east"))
            rounds.append(table.now_s)
            assert len(rounds) < 100

    stage = Stage(main, lying=["box 1"])
    orders = stage.program.table.orders
    orders.begin_run()
    orders.give(LineOrder("o1", "box 1", x_m=0.1, y_m=0.0))
    stage.program.serve_orders()
    stage.run(0.05)
    stage.arrive("box 1")
    stage.run(0.2)
    assert stage.program.stuck is None
    assert [report.event for report in orders.take_reports()][-1] == "arrived"
    assert rounds == sorted(set(rounds))


def test_an_order_to_a_place_whose_parcel_leaves_is_refused_once_and_the_next_one_is_carried_out():
    async def main(table):
        async for parcel in table.arrivals():
            table.start(parcel.leave("north"))

    stage = Stage(main, coming=["box 1"])
    orders = stage.program.table.orders
    orders.begin_run()
    stage.program.serve_orders()
    stage.run()
    stage.come("box 1")
    orders.give(LineOrder("o1", "box 1", x_m=0.1, y_m=0.0))
    stage.run()
    stage.hands.orders.pop("box 1").refused = "box 1 has left the table"
    del stage.beliefs["box 1"]
    stage.program.driver.remove("box 1", "north")
    stage.run()
    orders.give(LineOrder("o2", "box 1", "east"))
    stage.come("box 1")
    stage.run()
    told = [(report.event, report.key) for report in orders.take_reports() if report.key]
    assert told == [("under way", "o1"), ("refused", "o1"), ("under way", "o2")]


def test_an_order_for_a_scanned_parcel_moves_no_other_one_whose_name_is_that_identity():
    async def main(table):
        async for _ in table.arrivals():
            pass

    stage = Stage(main, coming=["box 1", "box 2"])
    orders = stage.program.table.orders
    orders.begin_run()
    orders.expect("box 2")
    stage.program.serve_orders()
    stage.run()
    stage.come("box 1")
    stage.come("box 2")
    orders.give(LineOrder("o1", "box 2", "east"))
    stage.run(0.1)
    assert stage.log == [("box 1", "east")]
    orders.give(LineOrder("o2", "box 2 (not scanned)", "north"))
    stage.run(0.1)
    assert stage.log == [("box 2", "north")]
    found = [report.parcel for report in orders.take_reports() if report.event == "found"]
    assert found == ["box 2", "box 2 (not scanned)"]


def test_an_identity_that_an_unscanned_parcel_on_the_table_has_is_refused():
    async def main(table):
        await table.sleep(10.0)

    stage = Stage(main, lying=["box 1"], coming=["box 2"])
    orders = stage.program.table.orders
    orders.begin_run()
    stage.run()
    with pytest.raises(ProgramError, match="box 1 is on the table already"):
        orders.expect("box 1")
    del stage.beliefs["box 1"]
    stage.program.driver.remove("box 1")
    orders.expect("box 1")
    stage.come("box 2")
    assert orders.identities == {"box 2": "box 1"}


@pytest.mark.parametrize(("exit", "told"), [("east", "left"), (None, "lost")])
def test_an_order_whose_parcel_leaves_after_its_program_was_broken_off_is_over(exit, told):
    async def main(table):
        await table.sleep(0.1)
        raise ValueError("an error of the program")

    stage = Stage(main, lying=["box 1"])
    orders = stage.program.table.orders
    orders.begin_run()
    orders.give(LineOrder("o1", "box 1", "east"))
    stage.program.serve_orders()
    stage.run(0.2)
    del stage.beliefs["box 1"]
    stage.program.driver.remove("box 1", exit)
    stage.run(0.1)
    assert orders.rows(9) == []
    orders.end_run(stage.program.table.parcels, True)
    events = [report.event for report in orders.take_reports() if report.key]
    assert events == ["under way", told]
    assert not orders.in_doubt
