"""`mdms scan`, `mdms status` and `mdms stop`: the nodes of a table, their states, everything off.

They take a whole table: by its array file, or by the name of a served one. Missing cells are named,
and the exit code is 5 then.
"""

import json
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, replace

from rich.live import Live

from mdms_array.checks import warn_of_load, wire_of
from mdms_array.connection import open_links
from mdms_host.can_link.link import AnyLink, drive, open_bus
from mdms_host.can_link.links import OnEachBus
from mdms_host.cli.array.table import figures_of, named_table, refuse_missing
from mdms_host.cli.console import dots, show
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import NO_NODES
from mdms_host.cli.streams import say
from mdms_host.clock import Clock, MonotonicClock
from mdms_host.commissioning.network import ranges
from mdms_host.commissioning.status import (
    CellStatus,
    FoundNode,
    StatusModel,
    scan_bus,
    scan_table,
    status_table,
)
from mdms_host.commissioning.stop import not_off_text, stop_buses
from mdms_host.commissioning.table_cells import Heard, Missing, TableBuses, missing_cells

#: Ten heartbeats at their default period.
LISTEN_S = 1.0
#: How long cells are asked, once all is off, who is beside them.
ASK_S = 0.5
REDRAW_S = 0.2


def scan(arguments: Namespace) -> Exit:
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
        raise CommandError(NO_NODES, Exit.NO_DEVICE)
    crowded = max(sum(node.is_cell for node in some) for some in nodes.values())
    warn_of_load(crowded, wire_of(table.options))
    refuse_missing(table.is_split, missing)
    return Exit.OK


def _heard(table: TableBuses, number: int, nodes: Sequence[FoundNode]) -> Heard:
    """The cells among the nodes of a bus; one that cannot be read may be one."""
    there = [node for node in nodes if node.is_cell or node.identity is None]
    return Heard(
        table.buses[number],
        frozenset(node.node_id for node in there),
        {node.node_id: node.neighbours for node in there},
    )


def status(arguments: Namespace) -> Exit:
    """Listen and show; on a terminal until Ctrl-C, else once."""
    table = named_table(arguments)
    models = [StatusModel(asks_neighbours=True) for _ in table.buses]
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
    missing = _missing_of(table, models, arguments.cells)
    if arguments.json:
        cells = [_row(row, split=table.is_split) for row in rows]
        print(json.dumps({"cells": cells, "link": asdict(link.counts), **figures_of(missing)}))
    if not rows:
        raise CommandError(NO_NODES, Exit.NO_DEVICE)
    crowded = max(len(model.rows(0.0)) for model in models)
    warn_of_load(crowded, wire_of(table.options))
    refuse_missing(table.is_split, missing)
    _refuse_faulty(rows)
    return Exit.OK


def stop(arguments: Namespace) -> Exit:
    """Turn everything off and report which cells have confirmed it."""
    table = named_table(arguments)
    with open_links(table.options, table.channels) as (link, clock):
        reports = stop_buses(link, clock, len(table.buses))
        models = [StatusModel(asks_neighbours=True) for _ in table.buses]
        if any(report.heard for report in reports):
            end_s = clock.now_s() + ASK_S
            drive(OnEachBus(models), link, clock, lambda: clock.now_s() >= end_s)
    missing = missing_cells(
        [
            Heard(bus, frozenset(report.heard), model.neighbours)
            for bus, report, model in zip(table.buses, reports, models, strict=True)
        ],
        arguments.cells,
    )
    named = list(zip(table.buses, reports, strict=True))
    if arguments.json:
        figures = {bus.name: asdict(report) for bus, report in named}
        told = {"buses": figures} if table.is_split else figures[table.buses[0].name]
        print(json.dumps({**told, **figures_of(missing)}))
    heard = sum(len(report.heard) for report in reports)
    if not heard:
        raise CommandError(NO_NODES, Exit.NO_DEVICE)
    still = [
        not_off_text(report, bus.name if table.is_split else "")
        for bus, report in named
        if report.not_off
    ]
    if still:
        raise CommandError("; ".join(still), Exit.NODE_FAULT)
    if not arguments.json:
        print(f"{heard} cells are off{_over(table)}")
    refuse_missing(
        table.is_split, missing, "nobody knows whether they are off; cut the motors' power"
    )
    return Exit.OK


def _over(table: TableBuses) -> str:
    return f" on {len(table.buses)} buses" if table.is_split else ""


def _missing_of(
    table: TableBuses, models: Sequence[StatusModel], cells: int | None
) -> list[Missing]:
    return missing_cells(
        [
            Heard(bus, frozenset(row.node_id for row in model.rows(0.0)), model.neighbours)
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
        raise CommandError(f"{'; '.join(texts)}; mdms doctor names the cure", Exit.NODE_FAULT)


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
