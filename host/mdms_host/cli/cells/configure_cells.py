"""Shared parts of the actions of `mdms configure`: cells on the bus, consent, changes in words."""

import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from mdms_host.can_link.link import open_bus
from mdms_host.cli.array.table import named_table, refuse_missing
from mdms_host.cli.cell_options import nodes_of
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.options import NO_NODES
from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.cell_settings import (
    CellSettings,
    Change,
    StrangerError,
    apply_changes,
    read_settings,
)
from mdms_host.commissioning.network import Commissioning, CommissioningError, ranges
from mdms_host.commissioning.parameters import Parameter
from mdms_host.commissioning.status import NEIGHBOURS
from mdms_host.commissioning.table_cells import HeardCells, TableBus, missing_cells
from mdms_host.coordination.other_host import OtherHostError
from mdms_host.coordination.supervision import OTHER_HOST

BLANK = "no cell has a node id yet, but blank ones are there: mdms configure assign"


def open_commissioning(arguments: Namespace) -> Commissioning:
    """The cells on the bus that the options name. Raises NoBusError."""
    return Commissioning(open_bus(arguments), MonotonicClock())


@dataclass(slots=True)
class BusCells:
    """One bus of a table, the cells that could be read, and the errors of all that failed."""

    bus: TableBus
    commissioning: Commissioning
    where: str
    cells: list[CellSettings] = field(default_factory=list)
    failed: dict[int, CommissioningError] = field(default_factory=dict)

    @property
    def node_ids(self) -> list[int]:
        """The cells that have not failed so far."""
        return [cell.node_id for cell in self.cells if cell.node_id not in self.failed]

    def fail(self, node_id: int, error: CommissioningError) -> None:
        """Say why a cell failed; the command goes on with the others."""
        say(f"mdms: {self.where}{error}")
        self.failed[node_id] = error


@contextmanager
def open_table(arguments: Namespace) -> Iterator[list[BusCells]]:
    """Each bus of the table that the options name, without its cells; closed at the end.

    Raises NoBusError, ArrayFileError.
    """
    buses = named_table(arguments).buses
    with ExitStack() as opened:
        yield [
            BusCells(
                bus,
                opened.enter_context(open_commissioning(bus.options)),
                f"{bus.name}: " if len(buses) > 1 else "",
            )
            for bus in buses
        ]


@contextmanager
def found_cells(
    arguments: Namespace, parameters: Sequence[Parameter] = (), *, to_write: bool = False
) -> Iterator[list[BusCells]]:
    """The table as `open_table` opens it, with the cells of each bus.

    Raises what `read_cells` raises. If no cell of a bus can be read, raises the error of the first.
    """
    with open_table(arguments) as found:
        for each in found:
            each.cells += read_cells(
                each.commissioning, arguments, parameters, each.fail, to_write=to_write
            )
            if not each.cells:
                for error in each.failed.values():
                    raise error
                raise CommandError("there is no MDMS cell on the bus", ExitCode.NODE_FAULT)
        yield found


def refuse_absent(
    arguments: Namespace,
    found: Sequence[BusCells],
    consequence: str = "mdms doctor names the cure",
) -> None:
    """Raise `CommandError` where cells have failed, or cells of the table are missing.

    With `--node` no other cell is missing.
    """
    if nodes_of(arguments.nodes) is None:
        heard = [
            HeardCells(
                each.bus,
                frozenset((*each.failed, *each.node_ids)),
                {
                    cell.node_id: [
                        number
                        for parameter, number in cell.values.items()
                        if parameter.place in NEIGHBOURS
                    ]
                    for cell in each.cells
                },
            )
            for each in found
        ]
        refuse_missing(len(found) > 1, missing_cells(heard, arguments.cells), consequence)
    refuse_failed(found, consequence)


def refuse_failed(found: Iterable[BusCells], consequence: str) -> None:
    """Raise `CommandError` where cells have failed."""
    failed = [f"{each.where}node {ranges(each.failed)}" for each in found if each.failed]
    if failed:
        raise CommandError(f"failed: {', '.join(failed)}; {consequence}", ExitCode.NODE_FAULT)


def read_cells(
    commissioning: Commissioning,
    arguments: Namespace,
    parameters: Sequence[Parameter],
    fail: Callable[[int, CommissioningError], object],
    *,
    to_write: bool = False,
) -> list[CellSettings]:
    """The cells that `--node` names, and their settings. Raises `CommandError` for absent ones.

    Without `--node`, nodes that are no cells are left alone. `fail` is called for a cell that
    cannot be read. Where they are read `to_write` them, raises OtherHostError beside another host.
    """
    wanted = nodes_of(arguments.nodes)
    node_ids = present_nodes(commissioning, wanted)
    if to_write:
        refuse_other_host(commissioning)
    cells = []
    with progress("reading") as share:
        for done, node_id in enumerate(node_ids, 1):
            try:
                cells.append(read_settings(commissioning, node_id, parameters))
            except StrangerError as error:
                if wanted is not None:
                    raise
                say(f"mdms: {error}; left alone")
            except CommissioningError as error:
                fail(node_id, error)
            share(done / len(node_ids))
    return cells


def refuse_other_host(commissioning: Commissioning) -> None:
    """Raises OtherHostError where another host was heard: it has set the cells up for its run."""
    if commissioning.other_host:
        raise OtherHostError(OTHER_HOST)


def write_cells(found: BusCells, changes: Sequence[Change], *, save: bool) -> None:
    """Write, read back, and store if that is wanted; a cell that fails keeps no other from it.

    One that restarts meanwhile has failed. Raises OtherHostError beside another host, with nothing
    written.
    """
    commissioning = found.commissioning
    refuse_other_host(commissioning)
    node_ids = found.node_ids
    for node_id in node_ids:
        commissioning.expect_boot(node_id)
    with progress("writing") as share:
        for done, node_id in enumerate(node_ids, 1):
            own = [change for change in changes if change.node_id == node_id]
            try:
                apply_changes(commissioning, own)
            except CommissioningError as error:
                found.fail(node_id, error)
                say(f"mdms: some settings of node {node_id} may be written; give them again")
            share(done / len(node_ids))
    for node_id in found.node_ids if save else ():
        try:
            commissioning.store(node_id)
        except CommissioningError as error:
            found.fail(node_id, error)
            say(f"mdms: the settings are written, but not stored on node {node_id}")
    for node_id in node_ids:
        try:
            commissioning.refuse_booted(node_id)
        except CommissioningError as error:
            found.fail(node_id, error)


def of_buses(figures: Mapping[str, dict[str, object]]) -> dict[str, object]:
    """Figures of each bus by its name; those of the only one as they are."""
    return next(iter(figures.values())) if len(figures) == 1 else {"buses": dict(figures)}


def show_changes(changes: Iterable[Change], where: str = "") -> None:
    """One line for each change that cells have in common, behind `where` they are."""
    grouped: dict[tuple[Parameter, int, int], list[int]] = {}
    for change in changes:
        key = (change.parameter, change.before, change.after)
        grouped.setdefault(key, []).append(change.node_id)
    for (parameter, before, after), node_ids in grouped.items():
        was, now = parameter.text(before, unit=False), parameter.text(after)
        print(f"{where}{parameter.name}: {was} -> {now}  (node {ranges(node_ids)})", flush=True)


def agreed(arguments: Namespace, question: str) -> bool:
    """Whether to go on: `--yes`, or the answer on a terminal. Raises `CommandError` without one."""
    if arguments.yes:
        return True
    if not sys.stdin.isatty():
        raise CommandError("nobody can be asked here; say --yes, or --dry-run", ExitCode.USAGE)
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def present_nodes(commissioning: Commissioning, wanted: list[int] | None) -> list[int]:
    """Those wanted, None for all that answer. Raises `CommandError` for absent ones, or none."""
    found = commissioning.find()
    if wanted is None:
        if not found:
            blank = commissioning.lss.any_blank()
            raise CommandError(BLANK if blank else NO_NODES, ExitCode.NO_DEVICE)
        return found
    absent = sorted(set(wanted) - set(found))
    if absent:
        there = f"on the bus: {ranges(found)}" if found else NO_NODES
        raise CommandError(f"node {ranges(absent)} does not answer; {there}", ExitCode.NO_DEVICE)
    return wanted
