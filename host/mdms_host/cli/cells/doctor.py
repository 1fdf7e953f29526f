"""`mdms doctor`: faults of an array, with cause and cure."""

import json
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import NoReturn

from mdms_array.host import settings_of
from mdms_host.can_link.link import LinkError
from mdms_host.cli.array.table import named_table
from mdms_host.cli.cell_options import nodes_of
from mdms_host.cli.cells.asking import AtTerminal, pressed_keys
from mdms_host.cli.cells.configure_cells import open_commissioning, read_cells
from mdms_host.cli.console import progress
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning import commissioner as steps
from mdms_host.commissioning.array_file import ArrayFile, FiledCell, placed_cells, read_array
from mdms_host.commissioning.cell_settings import read_settings
from mdms_host.commissioning.doctor.diagnosis import diagnose
from mdms_host.commissioning.doctor.emergency_stop import SHORT, StopTest
from mdms_host.commissioning.doctor.examination import Examination, examine, examine_wheels
from mdms_host.commissioning.doctor.findings import KINDS, Finding
from mdms_host.commissioning.network import (
    Commissioning,
    CommissioningError,
    counted,
    ranges,
)
from mdms_host.commissioning.status import NEIGHBOURS
from mdms_host.commissioning.table_cells import (
    HeardCells,
    MissingCells,
    TableBus,
    TableBuses,
    how_known,
    missing_cells,
)
from mdms_host.commissioning.wheel_turn import BusyError, TurnStoppedError, refuse_busy
from mdms_model.loop_margin import motor_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario


def run(arguments: Namespace) -> ExitCode:
    """Examine the bus and its cells, and print the findings; exit code 5 if any is serious.

    Raises LinkError after the findings so far.
    """
    if arguments.stop:
        return _stop(arguments)
    table, turns = named_table(arguments), arguments.turn
    heard: list[HeardCells] = []
    findings: list[Finding] = []
    gone: LinkError | None = None
    try:
        for bus in table.buses:
            for each in _examine(table, bus, arguments, heard):
                findings.append(replace(each, bus=bus.name) if table.is_split else each)
    except LinkError as error:
        if not heard:
            raise
        gone = error
    # The array file knows more of its cells: their serial numbers.
    if gone is None and (table.file is None or arguments.cells is not None):
        missing = missing_cells(heard, arguments.cells)
        # A bus on which no cell answers has a finding of its own.
        findings += [_absent(each) for each in missing if each.node_ids or not each.bus]
    findings.sort(key=lambda each: (not each.row.serious, list(KINDS).index(each.kind), each.nodes))
    cells = {each.bus.name: sorted(each.node_ids) for each in heard}
    source = how_known(heard, arguments.cells)
    if arguments.json:
        figures = {"buses": cells} if table.is_split else {"cells": cells[table.buses[0].name]}
        rows = list(map(_row, findings))
        print(json.dumps({**figures, "findings": rows, "expected_by": source}))
    else:
        _print(sum(map(len, cells.values())), findings)
        say(f"how many cells there are to be: {source}")
        if not arguments.turn:
            which = "further wheels" if turns else "wheels"
            say(f"{which} were not turned, so motors and encoders are not checked (--turn)")
    if gone is not None:
        raise gone
    return ExitCode.NODE_FAULT if any(each.row.serious for each in findings) else ExitCode.OK


def _examine(
    table: TableBuses, bus: TableBus, arguments: Namespace, heard: list[HeardCells]
) -> Iterator[Finding]:
    """The findings of one bus as they come, behind its cells among those that are heard."""
    scenario = load_scenario(arguments.scenario)
    listed = None if table.file is None else _listed(table.file, bus.number, scenario)
    with open_commissioning(bus.options) as commissioning:
        examined = examine(commissioning, MonotonicClock())
        heard.append(_heard(bus, examined))
        yield from diagnose(examined, listed, empty=arguments.empty)
        if listed is not None:
            yield from _settings(commissioning, examined, listed)
        if arguments.turn:
            yield from _wheels(commissioning, examined, arguments)


def _heard(bus: TableBus, examined: Examination) -> HeardCells:
    """The cells that answer, though some may speak another protocol or not answer all."""
    there = {*examined.cells, *examined.silent, *examined.other_protocol}
    neighbours = {
        node_id: [cell[place] for place in NEIGHBOURS] for node_id, cell in examined.cells.items()
    }
    return HeardCells(bus, frozenset(there), neighbours)


def _absent(missing: MissingCells) -> Finding:
    kind = "missing" if missing.is_sure else "gap"
    return Finding(kind, missing.source, missing.node_ids, missing.bus or None)


def _listed(file: ArrayFile, bus: int, scenario: Scenario) -> dict[int, FiledCell]:
    """The cells of the file on a bus, by serial number, whole. Raises ArrayFileError.

    Every run writes some settings by its scenario, and leaves them so. Of these the file counts
    alone, and no default.
    """
    by_runs = {(each.index, each.sub) for each in settings_of(scenario.cell)}
    listed = {}
    for cell in placed_cells(file, bus=bus):
        values = {
            parameter: value
            for parameter, value in steps.at_defaults(cell).values.items()
            if parameter in cell.values or parameter.place not in by_runs
        }
        listed[cell.serial] = replace(cell, values=values)
    return listed


def _settings(
    commissioning: Commissioning, examined: Examination, listed: Mapping[int, FiledCell]
) -> Iterator[Finding]:
    with progress("settings") as share:
        for done, (node_id, cell) in enumerate(examined.cells.items(), 1):
            filed = listed.get(cell.identity.serial)
            if filed is not None:
                yield from _off_the_file(commissioning, node_id, filed)
            share(done / len(examined.cells))


def _off_the_file(commissioning: Commissioning, node_id: int, filed: FiledCell) -> list[Finding]:
    try:
        found = read_settings(commissioning, node_id, filed.values)
    except CommissioningError as error:
        return [Finding("silent-node", str(error), (node_id,))]
    return [
        Finding(
            "settings",
            f"{change.parameter.name} is {change.parameter.text(change.before)}, the file has "
            f"{change.parameter.text(change.after)}",
            (node_id,),
        )
        for change in found.changes(filed.values)
    ]


def _wheels(
    commissioning: Commissioning, examined: Examination, arguments: Namespace
) -> Iterator[Finding]:
    """Wheels of the cells that `--node` names are turned where nobody else drives.

    After a stop no other wheel is turned.
    """
    motor = motor_of(load_scenario(arguments.scenario).cell)
    wanted = nodes_of(arguments.nodes)
    node_ids = [node for node in examined.cells if wanted is None or node in wanted]
    with progress("wheels") as share:
        for done, node_id in enumerate(node_ids, 1):
            try:
                refuse_busy(commissioning, [node_id])
                yield from examine_wheels(commissioning, node_id, motor)
            except BusyError as error:
                yield Finding("no-drive", str(error), (node_id,))
            except TurnStoppedError as error:
                yield Finding("no-drive", str(error), (node_id,))
                # Nor is a wheel of the other buses.
                arguments.turn = False
                break
            share(done / len(node_ids))


def _row(finding: Finding) -> dict[str, object]:
    return {**asdict(finding), "nodes": list(finding.nodes), **asdict(finding.row)}


def _stop(arguments: Namespace) -> ExitCode:
    """Test the emergency stop with a person, and print the findings; exit code 1 for anything."""
    form = SHORT
    if arguments.array is not None:
        file = read_array(arguments.array)
        form = SHORT if file.stop is None else file.stop.form
        channel = getattr(arguments, "channel", None)
        listed = sorted(cell.node_id for cell in placed_cells(file, channel))
        arguments.nodes = arguments.nodes or [listed]
    nobody = "mdms doctor --stop needs a person at a terminal, who presses the emergency stop"
    with pressed_keys(nobody) as pressed, open_commissioning(arguments) as commissioning:
        cells = read_cells(commissioning, arguments, (), _refuse)
        if not cells:
            raise CommandError("there is no MDMS cell on the bus", ExitCode.NODE_FAULT)
        node_ids = [cell.node_id for cell in cells]
        refuse_busy(commissioning, node_ids)
        test = StopTest(commissioning, MonotonicClock(), AtTerminal(pressed), form, arguments.limit)
        findings = test.run(node_ids)
    if arguments.json:
        figures = {"cells": node_ids, "form": form, "fell_s": test.fell_s}
        print(json.dumps({**figures, "findings": list(map(_row, findings))}))
    elif findings:
        _print(len(node_ids), findings)
    else:
        print(
            f"{counted(len(node_ids), 'cell')}: the last lost its supply "
            f"{max(test.fell_s.values()):.2f} s after the first, and all "
            "stayed off after the release"
        )
    return ExitCode.FAILURE if findings else ExitCode.OK


def _refuse(_node_id: int, error: CommissioningError) -> NoReturn:
    """A cell that cannot be read cannot be tested."""
    raise error


def _print(cells: int, findings: Sequence[Finding]) -> None:
    kinds: dict[str, list[Finding]] = {}
    for finding in findings:
        kinds.setdefault(finding.kind, []).append(finding)
    for name, some in kinds.items():
        kind = KINDS[name]
        print(f"{'!!' if kind.serious else ' !'} {kind.symptom} [{name}]")
        for finding in some:
            bus = f"{finding.bus}: " if finding.bus else ""
            node = f"node {ranges(finding.nodes)}"
            is_named = not finding.nodes or finding.text.startswith((f"{node} ", f"{node},"))
            where = "" if is_named else f"{node}: "
            print(f"     {bus}{where}{finding.text}")
        print(f"   cause: {kind.cause}\n   cure:  {kind.cure}\n")
    serious = sum(finding.row.serious for finding in findings)
    told = counted(serious, "serious finding")
    warned = counted(len(findings) - serious, "warning")
    print(f"{counted(cells, 'cell')}: {told}, {warned}")
