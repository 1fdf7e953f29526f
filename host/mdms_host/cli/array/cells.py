"""`mdms scan`, `mdms status` and `mdms stop`: the nodes of a table, their states, everything off.

They take a whole table: by its array file, or by the name of a served one. Missing cells are named,
and the exit code is 5 then.
"""

import json
import sys
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import asdict, dataclass, replace
from threading import Thread

from rich.live import Live

from mdms_array.bus_load import warn_of_load, wire_of
from mdms_host.can_link.link import AnyLink, LinkError, drive, open_bus
from mdms_host.can_link.links import OnEachBus, open_links
from mdms_host.can_link.remote_cell import BROKEN_OFF, CUT, UPDATE_RUNS
from mdms_host.cli.array.table import figures_of, named_table, refuse_missing
from mdms_host.cli.console import dots, show
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.options import NO_NODES
from mdms_host.cli.streams import say
from mdms_host.clock import Clock, MonotonicClock
from mdms_host.commissioning.array_file import ArrayFileError
from mdms_host.commissioning.network import counted, ranges
from mdms_host.commissioning.status import (
    CellStatus,
    FoundNode,
    StatusModel,
    scan_bus,
    scan_table,
    status_table,
)
from mdms_host.commissioning.stop import StopReport, not_off_text, stop_all
from mdms_host.commissioning.table_cells import (
    HeardCells,
    MissingCells,
    TableBus,
    TableBuses,
    missing_cells,
)

#: Ten heartbeats at their default period.
LISTEN_S = 1.0
#: How long cells are asked, once all is off, who is beside them.
ASK_S = 0.5
REDRAW_S = 0.2
#: A bus whose adapter holds a stop up is given up after so long: opening takes 5 s at most [s].
STUCK_S = 10.0


def scan(arguments: Namespace) -> ExitCode:
    """Read the identity of every node, and print them."""
    table, clock = named_table(arguments), MonotonicClock()
    nodes = {bus.name: scan_bus(open_bus(bus.options), clock) for bus in table.buses}
    missing = missing_cells(
        [_heard(table, number, some) for number, some in enumerate(nodes.values())],
        arguments.cells,
    )
    count = sum(map(len, nodes.values()))
    if arguments.json:
        rows = [
            asdict(node) | ({"bus": bus} if table.is_split else {})
            for bus, some in nodes.items()
            for node in some
        ]
        print(json.dumps({"nodes": rows, **figures_of(missing)}))
    elif count:
        show(scan_table(nodes))
    if not count:
        raise CommandError(NO_NODES, ExitCode.NO_DEVICE)
    crowded = max(sum(node.is_cell for node in some) for some in nodes.values())
    warn_of_load(crowded, wire_of(table.options))
    refuse_missing(table.is_split, missing)
    _refuse_unfit(table, nodes)
    return ExitCode.OK


def _refuse_unfit(table: TableBuses, nodes: Mapping[str, Sequence[FoundNode]]) -> None:
    """Raise `CommandError` where a cell speaks another protocol, or a node does not answer."""
    texts = []
    for bus, some in nodes.items():
        cells = [node for node in some if node.is_cell or node.identity is None]
        if unfit := [node.node_id for node in cells if node.problem]:
            texts.append(f"{f'{bus}, ' if table.is_split else ''}node {ranges(unfit)}")
    if texts:
        named = ", ".join(texts)
        raise CommandError(
            f"not fit for a run: {named}; mdms doctor names the cure", ExitCode.NODE_FAULT
        )


def _heard(table: TableBuses, number: int, nodes: Sequence[FoundNode]) -> HeardCells:
    """The cells among the nodes of a bus; one that cannot be read may be one."""
    there = [node for node in nodes if node.is_cell or node.identity is None]
    return HeardCells(
        table.buses[number],
        frozenset(node.node_id for node in there),
        {node.node_id: node.neighbours for node in there},
    )


def status(arguments: Namespace) -> ExitCode:
    """Listen and show; on a terminal until Ctrl-C, else once."""
    table = named_table(arguments)
    models = [StatusModel() for _ in table.buses]
    with open_links(table.options, table.channels) as (link, clock):
        end_s = clock.now_s() + LISTEN_S
        drive(OnEachBus(models), link, clock, lambda: clock.now_s() >= end_s)
        rows = _rows(table, models, clock.now_s())
        if arguments.json:
            pass
        elif rows and sys.stdout.isatty() and not arguments.once:
            _show_live(table, models, link, clock)
            rows = _rows(table, models, clock.now_s())
        elif rows:
            show(status_table(rows, dots()))
        if not arguments.json:
            _show_link(link)
    _tell_updates(models)
    missing = _missing_of(table, models, arguments.cells)
    if arguments.json:
        cells = [_row(row, split=table.is_split) for row in rows]
        print(json.dumps({"cells": cells, "link": asdict(link.counts), **figures_of(missing)}))
    if not rows:
        raise CommandError(NO_NODES, ExitCode.NO_DEVICE)
    crowded = max(len(model.cells) for model in models)
    warn_of_load(crowded, wire_of(table.options))
    refuse_missing(table.is_split, missing)
    _refuse_faulty(rows)
    return ExitCode.OK


def stop(arguments: Namespace) -> ExitCode:
    """Turn everything off and report which cells have confirmed it.

    All buses are opened and stopped at once, each by itself: a slow one holds up no other.
    """
    try:
        table = named_table(arguments)
    except ArrayFileError as error:
        raise CommandError(f"not stopped, so {CUT}: {error}", ExitCode.USAGE) from None
    try:
        stopping = [(bus, _begin_to_stop(bus)) for bus in table.buses]
        wait([end for _, end in stopping], STUCK_S)
    except KeyboardInterrupt:
        say(f"mdms: {BROKEN_OFF}")
        raise
    ends = [(bus, end.result() if end.done() else _stuck()) for bus, end in stopping]
    stopped = [(bus, end) for bus, end in ends if not isinstance(end, LinkError)]
    failed = [(bus, end) for bus, end in ends if isinstance(end, LinkError)]
    if failed and not table.is_split:
        raise CommandError(f"not stopped, so {CUT}: {failed[0][1]}", ExitCode.NO_DEVICE)
    missing = missing_cells(
        [HeardCells(bus, end.cells, end.neighbours) for bus, end in stopped],
        arguments.cells,
    )
    if arguments.json:
        figures = {bus.name: asdict(end.report) for bus, end in stopped}
        errors = {bus.name: str(error) for bus, error in failed}
        split = {"buses": figures, "not_stopped": errors}
        told = split if table.is_split else figures[table.buses[0].name]
        print(json.dumps({**told, **figures_of(missing)}))
    heard = any(end.cells or end.report.not_off for _, end in stopped)
    if not heard and not failed:
        raise CommandError(f"nobody knows what is off, so {CUT}: {NO_NODES}", ExitCode.NO_DEVICE)
    texts = [
        not_off_text(end.report, bus.name if table.is_split else "")
        for bus, end in stopped
        if end.report.not_off
    ]
    if heard and not texts and not arguments.json:
        cells = sum(len(end.cells) for _, end in stopped)
        buses = sum(bool(end.cells) for _, end in stopped)
        print(f"{counted(cells, 'cell is', 'cells are')} off{_over(table, buses)}")
    if failed:
        names = ", ".join(f"{bus.name} ({error})" for bus, error in failed)
        texts.insert(0, f"not stopped: {names}; {CUT}")
    if texts:
        raise CommandError("; ".join(texts), ExitCode.NO_DEVICE if failed else ExitCode.NODE_FAULT)
    refuse_missing(table.is_split, missing, f"nobody knows whether they are off; {CUT}")
    return ExitCode.OK


@dataclass(frozen=True, slots=True)
class _Stopped:
    """A bus on which all was turned off, its cells, and the neighbours that each has stored."""

    report: StopReport
    cells: frozenset[int]
    neighbours: Mapping[int, Sequence[int]]


def _begin_to_stop(bus: TableBus) -> "Future[_Stopped | LinkError]":
    """Stop a bus in a thread that keeps no command from its end: drivers may hang for ever."""
    end: Future[_Stopped | LinkError] = Future()

    def stop_bus() -> None:
        try:
            end.set_result(_stop_bus(bus))
        except Exception as error:
            end.set_exception(error)

    Thread(target=stop_bus, daemon=True).start()
    return end


def _stuck() -> LinkError:
    return LinkError(f"its adapter holds the stop up, for {STUCK_S:g} s so far; plug it in again")


def _stop_bus(bus: TableBus) -> _Stopped | LinkError:
    """Turn everything off on a bus, and ask its cells for their neighbours.

    Returns the error if the link fails.
    """
    try:
        with open_links(bus.options) as (link, clock):
            report, model = stop_all(link, clock), StatusModel()
            if report.heard:
                end_s = clock.now_s() + ASK_S
                drive(model, link, clock, lambda: clock.now_s() >= end_s)
    except LinkError as error:
        return error
    return _Stopped(report, frozenset(report.heard) - model.strangers, model.neighbours)


def _tell_updates(models: Iterable[StatusModel]) -> None:
    if any(model.update_ran for model in models):
        say(f"mdms: {UPDATE_RUNS}, so they were not asked")


def _over(table: TableBuses, stopped: int) -> str:
    if not table.is_split:
        return ""
    buses = len(table.buses)
    return f" on {buses} buses" if stopped == buses else f" on {stopped} of {buses} buses"


def _missing_of(
    table: TableBuses, models: Sequence[StatusModel], cells: int | None
) -> list[MissingCells]:
    return missing_cells(
        [
            HeardCells(bus, model.cells, model.neighbours)
            for bus, model in zip(table.buses, models, strict=True)
        ],
        cells,
    )


def _refuse_faulty(rows: Sequence[CellStatus]) -> None:
    """Raise `CommandError` where a cell is in fault, or has fallen silent."""
    reasons = {
        "in fault": [row for row in rows if row.in_fault],
        "silent": [row for row in rows if row.silent],
    }
    texts = [f"{what}: {_nodes(some)}" for what, some in reasons.items() if some]
    if texts:
        raise CommandError(f"{'; '.join(texts)}; mdms doctor names the cure", ExitCode.NODE_FAULT)


def _nodes(rows: Sequence[CellStatus]) -> str:
    by_bus: dict[str | None, list[int]] = {}
    for row in rows:
        by_bus.setdefault(row.bus, []).append(row.node_id)
    return ", ".join(
        f"{f'{bus}, ' if bus else ''}node {ranges(node_ids)}" for bus, node_ids in by_bus.items()
    )


def _rows(table: TableBuses, models: Sequence[StatusModel], now_s: float) -> list[CellStatus]:
    return [
        replace(row, bus=bus.name if table.is_split else None)
        for bus, model in zip(table.buses, models, strict=True)
        for row in model.rows(now_s)
    ]


def _row(row: CellStatus, *, split: bool) -> dict[str, object]:
    figures = asdict(row) | {"silent": row.silent}
    if not split:
        del figures["bus"]
    return figures


def _show_link(link: AnyLink) -> None:
    """Incidents of the link besides frames, on stderr."""
    for time_s, text in link.incidents:
        say(f"{time_s:8.3f} s  {text}")
    if counts := str(link.counts):
        say(f"frames: {counts}")


def _show_live(
    table: TableBuses, models: Sequence[StatusModel], link: AnyLink, clock: Clock
) -> None:
    """Redraw the table until somebody presses Ctrl-C."""
    due_s = clock.now_s()
    with Live(auto_refresh=False) as live:

        def redraw() -> bool:
            nonlocal due_s
            if clock.now_s() >= due_s:
                due_s += REDRAW_S
                drawn = status_table(_rows(table, models, clock.now_s()), dots())
                drawn.caption = str(link.counts)
                live.update(drawn, refresh=True)
            return False

        try:
            drive(OnEachBus(models), link, clock, redraw)
        except KeyboardInterrupt:
            return
