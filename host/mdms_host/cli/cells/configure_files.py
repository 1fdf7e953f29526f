"""`mdms configure dump` and `load`: settings to a file, and back to cells by serial numbers."""

import json
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from mdms_host.cli.cell_options import nodes_of
from mdms_host.cli.cells.configure_cells import (
    BusCells,
    agreed,
    found_cells,
    open_table,
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
from mdms_host.commissioning.cell_settings import Change, identify_cells, read_settings
from mdms_host.commissioning.network import CommissioningError, counted, ranges
from mdms_host.commissioning.parameters import PARAMETERS

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
    """Show what differs, and write it when that is agreed; nothing before all buses are read."""
    options = Namespace(**vars(arguments) | {"array": arguments.file})
    with open_table(options) as found:
        changes = [_differences(arguments, each) for each in found]
        for each, some in zip(found, changes, strict=True):
            _load(arguments, each, some)
    refuse_failed(found, "the others have the settings of the file")
    return ExitCode.OK


def _differences(arguments: Namespace, found: BusCells) -> list[Change]:
    """Read the cells of one bus, and show where they differ from the file."""
    entries = _read(found, _filed(arguments, found.bus.number))
    changes = [
        change
        for cell, entry in zip(found.cells, entries, strict=True)
        for change in cell.changes(entry.values)
    ]
    check_margins(arguments.scenario, found.cells, [entry.values for entry in entries])
    show_changes(changes, found.where)
    return changes


def _load(arguments: Namespace, found: BusCells, changes: Sequence[Change]) -> None:
    """Write what differs on one bus."""
    where = found.where
    if arguments.dry_run or not (changes or arguments.save):
        print(f"{where}{counted(len(changes), 'setting differs', 'settings differ')}")
        return
    refuse_other_host(found.commissioning)
    if not agreed(arguments, f"{where}Write {counted(len(changes), 'setting')}?"):
        raise CommandError(f"{where}nothing was written", ExitCode.FAILURE)
    write_cells(found, changes, save=arguments.save)
    done = [change for change in changes if change.node_id not in found.failed]
    stored = f"; stored on node {ranges(found.node_ids)}" if arguments.save else ""
    print(f"{where}{counted(len(done), 'setting')} written and verified{stored}")


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
