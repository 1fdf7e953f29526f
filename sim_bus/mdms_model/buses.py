"""The buses of an array: the cells on each, node ids, neighbours, and times on the wire.

Buses are numbered from 0 in the order of their lists, cells from 1, along x first. Frames are taken
to be as long as they can get.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor

from mdms_protocol import pdo
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours.frames import LENGTH

#: Start of frame to the data length, and the CRC: the part that is stuffed besides the data (11-bit
#: ids).
STUFFED_BITS = 34
#: Delimiters, acknowledge slot, end of frame and inter-frame space.
PLAIN_BITS = 13
#: A stuff bit may follow every four bits, as it counts itself to the next five.
STUFF_EVERY = 4

#: TPDOs of a cell that go out at every SYNC: speeds, and estimates at worst. States and pages of a
#: program do when they change, and come besides.
SENT_AT_SYNC = frozenset((1, 3))

#: Above this share answers queue: a cell's speeds come after the setpoints that need them.
CROWDED = 0.6
#: Above this one a retry or an emergency is late for its limit: cells seem silent.
OVERLOADED = 0.8


def worst_bits(data_bytes: int) -> int:
    """The longest that a frame of so many bytes gets, with the space after it [bits].

    As in Davis, Burns, Bril and Lukkien (2007), eq (1).
    """
    stuffed = STUFFED_BITS + 8 * data_bytes
    return stuffed + PLAIN_BITS + (stuffed - 1) // STUFF_EVERY


#: Where cells steer, they miss the host after three of its heartbeats. Where two frames in a
#: hundred get lost, that happens once in an hour.
WATCHED_HEARTBEAT_S = 0.024


@dataclass(frozen=True, slots=True)
class BusTraffic:
    """Frames that a host and its cells repeat on one bus: periods [s], bit rate [bit/s].

    The side with the `control`, "host" or "cells", has a frame for each cell at every SYNC: the
    host's setpoint, or the cell's belief of its parcel.
    """

    bitrate: int
    sync_period_s: float
    heartbeat_period_s: float
    status_period_s: float
    control: str = "host"

    def load(self, cells: int, forwarded: int = 0) -> float:
        """The share of the bus that so many cells and their host need at most.

        Setpoints or estimates and speeds of each cell at every SYNC, its state as it repeats it,
        heartbeats; and the frames that gateways forward at every SYNC. Changes of state come
        besides: a frame for each edge of a parcel over a sensor; and the pages of motion programs.
        """
        own = self._host_bits_per_s() + cells * self._cell_bits_per_s()
        return (own + forwarded * worst_bits(8) / self.sync_period_s) / self.bitrate

    def most_cells(self) -> int:
        """The most cells that the bus carries within the limit."""
        room = OVERLOADED * self.bitrate - self._host_bits_per_s()
        return max(floor(room / self._cell_bits_per_s()), 0)

    def _host_bits_per_s(self) -> float:
        watched = self.control == "cells"
        heartbeat_s = WATCHED_HEARTBEAT_S if watched else self.heartbeat_period_s
        return worst_bits(0) / self.sync_period_s + worst_bits(1) / heartbeat_s

    def _cell_bits_per_s(self) -> float:
        steering = LENGTH if self.control == "cells" else pdo.TARGET_VELOCITY.length
        exchanged = worst_bits(steering) + worst_bits(pdo.ACTUAL_VELOCITY.length)
        return (
            exchanged / self.sync_period_s
            + worst_bits(pdo.STATUS.length) / self.status_period_s
            + worst_bits(1) / self.heartbeat_period_s
        )


#: The largest node id that the code of a place can have: six jumpers, and one for parity.
PLACE_CODE_MAX = 63


@dataclass(frozen=True, slots=True)
class Addresses:
    """Bus and node id of each cell, cell 1 first; a node id is one cell's on its bus."""

    buses: tuple[int, ...]
    node_ids: tuple[int, ...]

    @property
    def bus_count(self) -> int:
        """How many buses there are."""
        return max(self.buses) + 1

    def on_bus(self, bus: int) -> list[int]:
        """The numbers of the cells on a bus, in ascending order."""
        return [number for number, own in enumerate(self.buses, 1) if own == bus]


def address_cells(cells: int, buses: Sequence[Sequence[int]] = ()) -> Addresses:
    """Addresses of so many cells on buses with these lists of numbers, each cell in one of them.

    A cell's node id is its place in its bus's list, from 1. Without lists all are on one bus, and
    node ids are the numbers.
    """
    lists = buses or [range(1, cells + 1)]
    places = {
        number: (bus, node_id)
        for bus, numbers in enumerate(lists)
        for node_id, number in enumerate(numbers, 1)
    }
    ordered = [places[number] for number in range(1, cells + 1)]
    return Addresses(tuple(bus for bus, _ in ordered), tuple(node for _, node in ordered))


def neighbours(number: int, columns: int, rows: int) -> Iterator[int]:
    """The up to eight cells around a cell of a grid, in ascending order."""
    row, column = divmod(number - 1, columns)
    for beside_row in range(max(row - 1, 0), min(row + 2, rows)):
        for beside in range(max(column - 1, 0), min(column + 2, columns)):
            if (beside_row, beside) != (row, column):
                yield beside_row * columns + beside + 1


def foreign_nodes(columns: int, rows: int, addresses: Addresses) -> tuple[dict[int, int], ...]:
    """For each bus the cells of others that touch its own, with the node ids they have there.

    Such a cell is forwarded under a node id that no cell of the bus has: they are given from the
    highest down, in the order of the numbers. Raises ValueError where they meet the bus's own.
    """
    foreign = []
    for bus in range(addresses.bus_count):
        own = addresses.on_bus(bus)
        touching = {each for number in own for each in neighbours(number, columns, rows)}
        outside = sorted(touching.difference(own))
        highest = max(addresses.node_ids[number - 1] for number in own)
        room = cob.CELL_NODE_MAX - highest
        if len(outside) > room:
            raise ValueError(
                f"bus {bus} has node ids up to {highest}, which leaves {max(room, 0)} for the "
                f"{len(outside)} cells of other buses around it"
            )
        foreign.append({cell: cob.CELL_NODE_MAX - place for place, cell in enumerate(outside)})
    return tuple(foreign)


@dataclass(frozen=True, slots=True)
class GatewayPlan:
    """A gateway between two buses: identifiers that it forwards, and as which.

    `tables[0]` is from the first bus to the second, `tables[1]` the other way.
    """

    buses: tuple[int, int]
    tables: tuple[dict[int, int], dict[int, int]]


def plan_gateways(
    columns: int, rows: int, addresses: Addresses, tpdos: Sequence[int]
) -> tuple[GatewayPlan, ...]:
    """Gateways that carry these TPDOs (from 1) of cells at a border to the buses beyond it.

    One for each two buses with cells that touch, ordered by bus. Raises ValueError where a bus has
    no node ids left.
    """
    if not tpdos:
        return ()
    tables: dict[tuple[int, int], dict[int, int]] = {}
    for to, foreign in enumerate(foreign_nodes(columns, rows, addresses)):
        for number, alias in foreign.items():
            ways = tables.setdefault((addresses.buses[number - 1], to), {})
            node_id = addresses.node_ids[number - 1]
            ways |= {base + node_id: base + alias for base in _bases(tpdos)}
    pairs = sorted({(min(way), max(way)) for way in tables})
    return tuple(
        GatewayPlan((one, other), (tables[one, other], tables[other, one])) for one, other in pairs
    )


def _bases(tpdos: Sequence[int]) -> list[int]:
    return [cob.TPDO_BASES[number - 1] for number in sorted(set(tpdos))]
