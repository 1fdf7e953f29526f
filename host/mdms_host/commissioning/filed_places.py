"""Cells of a file with the places that its table gives them, as settings."""

from collections.abc import Sequence
from dataclasses import replace

from mdms_host.commissioning.array_file import ArrayFile, ArrayFileError, FiledCell, cells_on
from mdms_host.commissioning.parameters import BY_PLACE, Parameter
from mdms_host.layout import Layout, WheelPlace
from mdms_host.places import Place, is_place, place_values, sensor_values, wheel_values


def without_places(cell: FiledCell) -> FiledCell:
    """The cell without what a table says of it."""
    values = {each: number for each, number in cell.values.items() if not is_place(each.place)}
    return replace(cell, values=values)


def placed_cells(file: ArrayFile, channel: str | None = None) -> tuple[FiledCell, ...]:
    """The cells on the bus of that channel, with where they stand, who is next and what is on them.

    Places, neighbours and turns to take over SYNC are the table's, whatever a cell's own settings
    say; where wheels and sensors are comes from the table, unless a cell has its own. A file whose
    table has no columns and rows leaves the cells as they are. Raises ArrayFileError.
    """
    table = file.table
    on_bus = cells_on(file, channel)
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
