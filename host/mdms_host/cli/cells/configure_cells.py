"""Shared parts of the actions of `mdms configure`: cells on the bus, consent, changes in words."""

import sys
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

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


@contextmanager
def open_table(arguments: Namespace) -> Iterator[list[tuple[TableBus, Commissioning]]]:
    """Each bus of the table that the options name, open, with its cells; closed at the end.

    Raises NoBusError, ArrayFileError, `CommandError`.
    """
    with ExitStack() as opened:
        yield [
            (bus, opened.enter_context(open_commissioning(bus.options)))
            for bus in named_table(arguments).buses
        ]


def refuse_absent(
    arguments: Namespace,
    cells: Sequence[tuple[TableBus, Sequence[CellSettings]]],
    consequence: str = "mdms doctor names the cure",
) -> None:
    """Raise `CommandError` where cells of the table are missing; those of `--node` are named."""
    if nodes_of(arguments.nodes) is not None:
        return
    heard = [
        HeardCells(
            bus,
            frozenset(cell.node_id for cell in some),
            {
                cell.node_id: [
                    number for each, number in cell.values.items() if each.place in NEIGHBOURS
                ]
                for cell in some
            },
        )
        for bus, some in cells
    ]
    refuse_missing(len(cells) > 1, missing_cells(heard, arguments.cells), consequence)


def read_cells(
    commissioning: Commissioning,
    arguments: Namespace,
    parameters: Sequence[Parameter] = (),
    *,
    to_write: bool = False,
) -> list[CellSettings]:
    """The cells that `--node` names, and their settings. Raises `CommandError` for absent ones.

    Without `--node`, nodes that are no cells are left alone. Where they are read `to_write` them,
    raises OtherHostError beside another host.
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
            share(done / len(node_ids))
    if not cells:
        raise CommandError("there is no MDMS cell on the bus", ExitCode.NODE_FAULT)
    return cells


def refuse_other_host(commissioning: Commissioning) -> None:
    """Raises OtherHostError where another host was heard: it has set the cells up for its run."""
    if commissioning.other_host:
        raise OtherHostError(OTHER_HOST)


def write_cells(
    commissioning: Commissioning,
    changes: Sequence[Change],
    node_ids: Sequence[int],
    *,
    save: bool,
) -> None:
    """Write, read back, and store if that is wanted; an error is preceded by how far it got.

    Raises OtherHostError beside another host, with nothing written, and CommissioningError where a
    cell restarts meanwhile.
    """
    refuse_other_host(commissioning)
    for node_id in node_ids:
        commissioning.expect_boot(node_id)
    done = 0.0

    with progress("writing") as share:

        def note(part: float) -> None:
            nonlocal done
            done = part
            share(part)

        try:
            apply_changes(commissioning, changes, note)
        except CommissioningError:
            say(f"mdms: {round(done * len(changes))} of {len(changes)} settings were written")
            raise
    if save:
        _store(commissioning, node_ids)
    commissioning.refuse_booted(node_ids)


def _store(commissioning: Commissioning, node_ids: Iterable[int]) -> None:
    """Have all cells store their settings; one that fails keeps no other from it.

    Raises the error of the first that fails, when those that have not stored them were named.
    """
    failed: dict[int, CommissioningError] = {}
    for node_id in node_ids:
        try:
            commissioning.store(node_id)
        except CommissioningError as error:
            failed[node_id] = error
    if failed:
        say(f"mdms: the settings are written, but not stored on node {ranges(failed)}")
        raise next(iter(failed.values()))


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
