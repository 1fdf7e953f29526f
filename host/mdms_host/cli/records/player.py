"""`mdms replay --page`: a run folder in a page, played at any speed and from any time."""

from argparse import Namespace
from dataclasses import replace

from mdms_array.host import layout_of, parcels_of
from mdms_host.cli.exits import Exit
from mdms_host.cli.paging import opened_page
from mdms_host.cli.signals import interrupted
from mdms_host.clock import MonotonicClock
from mdms_host.page.description import things_of
from mdms_host.page.recorded import RecordedTable
from mdms_model.run.folder import StoredRun, read_run
from mdms_model.scenario.belief import believed

_WAIT_S = 0.004


def show(arguments: Namespace) -> Exit:
    """Play a run in its page until Ctrl-C. Raises RunFolderError, PageError."""
    table, clock = table_of(read_run(arguments.folder)), MonotonicClock()
    with opened_page(table, arguments) as page, interrupted() as over:
        while not over():
            table.advance(clock.now_s())
            page.attend()
            clock.sleep(_WAIT_S)
    return Exit.OK


def table_of(run: StoredRun) -> RecordedTable:
    """The run as a page shows it."""
    told = believed(run.scenario)
    layout = layout_of(told)
    if node_ids := run.figures.get("node_ids"):
        layout = replace(layout, node_ids=tuple(node_ids))
    return RecordedTable(run, layout, things_of(parcels_of(told), None))
