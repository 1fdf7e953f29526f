"""Which parcels count as rejected, and so against the quality."""

from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from types import SimpleNamespace, coroutine
from typing import Any

import pytest

from mdms_host.line.machine import Figures, effectiveness
from mdms_host.line.packml import StateMachine
from mdms_host.programs.table_orders import LineOrder, TableOrders
from mdms_host.programs.table_parcel import ProgramError, TableParcel


@coroutine
def pause(*_arguments: object) -> Any:
    """Wait for ever."""
    while True:
        yield


async def refuse(*_arguments: object) -> None:
    raise ProgramError("there is no way")


def there_are(
    orders: TableOrders, count: int = 1, leave: Callable[..., Awaitable[None]] = pause
) -> list[TableParcel]:
    """Parcels that come to a table whose orders are carried out, each as far as it goes."""
    parcels = [TableParcel(f"box {n}", "box", 0.3, 0.3, "rectangle") for n in range(1, count + 1)]
    started: list[Coroutine[Any, Any, None]] = []
    table: Any = SimpleNamespace(parcels=parcels, start=started.append, sleep=pause)
    orders.begin_run()
    for parcel in parcels:
        parcel._see(SimpleNamespace())
        orders.on_parcel(parcel)
    orders.serve(table, pause, leave).send(None)
    for each in started:
        with suppress(StopIteration):
            each.send(None)
    return parcels


def figures_of(orders: TableOrders) -> tuple[Figures, list[tuple[str, str]]]:
    """What is counted, and the events of orders."""
    figures, told = Figures(), []
    for report in orders.take_reports():
        figures.count(report)
        if report.key:
            told.append((report.event, report.text))
    return figures, told


def quality(figures: Figures) -> float:
    return effectiveness(StateMachine(), figures, 0.0, 0.0)["quality"]


@pytest.mark.parametrize(
    ("by", "rejected", "end"),
    [
        ("north", 0, ("left", "")),
        ("east", 1, ("refused", "it has left by east")),
        (None, 1, ("lost", "")),
    ],
)
def test_a_parcel_that_does_not_leave_as_ordered_is_rejected(by, rejected, end) -> None:
    orders = TableOrders()
    orders.give(LineOrder("o1", "box 1", "north"))
    (box,) = there_are(orders)
    orders.on_left(box, by)
    figures, told = figures_of(orders)
    assert told == [("under way", ""), end]
    assert figures.parcels_rejected == rejected
    assert figures.parcels_out == (0 if by is None else 1)
    assert quality(figures) == 1 - rejected


def test_a_parcel_whose_order_was_refused_is_rejected_wherever_it_leaves() -> None:
    orders = TableOrders()
    orders.give(LineOrder("o1", "box 1", "north"))
    (box,) = there_are(orders, leave=refuse)
    orders.on_left(box, "north")
    figures, told = figures_of(orders)
    assert told[-1] == ("refused", "there is no way")
    assert (figures.out, figures.parcels_rejected) == ({"north": 1}, 1)


@pytest.mark.parametrize("scans", [True, False])
def test_a_parcel_without_identity_is_rejected_where_a_scanner_announces(scans) -> None:
    orders = TableOrders()
    if scans:
        orders.expect("P-1")
    for box in there_are(orders, 2):
        orders.on_left(box, "east")
    figures, _ = figures_of(orders)
    assert figures.parcels_rejected == (1 if scans else 0)
    assert quality(figures) == (0.5 if scans else 1.0)


@pytest.mark.parametrize(
    ("is_clear", "unknown", "started", "lost"),
    [
        (True, 0, False, 2),
        (False, 0, True, 1),
        (False, 0, False, 0),
        (False, 1, True, 0),
        (None, 0, True, 0),
    ],
)
def test_a_parcel_of_a_run_before_is_lost_where_the_next_run_does_not_find_it(
    is_clear, unknown, started, lost
) -> None:
    orders = TableOrders()
    orders.end_run(there_are(orders, 2), False)
    orders.begin_run()
    orders.started = started
    box = TableParcel("box 1", "box", 0.3, 0.3, "rectangle")
    if not is_clear:
        box._see(SimpleNamespace())  # type: ignore[arg-type]
        orders.on_parcel(box, lay_there=True)
    orders.end_run([] if is_clear else [box], is_clear, unknown)
    figures, _ = figures_of(orders)
    assert (figures.parcels_in, figures.parcels_lost, figures.parcels_rejected) == (2, lost, lost)
    # One that comes to a table on which nothing is left to be found is another one.
    orders.begin_run()
    orders.on_parcel(box, lay_there=True)
    assert figures_of(orders)[0].parcels_in == (1 if lost == 2 else 0)
