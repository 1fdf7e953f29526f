"""`mdms scan`, `mdms status` and `mdms stop`:

participants on the bus, the state of each, and everything off.
"""

import json
import sys
from argparse import Namespace
from dataclasses import asdict

from rich.live import Live

from mdms_array.checks import warn_of_load, wire_of
from mdms_array.connection import open_link
from mdms_host.can_link.link import Link, drive, open_bus
from mdms_host.cli.console import dots, show
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import NO_NODES
from mdms_host.cli.streams import say
from mdms_host.clock import Clock, MonotonicClock
from mdms_host.commissioning.status import StatusModel, scan_bus, scan_table, status_table
from mdms_host.commissioning.stop import not_off_text, stop_all

#: Ten heartbeats at their default period.
LISTEN_S = 1.0
REDRAW_S = 0.2


def scan(arguments: Namespace) -> Exit:
    """Read the identity of every node, and print them."""
    nodes = scan_bus(open_bus(arguments), MonotonicClock())
    if arguments.json:
        print(json.dumps({"nodes": [asdict(node) for node in nodes]}))
    elif nodes:
        show(scan_table(nodes))
    if not nodes:
        raise CommandError(NO_NODES, Exit.NO_DEVICE)
    warn_of_load(sum(node.is_cell for node in nodes), wire_of(arguments))
    return Exit.OK


def status(arguments: Namespace) -> Exit:
    """Listen and show; on a terminal until Ctrl-C, else once."""
    model = StatusModel()
    with open_link(arguments) as (link, clock):
        end_s = clock.now_s() + LISTEN_S
        drive(model, link, clock, lambda: clock.now_s() >= end_s)
        rows = model.rows(clock.now_s())
        if arguments.json:
            cells = [asdict(row) | {"silent": row.silent} for row in rows]
            print(json.dumps({"cells": cells, "link": asdict(link.counts)}))
        elif rows and sys.stdout.isatty() and not arguments.once:
            _show_live(model, link, clock)
        elif rows:
            show(status_table(rows, dots()))
        if not arguments.json:
            _show_link(link)
    if not rows:
        raise CommandError(NO_NODES, Exit.NO_DEVICE)
    warn_of_load(len(rows), wire_of(arguments))
    return Exit.OK


def stop(arguments: Namespace) -> Exit:
    """Turn everything off and report which cells have confirmed it."""
    with open_link(arguments) as (link, clock):
        report = stop_all(link, clock)
    if arguments.json:
        print(json.dumps(asdict(report)))
    if not report.heard:
        raise CommandError(NO_NODES, Exit.NO_DEVICE)
    if report.not_off:
        raise CommandError(not_off_text(report), Exit.NODE_FAULT)
    if not arguments.json:
        print(f"{len(report.heard)} cells are off")
    return Exit.OK


def _show_link(link: Link) -> None:
    """Incidents of the link besides frames, on stderr."""
    for time_s, text in link.incidents:
        say(f"{time_s:8.3f} s  {text}")
    if counts := str(link.counts):
        say(f"frames: {counts}")


def _show_live(model: StatusModel, link: Link, clock: Clock) -> None:
    """Redraw the table until somebody presses Ctrl-C."""
    due_s = clock.now_s()
    with Live(auto_refresh=False) as live:

        def redraw() -> bool:
            nonlocal due_s
            if clock.now_s() >= due_s:
                due_s += REDRAW_S
                table = status_table(model.rows(clock.now_s()), dots())
                table.caption = str(link.counts)
                live.update(table, refresh=True)
            return False

        try:
            drive(model, link, clock, redraw)
        except KeyboardInterrupt:
            return
