"""`mdms status`: how the cells are, live on a terminal."""

import json
import sys
from argparse import Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING

from mdms_host.cli.array.bus import NOBODY, add_bus, open_link
from mdms_host.cli.console import show
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_json

if TYPE_CHECKING:
    from mdms_host.can_link.link import Link
    from mdms_host.clock import Clock
    from mdms_host.commissioning.status import StatusModel

#: Ten heartbeats at their default period.
LISTEN_S = 1.0
REDRAW_S = 0.2


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("status", help="show how the cells are", late=add_bus)
    parser.add_argument("--once", action="store_true", help="once, even on a terminal")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Listen and show; on a terminal until Ctrl-C, else once."""
    from mdms_host.can_link.link import drive
    from mdms_host.commissioning.status import StatusModel, status_table

    model = StatusModel()
    with open_link(arguments) as (link, clock):
        end_s = clock.now_s() + LISTEN_S
        drive(model, link, clock, lambda: clock.now_s() >= end_s)
        rows = model.rows(clock.now_s())
        if arguments.json:
            print(json.dumps({"cells": [asdict(row) | {"silent": row.silent} for row in rows]}))
        elif rows and sys.stdout.isatty() and not arguments.once:
            _show_live(model, link, clock)
        elif rows:
            show(status_table(rows))
    if not rows:
        raise CommandError(NOBODY, Exit.NO_DEVICE)
    return Exit.OK


def _show_live(model: "StatusModel", link: "Link", clock: "Clock") -> None:
    """Redraw the table until somebody presses Ctrl-C."""
    from rich.live import Live

    from mdms_host.can_link.link import drive
    from mdms_host.commissioning.status import status_table

    due_s = clock.now_s()
    with Live(auto_refresh=False) as live:

        def redraw() -> bool:
            nonlocal due_s
            if clock.now_s() >= due_s:
                due_s += REDRAW_S
                live.update(status_table(model.rows(clock.now_s())), refresh=True)
            return False

        try:
            drive(model, link, clock, redraw)
        except KeyboardInterrupt:
            return
