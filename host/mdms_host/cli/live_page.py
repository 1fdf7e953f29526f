"""Verbs with a page: it is opened, shows a real array with its coordinator, or plays a run folder.

`mdms run --page` drives the coordinator on a real or served array. `mdms replay --page` plays a run
folder at any speed and from any time.
"""

import webbrowser
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from mdms_array.array import BelievedArray
from mdms_array.checks import timing_of
from mdms_array.connection import open_links
from mdms_array.host import coordinator_of, layout_of, parcels_of, watch_program
from mdms_host.can_link.delays import punctual
from mdms_host.can_link.link import AnyLink, DeviceGoneError, drive
from mdms_host.cli.exits import CommandError, Exit, interrupted
from mdms_host.cli.streams import say
from mdms_host.clock import Clock, MonotonicClock
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.supervision import refuse_other_host
from mdms_host.page.bus_watch import BusWatch
from mdms_host.page.commands import ShownTable
from mdms_host.page.description import things_of
from mdms_host.page.live import LiveTable
from mdms_host.page.page import Page
from mdms_host.page.recorded import RecordedTable
from mdms_host.page.run_slot import RunSlot
from mdms_host.page.server import LOOPBACK
from mdms_host.programs.program import Main
from mdms_host.programs.traffic.planning import ThreadDesk
from mdms_model.run.folder import StoredRun, read_run
from mdms_model.scenario.belief import believed
from mdms_protocol.codecs import nmt


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


def show_array(belief: BelievedArray, arguments: Namespace, main: Main | None = None) -> Exit:
    """Run the program, and again whenever that is asked for, until Ctrl-C or the time limit.

    Raises NoBusError, DeviceGoneError, PageError, OtherHostError, and `CommandError` for a program
    that has ended with a fault.
    """
    with open_links(arguments, belief.channels) as (link, clock):
        refuse_other_host(link, clock)
        slot, table = _slot_and_table(belief, link, clock, main)
        with opened_page(table, arguments) as page, interrupted() as pressed:
            slot.start()
            incidents = 0

            def attended() -> None:
                nonlocal incidents
                for time_s, text in link.incidents[incidents:]:
                    table.note("link", text, time_s, trouble=True)
                incidents = len(link.incidents)
                page.attend()

            def over() -> bool:
                attended()
                late = arguments.limit is not None and clock.now_s() > arguments.limit
                return late or pressed() is not None

            _drive_and_end(slot, link, clock, over, attended)
    if slot.coordinator is not None and slot.coordinator.fault is not None:
        raise CommandError(slot.coordinator.fault, Exit.NODE_FAULT)
    return Exit.OK


def _slot_and_table(
    belief: BelievedArray, link: AnyLink, clock: Clock, main: Main | None
) -> tuple[RunSlot, LiveTable]:
    """The host's place, and what a page shows of it."""

    def make() -> Coordinator:
        coordinator = coordinator_of(belief.scenario, belief.cells, main=main, desk=ThreadDesk())
        watch_program(coordinator, link, clock)
        return coordinator

    layout = layout_of(belief.scenario, belief.cells)
    timing = timing_of(belief.scenario.wire)
    watch = BusWatch(layout, timing.silence_s)
    slot = RunSlot(make, layout.bus_count, watch)
    table = LiveTable(
        belief.scenario.title,
        layout,
        parcels_of(belief.scenario),
        slot=slot,
        watch=watch,
        now_s=clock.now_s,
        error_frames=lambda: link.counts.error_frames,
        report=lambda time_s, text: say(f"{time_s:8.3f} s  {text}"),
    )
    slot.on_cycle = table.on_cycle
    return slot, table


def _drive_and_end(
    slot: RunSlot,
    link: AnyLink,
    clock: Clock,
    over: Callable[[], bool],
    attended: Callable[[], None],
) -> None:
    """Drive the array until it is over, then turn it off in order, whatever ended it."""

    def ended() -> bool:
        attended()
        return not slot.busy

    try:
        with punctual(clock):
            try:
                drive(slot, link, clock, over)
            except DeviceGoneError:
                if link.leave_gone():
                    _stop(slot, link, clock, ended)
                raise
            _stop(slot, link, clock, ended)
    except DeviceGoneError:
        raise
    except BaseException:
        link.send(nmt.command(nmt.ENTER_PRE_OPERATIONAL))
        raise


def _stop(slot: RunSlot, link: AnyLink, clock: Clock, ended: Callable[[], bool]) -> None:
    """Turn the array off in order, on the buses whose devices are there.

    Raises DeviceGoneError after that where one has gone meanwhile.
    """
    if not slot.busy:
        return
    slot.stop()
    gone: DeviceGoneError | None = None
    while slot.busy:
        try:
            drive(slot, link, clock, ended)
        except DeviceGoneError as error:
            gone = gone or error
            if not link.leave_gone():
                raise
    if gone is not None:
        raise gone


_WAIT_S = 0.004


def show_recorded(arguments: Namespace) -> Exit:
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
