"""`mdms flash --bus`: firmware into cells over the CAN bus, without a cable to each."""

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mdms_host.cli.cell_options import add_nodes, nodes_of
from mdms_host.cli.console import bars, progress, show
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.files import replacing
from mdms_host.cli.streams import say

if TYPE_CHECKING:
    from mdms_host.commissioning.network import Commissioning
    from mdms_host.flashing.bundles import Bundle
    from mdms_host.flashing.candidates import Candidate
    from mdms_host.flashing.updater import Updater

BITRATE = 1_000_000
KEY = Path("array.key")


def add_options(parser: ArgumentParser) -> None:
    """Those that `--bus` brings with it."""
    # python-can is costly to import.
    from mdms_host.cli.options import add_bus

    bus = parser.add_argument_group("with --bus")
    bus.add_argument(
        "--array",
        metavar="FILE",
        type=Path,
        help="its buses and its cells; its key lies beside it (FILE.key)",
    )
    bus.add_argument("--key", metavar="FILE", type=Path, help="the array's key")
    bus.add_argument("--bundle", metavar="FILE", type=Path, help="send what --save has written")
    bus.add_argument("--save", metavar="FILE", type=Path, help="keep the bundle")
    bus.add_argument(
        "--allow-older", action="store_true", help="sign that it may replace newer firmware"
    )
    add_nodes(parser)
    add_bus(parser)


def refuse_options(arguments: Namespace) -> None:
    """Raises `CommandError` for options that need `--bus`."""
    for name in ("array", "key", "bundle", "save", "allow_older", "nodes"):
        if getattr(arguments, name):
            option = "--node" if name == "nodes" else f"--{name.replace('_', '-')}"
            raise CommandError(f"{option} goes with --bus", ExitCode.USAGE)


@dataclass(frozen=True, slots=True)
class Row:
    """The result of a cell: the bundle that it is to have, or why it gets none."""

    cell: "Candidate"
    bundle: "Bundle | None" = None
    problem: str | None = None

    @property
    def current(self) -> bool:
        """Whether it runs the bundle already, and stays with it."""
        if self.bundle is None or self.cell.on_trial:
            return False
        return self.bundle.identification == self.cell.identification


def run(arguments: Namespace) -> ExitCode:
    """Ask the cells, sign bundles for them, send, start and confirm; a line for each.

    The buses of a table are served one after another. Raises `CommandError` for missing cells.
    """
    from mdms_host.cli.array.table import figures_of, named_table, refuse_missing
    from mdms_host.commissioning.table_cells import HeardCells, missing_cells

    table = named_table(arguments)
    if table.is_split and arguments.save is not None:
        raise CommandError(
            f"--save: bundles are of one bus, and there are {len(table.buses)}: "
            f"{', '.join(table.channels)}; name one of them with -c",
            ExitCode.USAGE,
        )
    found: dict[str, dict[str, Any]] = {}
    heard: list[HeardCells] = []
    for bus in table.buses:
        if table.is_split and not arguments.json:
            print(f"bus {bus.name}:", flush=True)
        figures, present = _flash_one_bus(bus.options)
        found[bus.name] = figures
        heard.append(HeardCells(bus, present, {}))
    missing = [] if arguments.nodes else missing_cells(heard, None)
    if arguments.json:
        told = {"buses": found} if table.is_split else next(iter(found.values()))
        print(json.dumps({**told, **figures_of(missing)}))
    refuse_missing(table.is_split, missing)
    cells = [cell for figures in found.values() for cell in figures["cells"]]
    return ExitCode.NODE_FAULT if any(cell.get("problem") for cell in cells) else ExitCode.OK


def _flash_one_bus(arguments: Namespace) -> "tuple[dict[str, Any], frozenset[int]]":
    """The figures of one bus, and the nodes that are there."""
    from mdms_host.cli.cells.configure_cells import open_commissioning, present_nodes
    from mdms_host.commissioning.wheel_turn import refuse_busy
    from mdms_host.flashing.candidates import read_candidates

    with open_commissioning(arguments) as commissioning:
        node_ids = present_nodes(commissioning, nodes_of(arguments.nodes))
        if not arguments.list:
            # Blocks fill the bus, on which cells that run a program need one another.
            refuse_busy(commissioning, sorted(commissioning.states))
        with progress("asking") as share:
            cells = read_candidates(commissioning, node_ids, share)
        if not cells:
            raise CommandError("there is no MDMS cell on the bus", ExitCode.NODE_FAULT)
        present = frozenset(cell.node_id for cell in cells)
        if arguments.list:
            return _list(arguments, cells), present
        rows = _planned(arguments, cells)
        updater = _carried_out(arguments, commissioning, rows)
        return _conclude(arguments, rows, updater), present


def _planned(arguments: Namespace, cells: "Sequence[Candidate]") -> list[Row]:
    """Each cell with its bundle. Raises BundleError, KeyFileError, FirmwareError."""
    takers = [cell for cell in cells if cell.refusal is None]
    bundles = _bundles(arguments, takers) if takers else {}
    rows = []
    for cell in cells:
        bundle = bundles.get(cell.bytecode) if cell.refusal is None else None
        rows.append(Row(cell, bundle, cell.refusal))
    if arguments.save is not None:
        made = list({id(each): each for each in bundles.values()}.values())
        _save(arguments.save, made, force=arguments.force)
    return rows


def _bundles(arguments: Namespace, cells: "Sequence[Candidate]") -> "dict[int, Bundle]":
    """A bundle for each bytecode that the cells read."""
    from mdms_host.flashing import bundles
    from mdms_host.flashing.bundles import key_beside, read_key
    from mdms_host.flashing.firmware import FirmwareError
    from mdms_protocol.codecs.bundle import HEAD_SIZE
    from mdms_protocol.version import VERSION

    bytecodes = {cell.bytecode for cell in cells}
    given = None if arguments.bundle is None else bundles.read_bundle(arguments.bundle)
    if given is not None and not arguments.allow_older:
        return dict.fromkeys(bytecodes, given)
    path = arguments.key or (key_beside(arguments.array) if arguments.array else KEY)
    key = read_key(path)
    counter = max(cell.counter for cell in cells) + 1
    made = {}
    for bytecode in bytecodes:
        try:
            packed = given.data[HEAD_SIZE:] if given else bundles.packed_firmware(bytecode)
        except FirmwareError as error:
            raise CommandError(str(error), ExitCode.FAILURE) from None
        made[bytecode] = bundles.sign(
            packed,
            key,
            counter,
            given.head.bytecode if given else bytecode,
            older=arguments.allow_older,
            version=given.version if given else VERSION,
        )
    return made


def _save(path: Path, bundles: "Sequence[Bundle]", *, force: bool) -> None:
    """Keep the bundle, whole or not at all, and over no file that is none but with `force`."""
    from mdms_protocol.codecs.bundle import MAGIC

    if len(bundles) != 1:
        raise CommandError(
            f"these cells take {len(bundles)} bundles, and --save keeps one; name cells of one "
            "kind with --node",
            ExitCode.USAGE,
        )
    with replacing(path, MAGIC, force) as partial:
        partial.write_bytes(bundles[0].data)


def _carried_out(
    arguments: Namespace, commissioning: "Commissioning", rows: Sequence[Row]
) -> "Updater":
    """The updates at their ends; none where nothing is to be done.

    Raises BusyError, UpdateRunsError: both may have begun while the firmware was compiled.
    """
    from mdms_host.commissioning.wheel_turn import refuse_busy
    from mdms_host.flashing.cell_update import CellUpdate
    from mdms_host.flashing.updater import Updater

    wanted = [row for row in rows if row.bundle and (arguments.force or not row.current)]
    updates = [CellUpdate(row.cell.node_id, row.bundle) for row in wanted if row.bundle]
    bitrate = getattr(arguments, "bitrate", None) or BITRATE
    updater = Updater([] if arguments.dry_run else updates, bitrate)
    names = {each.node_id: f"node {each.node_id}" for each in updater.updates}

    with bars(names.values()) as share:

        def over() -> bool:
            for each in updater.updates:
                share(names[each.node_id], each.share)
            return updater.over

        if updater.updates:
            commissioning.refuse_update()
            refuse_busy(commissioning, sorted(commissioning.states))
            commissioning.drive(updater, over)
    return updater


def _list(arguments: Namespace, cells: "Sequence[Candidate]") -> dict[str, Any]:
    from rich.table import Table

    figures = {"cells": [_facts(cell) for cell in cells]}
    if arguments.json:
        return figures
    table = Table("node", "serial", "board", "firmware", "came by", "key", "remark")
    for cell in cells:
        came = f"bus ({cell.identification:08X})" if cell.identification else "USB"
        key = cell.key_id.hex() if any(cell.key_id) else "none"
        table.add_row(
            str(cell.node_id),
            f"{cell.identity.serial:08X}",
            cell.board_name,
            cell.identity.software,
            came,
            key,
            cell.refusal or ("on trial: it is not confirmed" if cell.on_trial else ""),
        )
    show(table)
    return figures


def _facts(cell: "Candidate") -> dict[str, object]:
    return {
        "node": cell.node_id,
        "serial": f"{cell.identity.serial:08X}",
        "board": cell.board_name,
        "firmware": cell.identity.software,
        "identification": f"{cell.identification:08X}",
        "room": cell.room,
        "key": cell.key_id.hex(),
        "counter": cell.counter,
        "on_trial": cell.on_trial,
    }


def _conclude(arguments: Namespace, rows: Sequence[Row], updater: "Updater") -> dict[str, Any]:
    """Say a line for each cell; the figures of the bus."""
    from mdms_host.commissioning.network import counted

    results = {each.node_id: each for each in updater.updates}
    facts = []
    for row in rows:
        update = results.get(row.cell.node_id)
        problem = row.problem or (update.failure if update else None)
        facts.append({**_facts(row.cell), **_result(row, problem, done=update is not None)})
        if problem:
            say(f"mdms: node {row.cell.node_id}: {problem}")
        elif not arguments.json:
            print(_line(row, updated=update is not None), flush=True)
    seconds = updater.ended_s - (updater.began_s or 0.0)
    bitrate = getattr(arguments, "bitrate", None) or BITRATE
    repeated = sum(each.repeated for each in updater.updates)
    restarted = sum(each.restarts for each in updater.updates)
    figures = {
        "seconds": round(seconds, 3),
        "frames": updater.frames,
        "bus_load": round(updater.load(bitrate), 4),
        "repeated": repeated,
        "restarted": restarted,
    }
    if results and not arguments.json:
        done = sum(each.finished for each in updater.updates)
        print(
            f"{counted(done, 'cell')} in {seconds:.1f} s: {figures['frames']} frames, bus load "
            f"{updater.load(bitrate):.0%} at most, "
            f"{counted(repeated, 'segment')} repeated, "
            f"{counted(restarted, 'transfer')} begun anew"
        )
    return {"cells": facts, **figures}


def _result(row: Row, problem: str | None, *, done: bool) -> dict[str, object]:
    return {
        "wanted": row.bundle and row.bundle.version,
        "bundle": row.bundle and f"{row.bundle.identification:08X}",
        "updated": done and not problem,
        "problem": problem,
    }


def _line(row: Row, *, updated: bool) -> str:
    assert row.bundle is not None
    head = f"node {row.cell.node_id}: {row.cell.board_name}"
    if updated:
        change = f"{row.cell.identity.software} -> {row.bundle.version}"
        return f"{head}, {change} ({row.bundle.identification:08X}) started and confirmed"
    if row.current:
        return f"{head} has {row.bundle.version} ({row.bundle.identification:08X}) already"
    kilobytes = len(row.bundle.data) / 1000
    return f"{head}: would get {row.bundle.version}, {kilobytes:.1f} KB"
