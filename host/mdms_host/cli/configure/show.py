"""`mdms configure show`: settings of cells, where they are not at their defaults, or not alike."""

import json
from argparse import Namespace
from collections.abc import Sequence

from rich import box
from rich.table import Table

from mdms_host.cli.configure.cells import open_commissioning, ranges, read_cells
from mdms_host.cli.console import show
from mdms_host.cli.exits import Exit
from mdms_host.cli.streams import say
from mdms_host.commissioning.cell_settings import (
    PARAMETERS,
    WIRING,
    CellSettings,
    Parameter,
    find_parameters,
)

LEGEND = "* not the default   ! cells differ"


def run(arguments: Namespace) -> Exit:
    """Read the settings and print them."""
    parameters = _parameters(arguments)
    with open_commissioning(arguments) as commissioning:
        cells = read_cells(commissioning, arguments, parameters)
    if arguments.json:
        print(json.dumps(_document(parameters, cells)))
    else:
        show(_table(parameters, cells))
        say(LEGEND)
    return Exit.OK


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


def _table(parameters: Sequence[Parameter], cells: Sequence[CellSettings]) -> Table:
    nodes = ranges(cell.node_id for cell in cells)
    table = Table(box=box.SIMPLE_HEAD, padding=0, collapse_padding=True)
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
    """The limits; what is alike to both sides is written once, which 80 columns have room for."""
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
    """Whether cells differ from each other, not counting what comes from their node ids."""
    offsets = {cell.values[parameter] - parameter.default(cell.node_id) for cell in cells}
    return len(offsets) > 1
