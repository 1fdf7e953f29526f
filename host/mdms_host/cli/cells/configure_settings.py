"""`mdms configure show`, `set` and `restore-defaults`: settings of cells.

They are shown where they are not at their defaults, or not alike. New ones are checked, written,
read back, and stored if that is wanted. Cells that return to their defaults keep their node ids.
"""

import json
from argparse import Namespace
from collections.abc import Mapping, Sequence

from rich import box
from rich.table import Table

from mdms_host.cli.cells.configure_cells import (
    BusCells,
    agreed,
    found_cells,
    of_buses,
    refuse_absent,
    refuse_other_host,
    show_changes,
    write_cells,
)
from mdms_host.cli.console import show
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.streams import say
from mdms_host.commissioning.cell_settings import CellSettings, Change, NotTakenError
from mdms_host.commissioning.network import CommissioningError, counted, ranges
from mdms_host.commissioning.parameters import (
    BY_NAME,
    PARAMETERS,
    WIRING,
    Parameter,
    find_parameters,
    parse_assignments,
)
from mdms_model.loop_margin import GainError, Observer, check_gain, motor_of
from mdms_model.scenario.file import load_scenario

LEGEND = "* not the default   ! cells differ"


def show_settings(arguments: Namespace) -> ExitCode:
    """Read the settings and print them."""
    parameters = _parameters(arguments)
    with found_cells(arguments, parameters) as found:
        pass
    if arguments.json:
        documents = {each.bus.name: _document(parameters, each.cells) for each in found}
        print(json.dumps(of_buses(documents)))
    else:
        for each in found:
            show(_table(parameters, each.cells, each.bus.name if each.where else None))
        say(LEGEND)
    refuse_absent(arguments, found)
    return ExitCode.OK


def _parameters(arguments: Namespace) -> list[Parameter]:
    named = [each for name in arguments.names for each in find_parameters(name)]
    return named or [*PARAMETERS, *(WIRING if arguments.wiring else ())]


def _document(parameters: Sequence[Parameter], cells: Sequence[CellSettings]) -> dict[str, object]:
    return {
        "cells": [{"node": cell.node_id, "serial": f"{cell.serial:08X}"} for cell in cells],
        "settings": [_row(parameter, cells) for parameter in parameters],
    }


def _row(parameter: Parameter, cells: Sequence[CellSettings]) -> dict[str, object]:
    entry = parameter.entry
    return {
        "name": parameter.name,
        "object": parameter.object,
        "title": entry.name,
        "unit": parameter.unit,
        "default": parameter.si(entry.default),
        "low": parameter.si(entry.low),
        "high": parameter.si(entry.high),
        "values": {str(cell.node_id): parameter.si(cell.values[parameter]) for cell in cells},
        "changed": [cell.node_id for cell in cells if _changed(parameter, cell)],
        "cells_differ": _differ(parameter, cells),
    }


def _table(
    parameters: Sequence[Parameter], cells: Sequence[CellSettings], bus: str | None
) -> Table:
    nodes = ranges(cell.node_id for cell in cells)
    table = Table(title=bus, box=box.SIMPLE_HEAD, padding=0, collapse_padding=True)
    for name in ("setting", "object", ""):
        table.add_column(name, no_wrap=True)
    for name in (f"node {nodes}", "unit", "default", "limits"):
        table.add_column(name, overflow="fold")
    for parameter in parameters:
        entry = parameter.entry
        changed = any(_changed(parameter, cell) for cell in cells)
        differ = _differ(parameter, cells)
        default = parameter.text(entry.default, unit=False)
        table.add_row(
            parameter.name,
            parameter.object,
            ("*" if changed else " ") + ("!" if differ else " "),
            _values(parameter, cells),
            parameter.unit,
            f"node + {default}" if entry.from_node else default,
            _limits(parameter),
            style="red" if differ else "yellow" if changed else None,
        )
    return table


def _limits(parameter: Parameter) -> str:
    """The limits; a common part of both sides is written once, so that it fits 80 columns."""
    entry = parameter.entry
    low, high = (parameter.text(bound, unit=False) for bound in (entry.low, entry.high))
    return f"+-{high}" if low == f"-{high}" else f"{low} to {high}"


def _values(parameter: Parameter, cells: Sequence[CellSettings]) -> str:
    """The value if all cells have the same, else each with the nodes that have it."""
    nodes_by_value: dict[str, list[int]] = {}
    for cell in cells:
        text = parameter.text(cell.values[parameter], unit=False)
        nodes_by_value.setdefault(text, []).append(cell.node_id)
    if len(nodes_by_value) == 1:
        return next(iter(nodes_by_value))
    return "\n".join(f"{text} ({ranges(nodes)})" for text, nodes in nodes_by_value.items())


def _changed(parameter: Parameter, cell: CellSettings) -> bool:
    return cell.values[parameter] != parameter.default(cell.node_id)


def _differ(parameter: Parameter, cells: Sequence[CellSettings]) -> bool:
    """Whether cells differ from each other, apart from the effects of their node ids."""
    offsets = {cell.values[parameter] - parameter.default(cell.node_id) for cell in cells}
    return len(offsets) > 1


#: The inputs of the speed loop's margin, by axis; while it brakes it has another gain.
LOOPS = tuple(
    (f"axis{axis}.{gain}", f"axis{axis}.observer_lag", f"axis{axis}.acceleration_per_volt")
    for axis in (1, 2)
    for gain in ("gain", "braking_gain")
)


def set_settings(arguments: Namespace) -> ExitCode:
    """Change settings."""
    wanted = parse_assignments(arguments.assignments)
    figures: dict[str, dict[str, object]] = {}
    with found_cells(arguments, to_read(wanted), to_write=True) as found:
        for each in found:
            check_margins(arguments.scenario, each.cells, [wanted] * len(each.cells))
        for each in found:
            changes = [change for cell in each.cells for change in cell.changes(wanted)]
            if not arguments.json:
                show_changes(changes, each.where)
            write_cells(each, changes, save=arguments.save)
            done = [change for change in changes if change.node_id not in each.failed]
            rows = list(map(_change, done))
            figures[each.bus.name] = {"changes": rows, "saved": arguments.save}
            if not arguments.json:
                verdict = _verdict(done, each.node_ids, saved=arguments.save)
                print(each.where + verdict, flush=True)
    if arguments.json:
        print(json.dumps(of_buses(figures)))
    refuse_absent(arguments, found, "the others have the new settings")
    return ExitCode.OK


def check_margins(
    scenario: str,
    cells: Sequence[CellSettings],
    wanted: Sequence[Mapping[Parameter, int]],
) -> None:
    """Raises `CommandError` (bad input) for settings that leave a speed loop no margin.

    `wanted` has what each cell is to be given; only loops that it changes are looked at, with the
    motor of the scenario.
    """
    loops = {
        tuple(node.after[each] for each in loop)
        for node in map(_After, cells, wanted)
        for loop in ([BY_NAME[name] for name in names] for names in LOOPS)
        if any(map(node.changes, loop))
    }
    if loops:
        _check_loops(scenario, loops)


class _After:
    """A cell's settings as they will be."""

    def __init__(self, cell: CellSettings, wanted: Mapping[Parameter, int]) -> None:
        self._before = cell.values
        self.after = {**cell.values, **wanted}

    def changes(self, parameter: Parameter) -> bool:
        return self.after.get(parameter) != self._before.get(parameter)


def _check_loops(scenario: str, loops: set[tuple[int, ...]]) -> None:
    motor = motor_of(load_scenario(scenario).cell)
    if motor.mass_kg == 0.0:
        say(f"mdms: the motors of {scenario} have no inertia, so no gain is too large for them")
        return
    gain, lag, feed = (BY_NAME[name] for name in LOOPS[0])
    for numbers in sorted(loops):
        gain_vs_per_m, lag_s, acceleration = (
            float(each.decimal(number))
            for each, number in zip((gain, lag, feed), numbers, strict=True)
        )
        try:
            check_gain(motor, gain_vs_per_m, Observer(lag_s, acceleration))
        except GainError as error:
            raise CommandError(
                f"{error} (motor of {scenario}, observer lag {lag.text(numbers[1])}, "
                f"acceleration per volt {feed.text(numbers[2])}); name your motors with --scenario",
                ExitCode.USAGE,
            ) from None


def to_read(wanted: Mapping[Parameter, int]) -> list[Parameter]:
    """The changes, and the other values that the margin of its speed loop depends on."""
    needed = dict.fromkeys(wanted)
    for names in LOOPS:
        if any(BY_NAME[name] in wanted for name in names):
            needed.update(dict.fromkeys(BY_NAME[name] for name in names))
    return list(needed)


def _change(change: Change) -> dict[str, object]:
    parameter = change.parameter
    return {
        "node": change.node_id,
        "name": parameter.name,
        "before": parameter.si(change.before),
        "after": parameter.si(change.after),
    }


def _verdict(changes: Sequence[Change], node_ids: Sequence[int], *, saved: bool) -> str:
    written = f"{counted(len(changes), 'setting')} written and verified"
    done = written if changes else "nothing to change"
    return f"{done}; stored on node {ranges(node_ids)}" if saved else done


def restore_defaults(arguments: Namespace) -> ExitCode:
    """Show all settings off their defaults; when that is agreed, restore, restart, and verify."""
    every = (*PARAMETERS, *WIRING)
    with found_cells(arguments, every, to_write=not arguments.dry_run) as found:
        for each in found:
            _restore(each, arguments)
    refuse_absent(arguments, found, "the others were looked after")
    return ExitCode.OK


def _restore(found: BusCells, arguments: Namespace) -> None:
    """The same for the cells of one bus."""
    where, commissioning = found.where, found.commissioning
    every = (*PARAMETERS, *WIRING)
    changes = [
        change
        for cell in found.cells
        for change in cell.changes({each: each.default(cell.node_id) for each in every})
    ]
    show_changes(changes, where)
    if arguments.dry_run:
        off = counted(
            len(changes), "setting is not at its default", "settings are not at their defaults"
        )
        print(f"{where}{off}")
        return
    question = f"{where}Restore the defaults of node {ranges(found.node_ids)}, and restart?"
    if not agreed(arguments, question):
        raise CommandError(f"{where}nothing was changed", ExitCode.FAILURE)
    # A run may have begun while the person was asked.
    refuse_other_host(commissioning)
    for node_id in found.node_ids:
        own = [change for change in changes if change.node_id == node_id]
        try:
            commissioning.restore_defaults(node_id)
            for change in own:
                if commissioning.read(node_id, *change.parameter.place) != change.after:
                    what = f"node {node_id}, {change.parameter.name} is not at its default"
                    raise NotTakenError(what)
        except CommissioningError as error:
            found.fail(node_id, error)
    print(f"{where}defaults restored and verified on node {ranges(found.node_ids)}")
