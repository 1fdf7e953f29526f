"""The live page of a verb, and `mdms replay --page`.

The latter plays a run folder at any speed and from any time.
"""

import webbrowser
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from mdms_array.host import layout_of, parcels_of
from mdms_host.cli.exits import ExitCode, interrupted
from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.page.commands import ShownTable
from mdms_host.page.description import things_of
from mdms_host.page.flow import ends_of
from mdms_host.page.page import Page
from mdms_host.page.recorded import RecordedTable
from mdms_host.page.server import LOOPBACK
from mdms_model.array import build_cells
from mdms_model.run.folder import StoredRun, read_run
from mdms_model.scenario.belief import believed


@contextmanager
def opened_page(table: ShownTable, arguments: Namespace) -> Iterator[Page]:
    """The page of a table as `--page`, `--host` and `--open` have it. Raises `PageError`."""
    host = arguments.host or LOOPBACK
    with Page(table, MonotonicClock(), arguments.page, host) as page:
        if not page.gate.is_loopback:
            say(
                f"mdms: the page is open to whoever reaches {host}: all may watch and "
                "stop, and whoever reads its address moves the table; it is not encrypted"
            )
        print(page.address, flush=True)
        if arguments.open:
            webbrowser.open(page.address)
        yield page


_WAIT_S = 0.004


def show_recorded(arguments: Namespace) -> ExitCode:
    """Play a run in its page until Ctrl-C. Raises RunFolderError, PageError."""
    table, clock = table_of(read_run(arguments.folder)), MonotonicClock()
    with opened_page(table, arguments) as page, interrupted() as over:
        while not over():
            table.advance(clock.now_s())
            page.attend()
            clock.sleep(_WAIT_S)
    return ExitCode.OK


def table_of(run: StoredRun) -> RecordedTable:
    """The run as a page shows it."""
    told = believed(run.scenario)
    # Of a table whose cells differ, the page has room for the wheels of each.
    fullest = max(build_cells(run.scenario), key=lambda cell: len(cell.wheel))
    layout = layout_of(replace(told, cell=replace(told.cell, wheel=fullest.wheel)))
    if node_ids := run.figures.get("node_ids"):
        layout = replace(layout, node_ids=tuple(node_ids))
    # Those that the host was not told of were there too.
    named = {parcel.name: parcel for parcel in (*parcels_of(run.scenario), *parcels_of(told))}
    parcels = tuple(named.values())
    return RecordedTable(run, layout, things_of(parcels, None), ends_of(told, parcels))
