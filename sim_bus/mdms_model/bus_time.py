"""How long frames may be on a wire, and what share of a bus a host and its cells need."""

from dataclasses import dataclass
from math import floor

from mdms_protocol import pdo
from mdms_protocol.neighbours.frames import LENGTH

#: Start of frame to the data length, and the CRC: what is stuffed besides the data (11-bit ids).
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
