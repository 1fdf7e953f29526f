"""An array in a TOML file: read, checked, given the places of its cells, and written.

The text of a file is the same for the same array: fit for version control.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mdms_host.commissioning.cell_settings import CellSettings
from mdms_host.commissioning.parameters import BY_NAME, BY_PLACE, Parameter, ParameterError, near
from mdms_host.layout import Layout, WheelPlace
from mdms_host.places import Place, is_place, place_values, sensor_values, wheel_values
from mdms_model.errors import InputError
from mdms_model.scenario.file import read_toml
from mdms_model.scenario.limit import LENGTH, Limit
from mdms_model.scenario.scenario import ScenarioError, Stop, Wheel
from mdms_model.scenario.tree import build
from mdms_protocol.codecs import cob

_HEAD = """\
# Cells of an array, told apart by their serial numbers: node ids, and settings in SI units.
# `mdms configure load` writes the settings, `mdms configure assign --from` the node ids; `mdms run
# --array` takes both from it, and a table [array] with columns and rows.
"""
_SIDE = Limit(at_least=1, at_most=1000)
#: The keys of a cell that say where it is.
_PLACE = ("number", "column", "row")
_KEYS = ("serial", "node", "bus", *_PLACE, "settings")
_BUSES_MOST = 1000


class ArrayFileError(InputError):
    """A file that cannot be read, or lacks a necessary key; the message has the place."""


@dataclass(frozen=True, slots=True)
class FiledTable:
    """What `[array]` says: keys of a scenario's array, wheels and sensors, bit rate and channels.

    None where the file says nothing. `scenario` names the scenario whose parcels
    lie on the table, for programs by hand. `channels` are the buses' in python-can's words, bus 0
    first.
    """

    scenario: str | None = None
    columns: int | None = field(default=None, metadata=_SIDE)
    rows: int | None = field(default=None, metadata=_SIDE)
    pitch_m: float | None = field(default=None, metadata=LENGTH)
    bitrate: int | None = field(default=None, metadata=Limit(at_least=10_000, at_most=1_000_000))
    channels: tuple[str, ...] | None = field(default=None, metadata=Limit(items=(1, _BUSES_MOST)))
    wheel: tuple[Wheel, ...] | None = field(default=None, metadata=Limit(items=(1, 2)))
    sensor_offset_m: tuple[tuple[float, float], ...] | None = field(
        default=None, metadata=Limit(at_least=-1000.0, at_most=1000.0, items=(1, 5))
    )


@dataclass(frozen=True, slots=True)
class FiledCell:
    """A cell of a file, settings in the integers of the wire.

    Its place in the grid is its `number`, along x first, or its column and row, all from 1. Without
    either its node id gives the place. Its `bus` is numbered from 0. Where there are several buses,
    each has node ids of its own.
    """

    serial: int
    node_id: int
    values: Mapping[Parameter, int]
    number: int | None = None
    column: int | None = None
    row: int | None = None
    bus: int = 0


@dataclass(frozen=True, slots=True)
class ArrayFile:
    """The content of a file; `stop` has the limits of the emergency stop, None if not stated."""

    path: Path
    table: FiledTable
    cells: tuple[FiledCell, ...]
    stop: Stop | None = None

    @property
    def bus_count(self) -> int:
        """How many buses the cells are on."""
        return max((cell.bus for cell in self.cells), default=0) + 1

    def by_number(self, columns: int, rows: int) -> dict[int, FiledCell]:
        """The cells by their number in a grid; none where the file lists none.

        Raises ArrayFileError for a cell beside the grid, two at one place, and an empty place.
        """
        placed: dict[int, FiledCell] = {}
        for item, cell in enumerate(self.cells):
            if self.bus_count > 1 and cell.number is None and cell.column is None:
                raise ArrayFileError(
                    f"{self.path}: cell.{item}.number is missing: where there are several buses a "
                    "node id is no place; give it, or column and row"
                )
            key, number = _number_of(cell, columns, rows)
            if not 1 <= number <= columns * rows:
                raise ArrayFileError(
                    f"{self.path}: cell.{item}.{key}: node {cell.node_id} is beside the grid of "
                    f"{columns} x {rows} cells"
                )
            if number in placed:
                raise ArrayFileError(
                    f"{self.path}: cell.{item}.{key}: node {cell.node_id} and node "
                    f"{placed[number].node_id} have the same place, number {number}"
                )
            placed[number] = cell
        empty = sorted(set(range(1, columns * rows + 1)) - placed.keys()) if placed else []
        if empty:
            raise ArrayFileError(
                f"{self.path}: cell: {len(placed)} of the {columns} x {rows} cells of the grid are "
                f"listed; number {empty[0]} is missing"
            )
        return placed


def channels_of(channel: str | None, buses: int) -> tuple[str, ...]:
    """Channels of so many buses by one name, as a served array has them. Raises ArrayFileError."""
    if channel is None:
        raise ArrayFileError(
            f"{buses} buses need a channel each: list them as array.channels in the array file, or "
            "name a served array with -c"
        )
    return (channel,) if buses == 1 else tuple(f"{channel}.{bus}" for bus in range(buses))


def array_text(cells: Mapping[str, Sequence[CellSettings]]) -> str:
    """The text of a file for the cells of each bus, by its channel."""
    parts = [_HEAD]
    if len(cells) > 1:
        parts.append(f"[array]\nchannels = [{', '.join(map(_quoted, cells))}]\n")
    for number, some in enumerate(cells.values()):
        bus = number if len(cells) > 1 else None
        parts += [_cell_text(cell, bus) for cell in some]
    return "\n".join(parts)


def read_array(path: Path) -> ArrayFile:
    """All of a file. Raises ArrayFileError."""
    try:
        document = read_toml(path)
    except InputError as error:
        raise ArrayFileError(str(error)) from None
    try:
        unknown = document.keys() - {"array", "stop", "cell"}
        if unknown:
            raise ArrayFileError(
                f"unknown key {min(unknown)}; expected [array], [stop], [[cell]] tables"
            )
        table: FiledTable = build(FiledTable, document.get("array", {}), "array")
        stop: Stop | None = build(Stop, document["stop"], "stop") if "stop" in document else None
        cells = tuple(_cells(document))
        _refuse_duplicates(cells)
        _check_buses(table, cells)
    except (ArrayFileError, ParameterError, ScenarioError) as error:
        raise ArrayFileError(f"{path}: {error}") from None
    return ArrayFile(path, table, cells, stop)


def filed_cells(path: Path, channel: str | None = None) -> tuple[FiledCell, ...]:
    """`cells_on` of the file at a path. Raises ArrayFileError."""
    return cells_on(read_array(path), channel)


def cells_on(
    file: ArrayFile, channel: str | None = None, bus: int | None = None
) -> tuple[FiledCell, ...]:
    """The cells of a file, at least one; of several buses those on one of them.

    That bus is named by its number, or by its channel. Raises ArrayFileError.
    """
    path = file.path
    if not file.cells:
        raise ArrayFileError(f"{path}: expected [[cell]] tables")
    if file.bus_count == 1:
        return file.cells
    if bus is not None:
        return tuple(cell for cell in file.cells if cell.bus == bus)
    names = file.table.channels or ()
    if channel not in names:
        named = f"must be one of {', '.join(names)}" if names else "array.channels is to list them"
        raise ArrayFileError(
            f"{path}: its cells are on {file.bus_count} buses, of which this is done one by one; "
            f"the channel (-c) is {channel!r}, but {named}"
        )
    return tuple(cell for cell in file.cells if cell.bus == names.index(channel))


def _cell_text(cell: CellSettings, bus: int | None) -> str:
    lines = ["[[cell]]", f'serial = "{cell.serial:08X}"', f"node = {cell.node_id}"]
    if bus is not None:
        lines.append(f"bus = {bus}")
    for parameter, number in cell.values.items():
        line = f"settings.{parameter.name} = {parameter.text(number, unit=False)}"
        lines.append(f"{line}  # {parameter.unit}" if parameter.unit else line)
    return "\n".join(lines) + "\n"


def _tables(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    cells = document.get("cell", [])
    listed = isinstance(cells, list) and all(isinstance(each, dict) for each in cells)
    if not listed or not (cells or "array" in document):
        raise ArrayFileError("expected [[cell]] tables")
    return list(cells)


def _cells(document: Mapping[str, Any]) -> Iterator[FiledCell]:
    for item, table in enumerate(_tables(document)):
        try:
            yield _cell(table)
        except (ArrayFileError, ParameterError) as error:
            raise ArrayFileError(f"cell.{item}.{error}") from None


def _cell(table: dict[str, Any]) -> FiledCell:
    unknown = table.keys() - set(_KEYS)
    if unknown:
        raise ArrayFileError(f"{min(unknown)}: unknown key; known here: {', '.join(_KEYS)}")
    serial, node_id = _serial(table.get("serial")), table.get("node")
    if type(node_id) is not int or not cob.NODE_MIN <= node_id <= cob.NODE_MAX:
        raise ArrayFileError(f"node: expected {cob.NODE_MIN} to {cob.NODE_MAX}, got {node_id!r}")
    bus = table.get("bus", 0)
    if type(bus) is not int or not 0 <= bus < _BUSES_MOST:
        raise ArrayFileError(f"bus: expected 0 to {_BUSES_MOST - 1}, got {bus!r}")
    values = dict(_values(table.get("settings", {}), ""))
    return FiledCell(serial, node_id, values, bus=bus, **_place(table))


def _place(table: dict[str, Any]) -> dict[str, int]:
    place = {name: table[name] for name in _PLACE if name in table}
    for name, value in place.items():
        if type(value) is not int or value < 1:
            raise ArrayFileError(f"{name}: expected a whole number from 1, got {value!r}")
    if place and place.keys() not in ({"number"}, {"column", "row"}):
        raise ArrayFileError(
            f"{min(place)}: a place is column and row, or number alone; got {' and '.join(place)}"
        )
    return place


def _number_of(cell: FiledCell, columns: int, rows: int) -> tuple[str, int]:
    """The key that says where a cell is, and its number; 0 for a place beside the grid."""
    if cell.column is not None and cell.row is not None:
        if cell.column > columns:
            return "column", 0
        return "row", (cell.row - 1) * columns + cell.column if cell.row <= rows else 0
    return ("node", cell.node_id) if cell.number is None else ("number", cell.number)


def _serial(value: object) -> int:
    try:
        serial = int(str(value), 16) if isinstance(value, str) else -1
    except ValueError:
        serial = -1
    if not 0 <= serial <= 0xFFFFFFFF:
        raise ArrayFileError(f'serial: expected 8 hex digits as "0000001A", got {value!r}')
    return serial


def _values(table: object, prefix: str) -> Iterable[tuple[Parameter, int]]:
    if not isinstance(table, dict):
        raise ArrayFileError(f"settings{prefix and '.' + prefix}: expected a table")
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict):
            yield from _values(value, name)
        elif name not in BY_NAME:
            raise ArrayFileError(f"settings.{name}: there is no such setting; {near(name)}")
        elif type(value) not in (int, float):
            raise ArrayFileError(f"settings.{name}: expected a number, got {value!r}")
        else:
            yield BY_NAME[name], BY_NAME[name].parse(repr(value))


def _refuse_duplicates(cells: tuple[FiledCell, ...]) -> None:
    for item, cell in enumerate(cells):
        for other, before in enumerate(cells[:item]):
            if cell.serial == before.serial:
                raise ArrayFileError(
                    f"cell.{item}.serial: serial number {cell.serial:08X} is that of cell.{other} "
                    "too; mdms scan shows those of the cells"
                )
            if (cell.bus, cell.node_id) == (before.bus, before.node_id):
                where = f" on bus {cell.bus}" if cell.bus else ""
                raise ArrayFileError(
                    f"cell.{item}.node: node id {cell.node_id}{where} is that of cell.{other} too; "
                    "give each cell of a bus its own"
                )


def _check_buses(table: FiledTable, cells: tuple[FiledCell, ...]) -> None:
    buses = {cell.bus for cell in cells} or {0}
    empty = set(range(max(buses))) - buses
    if empty:
        raise ArrayFileError(f"cell.bus: there is a bus {max(buses)}, but none on {min(empty)}")
    if cells and table.channels is not None and len(table.channels) != len(buses):
        raise ArrayFileError(
            f"array.channels has {len(table.channels)} items, but the cells are on {len(buses)} "
            "buses"
        )


def without_places(cell: FiledCell) -> FiledCell:
    """The cell without the statements of a table about it."""
    values = {each: number for each, number in cell.values.items() if not is_place(each.place)}
    return replace(cell, values=values)


def placed_cells(
    file: ArrayFile, channel: str | None = None, bus: int | None = None
) -> tuple[FiledCell, ...]:
    """The cells on the bus of that channel, with their places, their neighbours and their parts.

    Places, neighbours and turns to take over SYNC come from the table, and not from a cell's own
    settings. Places of wheels and sensors come from the table, unless a cell has its own. A file
    whose table has no columns and rows leaves the cells as they are. Raises ArrayFileError.
    """
    table = file.table
    on_bus = cells_on(file, channel, bus)
    if table.columns is None or table.rows is None:
        return on_bus
    placed = file.by_number(table.columns, table.rows)
    numbers = {cell.serial: number for number, cell in placed.items()}
    try:
        layout = _layout(file, [placed[number] for number in sorted(placed)])
        parts = wheel_values(layout) if table.wheel else {}
        parts |= sensor_values(layout) if table.sensor_offset_m else {}
        return tuple(
            replace(
                cell,
                values={
                    **_parameters(parts),
                    **without_places(cell).values,
                    **_parameters(place_values(layout, numbers[cell.serial])),
                },
            )
            for cell in on_bus
        )
    except ValueError as error:
        raise ArrayFileError(f"{file.path}: array: {error}") from None


def _layout(file: ArrayFile, cells: Sequence[FiledCell]) -> Layout:
    """The table as the file has it; raises ValueError."""
    table = file.table
    layout = Layout(
        table.columns or 0,
        table.rows or 0,
        node_ids=tuple(cell.node_id for cell in cells),
        buses=tuple(cell.bus for cell in cells),
    )
    if table.pitch_m is not None:
        layout = replace(layout, pitch_m=table.pitch_m)
    if table.wheel:
        wheels = tuple(WheelPlace(each.direction_rad, each.offset_m) for each in table.wheel)
        layout = replace(layout, wheels=wheels)
    if table.sensor_offset_m:
        layout = replace(layout, sensor_offsets_m=table.sensor_offset_m)
    return layout


def _parameters(values: dict[Place, int]) -> dict[Parameter, int]:
    return {BY_PLACE[place]: number for place, number in values.items()}


#: The first line of every such file, by which a file is known that may be written over.
MARK = "# Array, commissioned by `mdms commission`."
_FILE_HEAD = f"""{MARK} It takes the same file again: --from FILE.
# `mdms run --array` and `mdms configure load` read it too. Cells stand in the order of their
# places; settings are in SI units, and only those that are not at their defaults.
"""


def array_document(file: ArrayFile) -> str:
    """All that a file says, cells by their numbers, without what their places imply."""
    lines = [_FILE_HEAD, "[array]", *_table(file.table)]
    if file.stop is not None:
        lines += ["", *_stop(file.stop)]
    for cell in sorted(file.cells, key=lambda each: (each.number or each.node_id, each.serial)):
        lines += ["", *_cell_lines(without_places(cell))]
    return "\n".join(lines) + "\n"


def _table(table: FiledTable) -> Iterator[str]:
    for name in ("columns", "rows", "pitch_m", "bitrate"):
        value = getattr(table, name)
        if value is not None:
            yield f"{name} = {value}"
    if table.channels:
        yield f"channels = [{', '.join(map(_quoted, table.channels))}]"
    if table.sensor_offset_m:
        yield f"sensor_offset_m = [{', '.join(map(_vector, table.sensor_offset_m))}]"
    for wheel in table.wheel or ():
        yield ""
        yield "[[array.wheel]]"
        yield f"direction_rad = {wheel.direction_rad}"
        yield f"offset_m = {_vector(wheel.offset_m)}"


def _stop(stop: Stop) -> Iterator[str]:
    yield "[stop]"
    yield f'form = "{stop.form}"'
    yield f"mass_kg = {stop.mass_kg}"
    yield f"speed_m_s = {stop.speed_m_s}"


def _cell_lines(cell: FiledCell) -> Iterator[str]:
    yield "[[cell]]"
    yield f'serial = "{cell.serial:08X}"'
    yield f"node = {cell.node_id}"
    if cell.bus:
        yield f"bus = {cell.bus}"
    for name in ("number", "column", "row"):
        value = getattr(cell, name)
        if value is not None:
            yield f"{name} = {value}"
    for parameter, number in sorted(cell.values.items(), key=lambda item: item[0].place):
        line = f"settings.{parameter.name} = {parameter.text(number, unit=False)}"
        yield f"{line}  # {parameter.unit}" if parameter.unit else line


def _vector(numbers: tuple[float, float]) -> str:
    return f"[{', '.join(map(str, numbers))}]"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
