"""`mdms configure dump` and `load`: settings to a file, and back to cells by serial numbers."""

import json
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from mdms_host.cli.array.table import named_table
from mdms_host.cli.cell_options import nodes_of
from mdms_host.cli.cells.configure_cells import (
    BusCells,
    agreed,
    found_cells,
    open_commissioning,
    refuse_absent,
    refuse_failed,
    refuse_other_host,
    show_changes,
    write_cells,
)
from mdms_host.cli.cells.configure_settings import check_margins, to_read
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.files import replacing
from mdms_host.cli.options import NO_NODES
from mdms_host.cli.streams import say
from mdms_host.commissioning.array_file import FiledCell, array_text, placed_cells, read_array
from mdms_host.commissioning.cell_settings import identify_cells, read_settings
from mdms_host.commissioning.network import CommissioningError, counted, ranges
from mdms_host.commissioning.parameters import PARAMETERS
from mdms_host.commissioning.table_cells import TableBus

STDOUT = Path("-")


def dump(arguments: Namespace) -> ExitCode:
    """Read all settings and write the file, whole or not at all."""
    with found_cells(arguments, PARAMETERS) as found:
        pass
    refuse_absent(arguments, found, "nothing was written; --node names the others")
    cells = [cell for each in found for cell in each.cells]
    text = array_text({each.bus.name: each.cells for each in found})
    if arguments.file == STDOUT:
        print(text, end="")
        return ExitCode.OK
    # The first line names the writer of the file.
    mark = text.partition("\n")[0].encode()
    with replacing(arguments.file, mark, arguments.force) as partial:
        partial.write_text(text, encoding="utf-8")
    if arguments.json:
        print(json.dumps({"file": str(arguments.file), "cells": len(cells)}))
    else:
        print(f"{counted(len(cells), 'cell')}, {len(PARAMETERS)} settings each: {arguments.file}")
    return ExitCode.OK


def load(arguments: Namespace) -> ExitCode:
    """Show what differs, and write it when that is agreed."""
    options = Namespace(**vars(arguments) | {"array": arguments.file})
    buses = named_table(options).buses
    found = [_load(arguments, bus, f"{bus.name}: " if len(buses) > 1 else "") for bus in buses]
    refuse_failed(found, "the others have the settings of the file")
    return ExitCode.OK


def _load(arguments: Namespace, bus: TableBus, where: str) -> BusCells:
    """The same for the cells of one bus."""
    filed = _filed(arguments, bus.number)
    with open_commissioning(bus.options) as commissioning:
        found = BusCells(bus, commissioning, where)
        entries = _read(found, filed)
        changes = [
            change
            for cell, entry in zip(found.cells, entries, strict=True)
            for change in cell.changes(entry.values)
        ]
        check_margins(arguments.scenario, found.cells, [entry.values for entry in entries])
        show_changes(changes, where)
        if arguments.dry_run or not (changes or arguments.save):
            print(f"{where}{counted(len(changes), 'setting differs', 'settings differ')}")
            return found
        refuse_other_host(commissioning)
        if not agreed(arguments, f"{where}Write {counted(len(changes), 'setting')}?"):
            raise CommandError("nothing was written", ExitCode.FAILURE)
        write_cells(found, changes, save=arguments.save)
    done = [change for change in changes if change.node_id not in found.failed]
    stored = f"; stored on node {ranges(found.node_ids)}" if arguments.save else ""
    print(f"{where}{counted(len(done), 'setting')} written and verified{stored}")
    return found


def _filed(arguments: Namespace, bus: int) -> Sequence[FiledCell]:
    """The cells of the file on a bus, or those of them that `--node` names."""
    filed = placed_cells(read_array(arguments.file), bus=bus)
    wanted = nodes_of(arguments.nodes)
    if wanted is None:
        return filed
    absent = set(wanted) - {cell.node_id for cell in filed}
    if absent:
        raise CommandError(f"{arguments.file} has no node {ranges(absent)}", ExitCode.USAGE)
    return [cell for cell in filed if cell.node_id in wanted]


def _read(found: BusCells, filed: Sequence[FiledCell]) -> list[FiledCell]:
    """Read the cells with the serial numbers of the file, whatever their node ids are now.

    Returns the entries of those that could be read.
    """
    node_ids = found.commissioning.find()
    if not node_ids:
        raise CommandError(NO_NODES, ExitCode.NO_DEVICE)
    cells = identify_cells(found.commissioning, node_ids)
    nodes = {identity.serial: node_id for node_id, identity in cells.items()}
    absent = [cell for cell in filed if cell.serial not in nodes]
    if absent:
        names = ", ".join(f"{cell.serial:08X} (node {cell.node_id})" for cell in absent)
        raise CommandError(
            f"not on the bus: {names}; nothing was written, --node names the others",
            ExitCode.NO_DEVICE,
        )
    entries = []
    with progress("reading") as share:
        for done, entry in enumerate(filed, 1):
            node_id = nodes[entry.serial]
            if node_id != entry.node_id:
                say(f"mdms: {entry.serial:08X} was node {entry.node_id}, and is node {node_id} now")
            try:
                cell = read_settings(found.commissioning, node_id, to_read(entry.values))
            except CommissioningError as error:
                found.fail(node_id, error)
            else:
                found.cells.append(cell)
                entries.append(entry)
            share(done / len(filed))
    return entries
