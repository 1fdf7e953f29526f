"""The places of cells in an array, in the integers of the object table.

Cells of a layout are numbered from 1, along x first. Values are by (index, sub-index).
"""

from collections.abc import Iterator

from mdms_host.layout import Layout
from mdms_model.buses import Addresses, foreign_nodes
from mdms_protocol import indices, pdo
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import steps_per_unit

Place = tuple[int, int]

#: Columns and rows to the neighbours by direction, counterclockwise from +x.
_STEPS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
_RANK = (indices.LEASE, 4)


def is_place(place: Place) -> bool:
    """Whether an entry is a cell's place, its neighbours, or its turn to take over SYNC."""
    return place[0] in (indices.PLACE, indices.NEIGHBOURS) or place == _RANK


def place_values(layout: Layout, number: int) -> dict[Place, int]:
    """A cell's place, its neighbours, and its turn to take over SYNC.

    Raises `OutOfRangeError` for values that do not fit the table.
    """
    row, column = divmod(number - 1, layout.columns)
    x_m, y_m = layout.cell_positions_m[number - 1].tolist()
    bus = layout.buses[number - 1]
    peers = sorted(
        node_id for node_id, own in zip(layout.node_ids, layout.buses, strict=True) if own == bus
    )
    rank = peers.index(layout.node_ids[number - 1])
    values = {
        (indices.PLACE, 1): column + 1,
        (indices.PLACE, 2): row + 1,
        (indices.PLACE, 3): _steps(indices.PLACE, 3, x_m),
        (indices.PLACE, 4): _steps(indices.PLACE, 4, y_m),
        (indices.PLACE, 5): _steps(indices.PLACE, 5, layout.pitch_m),
        _RANK: rank + 1,
    }
    for sub, node_id in enumerate(_neighbour_nodes(layout, number), 1):
        values[indices.NEIGHBOURS, sub] = node_id
    return _checked(values)


def wheel_values(layout: Layout) -> dict[Place, int]:
    """The contact points of a cell's wheels, and the directions of their pushes.

    Raises `OutOfRangeError`.
    """
    values: dict[Place, int] = {}
    for axis, wheel in enumerate(layout.wheels):
        x_m, y_m = wheel.offset_m
        meant = (
            (indices.CONTACT_X, x_m),
            (indices.CONTACT_Y, y_m),
            (indices.DIRECTION, wheel.direction_rad),
        )
        for first, value in meant:
            index = first + axis * indices.AXIS_OFFSET
            values[index, 0] = _steps(index, 0, value)
    return _checked(values)


def sensor_values(layout: Layout) -> dict[Place, int]:
    """Where the presence sensors of a cell are. Raises `OutOfRangeError`."""
    index = indices.SENSOR_OFFSETS
    lengths_m = [length_m for offset_m in layout.sensor_offsets_m for length_m in offset_m]
    return _checked(
        {(index, sub): _steps(index, sub, value) for sub, value in enumerate(lengths_m, 1)}
    )


def all_values(layout: Layout, number: int) -> dict[Place, int]:
    """All of the above for a cell. Raises `OutOfRangeError`."""
    return place_values(layout, number) | wheel_values(layout) | sensor_values(layout)


def neighbours_of(layout: Layout, number: int) -> Iterator[int]:
    """The numbers of a cell's neighbours by direction, 0 beyond the array's edge."""
    row, column = divmod(number - 1, layout.columns)
    for step_x, step_y in _STEPS:
        x, y = column + step_x, row + step_y
        inside = 0 <= x < layout.columns and 0 <= y < layout.rows
        yield y * layout.columns + x + 1 if inside else 0


def _neighbour_nodes(layout: Layout, number: int) -> Iterator[int]:
    """The neighbours' node ids on the cell's own bus, 0 beyond the array's edge."""
    addresses = Addresses(layout.buses, layout.node_ids)
    foreign = foreign_nodes(layout.columns, layout.rows, addresses)[layout.buses[number - 1]]
    for neighbour in neighbours_of(layout, number):
        own = layout.node_ids[neighbour - 1] if neighbour else 0
        yield foreign.get(neighbour, own)


def _steps(index: int, sub: int, value: float) -> int:
    """A value in the SI unit of its entry."""
    return round(value * steps_per_unit(ENTRIES[index, sub].unit))


def _checked(values: dict[Place, int]) -> dict[Place, int]:
    for place, number in values.items():
        pdo.check(ENTRIES[place], number)
    return values
