"""`mdms configure assign`: cells get their node ids by LSS, and keep them."""

import json
from argparse import Namespace
from pathlib import Path

from mdms_host.cli.cells.configure_cells import open_commissioning, refuse_other_host
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.options import NO_NODES
from mdms_host.cli.streams import say
from mdms_host.commissioning.array_file import filed_cells
from mdms_host.commissioning.cell_settings import identify_cells
from mdms_host.commissioning.network import Commissioning, counted
from mdms_host.commissioning.node_ids import (
    Assignment,
    NodeIdError,
    assign_by_serial,
    assign_in_order,
    carry_out,
    find_blank,
    refuse_hidden,
    refuse_host_node,
)


def run(arguments: Namespace) -> ExitCode:
    """Find blank cells, print which gets which node id, and give it."""
    wanted = None if arguments.file is None else _node_ids(arguments)
    if wanted is not None:
        _refuse_host_node(wanted, arguments.file)
    with open_commissioning(arguments) as commissioning:
        moves = _plan(commissioning, wanted, arguments.first)
        passing: list[Assignment] = []
        if arguments.dry_run:
            for move in moves:
                _report(move, arguments)
        else:
            refuse_other_host(commissioning)
            passing = carry_out(commissioning, moves, lambda move: _report(move, arguments))
    if passing:
        nodes = ", ".join(str(move.node_id) for move in passing)
        say(f"node {nodes} has no memory for settings, and is blank after a loss of power")
    if arguments.json:
        print(json.dumps({"cells": [_row(move, move not in passing) for move in moves]}))
    elif not moves:
        print("no cell needs a node id")
    elif not arguments.dry_run:
        keep = "keeps it" if len(moves) == 1 else "keep them"
        if passing:
            keep = f"{len(moves) - len(passing)} of them keep it"
        got = counted(len(moves), "cell has got its node id", "cells have got their node ids")
        print(f"{got}, and {keep}")
    return ExitCode.OK


def _node_ids(arguments: Namespace) -> dict[int, int]:
    """Node ids of a file by serial number. Raises ArrayFileError."""
    channel = getattr(arguments, "channel", None)
    return {cell.serial: cell.node_id for cell in filed_cells(arguments.file, channel)}


def _refuse_host_node(wanted: dict[int, int], file: Path) -> None:
    try:
        refuse_host_node(wanted)
    except NodeIdError as error:
        raise CommandError(f"{file}: {error}", ExitCode.USAGE) from None


def _plan(
    commissioning: Commissioning, wanted: dict[int, int] | None, first: int
) -> list[Assignment]:
    found = commissioning.find()
    blank = find_blank(commissioning, found)
    if not found and not blank:
        raise CommandError(NO_NODES, ExitCode.NO_DEVICE)
    if wanted is None:
        refuse_hidden(commissioning, blank, identify_cells(commissioning, found))
        return assign_in_order(blank, found, first)
    return assign_by_serial(wanted, blank, identify_cells(commissioning, found), found)


def _report(move: Assignment, arguments: Namespace) -> None:
    if not arguments.json:
        was = "blank" if move.before is None else f"node {move.before}"
        print(f"{move.address.serial:08X}: {was} -> node {move.node_id}", flush=True)


def _row(move: Assignment, stored: bool) -> dict[str, object]:
    return {
        "serial": f"{move.address.serial:08X}",
        "before": move.before,
        "node": move.node_id,
        "stored": stored,
    }
