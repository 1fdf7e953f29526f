"""`mdms commission`: from a bag of boards to an array, and the file that describes it.

The array's key, with which bundles are signed, is made and given to cells that have none.
"""

import json
import os
import sys
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile

from mdms_host.cli.cells.asking import ask_directions, ask_places, confirmed
from mdms_host.cli.cells.configure_cells import open_commissioning
from mdms_host.cli.cells.plate import watch_plate
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.files import check_own, replacing, writing
from mdms_host.cli.options import NO_NODES
from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning import commissioner as steps
from mdms_host.commissioning.array_file import (
    MARK,
    ArrayFile,
    FiledCell,
    FiledTable,
    array_document,
    cells_on,
    placed_cells,
    read_array,
)
from mdms_host.commissioning.network import Commissioning, CommissioningError, counted
from mdms_host.commissioning.node_ids import Assignment, FoundCells, carry_out, find_cells
from mdms_host.commissioning.sightings import Spot
from mdms_host.commissioning.wheel_turn import TurnStoppedError, nudge, refuse_busy, refuse_steering
from mdms_host.flashing.bundles import key_beside, key_id, make_key, read_key
from mdms_host.flashing.candidates import give_key, read_candidate
from mdms_protocol.dictionary import AXES


def array_key(named: Path | None, array: Path | None) -> bytes | None:
    """The key in the file that was named, or else in the one beside the array.

    None where the file is missing. Raises KeyFileError, OSError.
    """
    file = named or (None if array is None else key_beside(array))
    return read_key(file) if file is not None and file.exists() else None


def give_keys(
    commissioning: Commissioning,
    cells: Sequence[FiledCell],
    key: bytes,
    report: Callable[[str], None],
) -> dict[str, str]:
    """Give the key to all cells that have room for firmware; why it failed, by serial number."""
    failed = {}
    for cell in cells:
        name = f"{cell.serial:08X}"
        try:
            identity = commissioning.identity(cell.node_id)
            candidate = read_candidate(commissioning, cell.node_id, identity)
            if candidate.refusal:
                report(f"{name}: no key: {candidate.refusal}")
            elif give_key(commissioning, candidate, key, key_id(key)):
                report(f"{name}: has the update key {key_id(key).hex()} now")
        except CommissioningError as error:
            failed[name] = str(error)
    return failed


#: A cell that shares its node id is reset with the one that hides it, which needs so long to boot.
_BOOT_S = 0.3


@dataclass(slots=True)
class _Job:
    """The objects of one run of the verb."""

    commissioning: Commissioning
    arguments: Namespace
    failed: dict[str, str]

    def report(self, text: str) -> None:
        """A line about a step that is done, unless the result is to be JSON."""
        if not self.arguments.json:
            print(text, flush=True)


def run(arguments: Namespace) -> ExitCode:
    """Find the cells, place them, give ids and settings, store, verify, and write the file."""
    listed = None if arguments.file is None else read_array(arguments.file)
    out: Path | None = arguments.out or (None if listed else Path("array.toml"))
    if out is not None:
        check_own(out, MARK.encode(), arguments.force)
        if out.is_file() or not out.exists():
            # What cannot be made at the end is told before a person places cells.
            with writing(out), TemporaryFile(dir=Path(os.path.realpath(out)).parent):
                pass
    key = array_key(arguments.key, arguments.file or out)
    with open_commissioning(arguments) as commissioning:
        job = _Job(commissioning, arguments, {})
        roll = _call_roll(commissioning)
        file = _placed(job, roll) if listed is None else listed
        cells = _checked(job, roll, file, whole=listed is not None)
        count = len(cells)
        if not confirmed(arguments, f"Write ids, places and settings to {counted(count, 'cell')}?"):
            raise CommandError("nothing was written", ExitCode.FAILURE)
        # A run may have begun while the person was asked.
        roll = find_cells(commissioning)
        refuse_busy(commissioning, [*roll.present])
        if key is None and arguments.key is not None:
            key = make_key(arguments.key)
            advice = "keep it safe, and out of version control"
            say(f"mdms: {arguments.key} is the array's new key; {advice}")
        _give_ids(job, roll, {cell.serial: cell.node_id for cell in cells})
        cells = _nudged(job, cells, file.table.columns if _asks(arguments) else None)
        done = _write(job, cells)
        if key is not None:
            job.failed.update(give_keys(commissioning, cells, key, job.report))
        if job.failed:
            raise CommandError(_failure(job, count), ExitCode.NODE_FAULT)
        if out is not None:
            named = steps.settings_beside_defaults(commissioning, cells)
            _write_file(out, replace(file, cells=_merged(file.cells, named)), arguments.force)
    _conclude(job, done, out)
    return ExitCode.OK


def _call_roll(commissioning: Commissioning) -> FoundCells:
    roll = find_cells(commissioning)
    if not roll.serials:
        raise CommandError(NO_NODES, ExitCode.NO_DEVICE)
    refuse_busy(commissioning, [*roll.present])
    for serial, node_id in roll.hidden.items():
        say(f"mdms: {serial:08X} has node id {node_id}, as another cell has; it gets its own")
    return roll


def _asks(arguments: Namespace) -> bool:
    """Whether a person is to say where the cells are, one after the other."""
    return not (arguments.file or arguments.list or arguments.plate or arguments.codes)


def _placed(job: _Job, roll: FoundCells) -> ArrayFile:
    """The array as a person, a list, the table or a plate says it is."""
    arguments = job.arguments
    columns, rows = arguments.columns, arguments.rows
    if (columns is None or rows is None) and not arguments.plate:
        raise CommandError("name the grid: --columns and --rows", ExitCode.USAGE)
    if columns and rows:
        steps.refuse_wrong_count(roll, columns * rows)
    if arguments.list is not None:
        spots = _spots_listed(roll, arguments.list, columns)
    elif arguments.codes:
        spots = _spots_coded(job, roll, columns)
    else:
        if _asks(arguments) and not sys.stdin.isatty():
            raise CommandError(
                "nobody can be asked here; give --from, --list, --codes or --plate", ExitCode.USAGE
            )
        roll = _give_ids(job, roll, steps.provisional_ids(roll))
        if arguments.plate:
            columns, rows, spots = watch_plate(job.commissioning, roll, arguments)
        else:
            spots = ask_places(job.commissioning, roll, (columns, rows), again=arguments.again)
    return _array(arguments, (columns, rows), spots)


def _spots_listed(roll: FoundCells, path: Path, columns: int) -> dict[int, Spot]:
    """Serial numbers in a text file, one a line, along x first."""
    try:
        words = path.read_text(encoding="ascii").split()
        serials = [int(word, 16) for word in words]
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CommandError(
            f"{path}: expected a serial number a line: {reason}", ExitCode.USAGE
        ) from None
    if len({*serials}) != len(serials) or {*serials} != roll.serials:
        differing = sorted({*serials} ^ roll.serials) or serials
        raise CommandError(
            f"{path}: lists {counted(len(serials), 'serial number')}, "
            f"{counted(len(roll.serials), 'cell is', 'cells are')} on the bus, and these "
            "are not on both sides, or there twice: "
            + ", ".join(f"{serial:08X}" for serial in differing),
            ExitCode.USAGE,
        )
    return {
        serial: (place % columns + 1, place // columns + 1) for place, serial in enumerate(serials)
    }


def _spots_coded(job: _Job, roll: FoundCells, columns: int) -> dict[int, Spot]:
    """The places that the table's connectors tell; the cells have their node ids again then."""
    count = len(roll.serials)
    if not confirmed(
        job.arguments,
        f"Give {counted(count, 'cell another node id', 'cells other node ids')}, to read places?",
    ):
        raise CommandError("nothing was written", ExitCode.FAILURE)
    refuse_busy(job.commissioning, [*roll.present])
    try:
        renamed = _give_ids(job, roll, steps.uncoded_ids(roll))
        if len(renamed.present) != count:
            found = len(renamed.present)
            raise CommandError(f"{found} of {count} cells answer: try again", ExitCode.NODE_FAULT)
        return steps.coded_spots(job.commissioning, renamed, columns)
    finally:
        _give_ids(job, find_cells(job.commissioning), roll.node_ids)


def _array(arguments: Namespace, grid: Spot, spots: Mapping[int, Spot]) -> ArrayFile:
    columns, rows = grid
    bitrate = getattr(arguments, "bitrate", None)
    table = FiledTable(columns=columns, rows=rows, pitch_m=arguments.pitch, bitrate=bitrate)
    cells = []
    for serial, (column, row) in spots.items():
        number = (row - 1) * columns + column
        cells.append(FiledCell(serial, number, {}, number=number))
    return ArrayFile(Path("array"), table, tuple(cells))


def _checked(job: _Job, roll: FoundCells, file: ArrayFile, *, whole: bool) -> list[FiledCell]:
    """The cells with all that their places imply, and with `whole` the defaults of all else.

    A file gives all places; a cell that was placed otherwise keeps its own.
    """
    channel = getattr(job.arguments, "channel", None)
    steps.refuse_unlisted(roll, file, cells_on(file, channel))
    cells = placed_cells(file, channel)
    return [steps.at_defaults(cell) if whole else cell for cell in cells]


def _give_ids(job: _Job, roll: FoundCells, wanted: Mapping[int, int]) -> FoundCells:
    """Cells get their node ids, and keep them; returns the present nodes."""
    moves = steps.plan_ids(roll, wanted)
    if not moves:
        return roll

    def report(move: Assignment) -> None:
        was = "blank" if move.before is None else f"node {move.before}"
        job.report(f"{move.address.serial:08X}: {was} -> node {move.node_id}")

    for move in carry_out(job.commissioning, moves, report):
        say(f"mdms: {move.address.serial:08X} has no memory for settings, and is blank when off")
    if roll.hidden:
        MonotonicClock().sleep(_BOOT_S)
    return find_cells(job.commissioning)


def _nudged(job: _Job, cells: list[FiledCell], columns: int | None) -> list[FiledCell]:
    """The cells with the polarity of their wheels; those wired wrongly fail, and are left out.

    Where a person is asked, one question is for the cells of a row, which has so many `columns`.
    """
    if not _may_nudge(job, columns is not None):
        say("mdms: wheels were not nudged, so motors and encoders are not checked (--nudge)")
        return cells
    job.commissioning.foreign_stops.turns_agreed()
    size = len(cells) if columns is None else columns
    going = []
    for start in range(0, len(cells), max(size, 1)):
        row = cells[start : start + size]
        if columns is not None:
            say(
                f"Row {start // size + 1} of {-(-len(cells) // size)}: watch the tops of its wheels"
            )
        going += _nudged_row(job, row, asking=columns is not None)
    return going


def _nudged_row(job: _Job, cells: list[FiledCell], *, asking: bool) -> list[FiledCell]:
    """The same for some cells: all wheels of an axis first, then those of the other."""
    faults: dict[int, list[str]] = {cell.serial: [] for cell in cells}
    for axis in range(1, AXES + 1):
        _push(job, cells, axis, faults)
        sound = [cell for cell in cells if not (faults[cell.serial] or _has_failed(job, cell))]
        if asking and sound:
            again = partial(_push, job, sound, axis, faults)
            asked = ask_directions(job.commissioning, sound, axis, again)
            turned = {cell.serial: cell for cell in asked}
            cells = [turned.get(cell.serial, cell) for cell in cells]
    for cell in cells:
        if faults[cell.serial] and not _has_failed(job, cell):
            named = "; ".join(dict.fromkeys(faults[cell.serial]))
            job.failed[f"{cell.serial:08X}"] = f"node {cell.node_id}, {named}"
    return [cell for cell in cells if not _has_failed(job, cell)]


def _has_failed(job: _Job, cell: FiledCell) -> bool:
    return f"{cell.serial:08X}" in job.failed


def _push(job: _Job, cells: Sequence[FiledCell], axis: int, faults: dict[int, list[str]]) -> None:
    """Turn one wheel of each cell by a little, and note faults of the wiring.

    A cell that cannot be asked has failed. Raises StoppedError where another host has stopped the
    cells.
    """
    for cell in cells:
        if _has_failed(job, cell):
            continue
        try:
            refuse_steering(job.commissioning, cell.node_id)
            direction = nudge(job.commissioning, cell.node_id, axis)
        except TurnStoppedError:
            raise
        except CommissioningError as error:
            job.failed[f"{cell.serial:08X}"] = str(error)
            continue
        if fault := steps.wiring_fault(axis, direction):
            faults[cell.serial].append(fault)


def _may_nudge(job: _Job, asking: bool) -> bool:
    """Only by `--nudge`, or a yes to the question."""
    if job.arguments.nudge or not asking or job.arguments.yes:
        return bool(job.arguments.nudge)
    question = "May each wheel turn by a few millimetres, to check its wiring?"
    return confirmed(job.arguments, question, default=False)


def _write(job: _Job, cells: list[FiledCell]) -> list[steps.Commissioned]:
    """Write and store the settings of all cells; one that fails does not keep the others.

    Raises BusyError where a run has begun while a person was asked.
    """
    refuse_busy(job.commissioning, [])
    done = []
    for cell in cells:
        try:
            one = steps.write_settings(job.commissioning, cell)
        except CommissioningError as error:
            job.failed[f"{cell.serial:08X}"] = str(error)
            continue
        done.append(one)
        kept = "stored" if one.stored else "not stored: its board has no memory for settings"
        changed = counted(one.changed, "setting")
        job.report(f"{cell.serial:08X}: node {cell.node_id}, {changed}, {kept}")
    return done


def _failure(job: _Job, count: int) -> str:
    for serial, reason in job.failed.items():
        say(f"mdms: {serial}: {reason}")
    return (
        f"{count - len(job.failed)} of {count} cells are done, and no file was written; mend the "
        "others and run the same again"
    )


def _merged(cells: tuple[FiledCell, ...], named: tuple[FiledCell, ...]) -> tuple[FiledCell, ...]:
    """The cells of the file, those on this bus with the settings that were read."""
    settings = {cell.serial: cell.values for cell in named}
    return tuple(replace(cell, values=settings.get(cell.serial, cell.values)) for cell in cells)


def _write_file(out: Path, file: ArrayFile, force: bool) -> None:
    with replacing(out, MARK.encode(), force) as partial:
        partial.write_text(array_document(file), encoding="utf-8")


def _conclude(job: _Job, done: list[steps.Commissioned], out: Path | None) -> None:
    if job.arguments.json:
        rows = [
            {"node": each.node_id, "changed": each.changed, "stored": each.stored} for each in done
        ]
        print(json.dumps({"cells": rows, "file": None if out is None else str(out)}))
        return
    where = "" if out is None else f"; array file: {out}"
    print(f"{counted(len(done), 'cell is', 'cells are')} commissioned and verified{where}")
