"""A file (TOML) that describes an array: serial numbers, node ids, settings in SI units.

`mdms configure dump` writes it; `load` and `assign --from` read it.
"""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mdms_host.commissioning.cell_settings import CellSettings
from mdms_host.commissioning.parameters import BY_NAME, Parameter, ParameterError
from mdms_protocol import cob

_HEAD = """\
# Cells of an array, told apart by their serial numbers: node ids, and settings in SI units.
# `mdms configure load` writes the settings, `mdms configure assign --from` the node ids.
"""


class ArrayFileError(Exception):
    """A file that cannot be read, or lacks what it should have; the message has the place."""


@dataclass(frozen=True, slots=True)
class FiledCell:
    """A cell of a file, settings in the integers of the wire."""

    serial: int
    node_id: int
    values: Mapping[Parameter, int]


def array_text(cells: Iterable[CellSettings]) -> str:
    """The text of a file for these cells."""
    return "\n".join([_HEAD, *map(_cell_text, cells)])


def read_array_file(path: Path) -> list[FiledCell]:
    """The cells of a file. Raises ArrayFileError."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ArrayFileError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ArrayFileError(f"{path}: {error}") from None
    try:
        cells = [_cell(each) for each in _tables(document)]
        _refuse_duplicates(cells)
    except (ArrayFileError, ParameterError) as error:
        raise ArrayFileError(f"{path}: {error}") from None
    return cells


def _cell_text(cell: CellSettings) -> str:
    lines = ["[[cell]]", f'serial = "{cell.serial:08X}"', f"node = {cell.node_id}"]
    for parameter, number in cell.values.items():
        line = f"settings.{parameter.name} = {parameter.text(number, unit=False)}"
        lines.append(f"{line}  # {parameter.unit}" if parameter.unit else line)
    return "\n".join(lines) + "\n"


def _tables(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    unknown = document.keys() - {"cell"}
    if unknown:
        raise ArrayFileError(f"unknown key {min(unknown)}; expected [[cell]] tables")
    cells = document.get("cell")
    if not isinstance(cells, list) or not cells or not all(isinstance(c, dict) for c in cells):
        raise ArrayFileError("expected [[cell]] tables")
    return cells


def _cell(table: dict[str, Any]) -> FiledCell:
    unknown = table.keys() - {"serial", "node", "settings"}
    if unknown:
        raise ArrayFileError(f"cell.{min(unknown)}: unknown key")
    serial, node_id = _serial(table.get("serial")), table.get("node")
    if type(node_id) is not int or not cob.NODE_MIN <= node_id <= cob.NODE_MAX:
        raise ArrayFileError(
            f"cell.node: expected {cob.NODE_MIN} to {cob.NODE_MAX}, got {node_id!r}"
        )
    return FiledCell(serial, node_id, dict(_values(table.get("settings", {}), "")))


def _serial(value: object) -> int:
    try:
        serial = int(str(value), 16) if isinstance(value, str) else -1
    except ValueError:
        serial = -1
    if not 0 <= serial <= 0xFFFFFFFF:
        raise ArrayFileError(f'cell.serial: expected 8 hex digits as "0000001A", got {value!r}')
    return serial


def _values(table: object, prefix: str) -> Iterable[tuple[Parameter, int]]:
    if not isinstance(table, dict):
        raise ArrayFileError(f"cell.settings{prefix and '.' + prefix}: expected a table")
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict):
            yield from _values(value, name)
        elif name not in BY_NAME:
            raise ArrayFileError(f"cell.settings.{name}: there is no such setting")
        elif type(value) not in (int, float):
            raise ArrayFileError(f"cell.settings.{name}: expected a number, got {value!r}")
        else:
            yield BY_NAME[name], BY_NAME[name].parse(repr(value))


def _refuse_duplicates(cells: list[FiledCell]) -> None:
    for place, cell in enumerate(cells):
        for other in cells[:place]:
            if cell.serial == other.serial:
                raise ArrayFileError(f"serial number {cell.serial:08X} is there twice")
            if cell.node_id == other.node_id:
                raise ArrayFileError(f"node id {cell.node_id} is there twice")
