"""What a snapshot of a table holds, and its form on the way to a page: named arrays, packed.

A snapshot is one binary message, little-endian: the version of the description that it belongs to
(u32), a sequence number (u32), then the arrays in the order of the description's `signals`, those
of eight bytes first, then those of four, then those of one.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from mdms_host.layout import Layout

HEAD = struct.Struct("<II")
_TYPES: dict[str, np.dtype[Any]] = {
    "f8": np.dtype("<f8"),
    "f4": np.dtype("<f4"),
    "u1": np.dtype("u1"),
}


@dataclass(frozen=True, slots=True)
class Signal:
    """A named array: its type (f8, f4 or u1), its shape, and the SI unit of its numbers.

    A number that is not known is NaN, and 0 in an array of bytes.
    """

    name: str
    type: str
    shape: tuple[int, ...]
    unit: str = ""


class Signals:
    """The arrays of a table with so many cells, wheels, parcels and buses."""

    def __init__(self, cells: int, wheels: int, parcels: int, buses: int, kinds: int) -> None:
        self._signals = (
            Signal("time", "f8", (1,), "s"),
            Signal("speed", "f4", (1,), "1"),
            Signal("real_time_factor", "f4", (1,), "1"),
            Signal("jitter", "f4", (1,), "s"),
            Signal("bus_load", "f4", (buses,), "1"),
            Signal("bus_frames", "f4", (buses, kinds), "1/s"),
            Signal("bus_errors", "f4", (buses,)),
            Signal("bus_error_rate", "f4", (buses,), "1/s"),
            Signal("bus_counters", "f4", (buses, 2)),
            Signal("wheel_speed", "f4", (wheels,), "m/s"),
            Signal("wheel_reference", "f4", (wheels,), "m/s"),
            Signal("wheel_slip", "f4", (wheels,), "m/s"),
            Signal("wheel_normal", "f4", (wheels,), "N"),
            Signal("parcel_believed", "f4", (parcels, 3), "m, m, rad"),
            Signal("parcel_spread", "f4", (parcels, 4), "m2, m2, m2, rad2"),
            Signal("parcel_true", "f4", (parcels, 3), "m, m, rad"),
            Signal("parcel_goal", "f4", (parcels, 3), "m, m, rad"),
            Signal("cell_state", "u1", (cells,)),
            Signal("cell_presence", "u1", (cells,)),
            Signal("cell_promise", "u1", (cells,)),
            Signal("cell_promise_state", "u1", (cells,)),
            Signal("parcel_state", "u1", (parcels,)),
            Signal("phase", "u1", (1,)),
            Signal("paused", "u1", (1,)),
        )

    @classmethod
    def of(cls, layout: Layout, parcels: int, kinds: int) -> Self:
        """Those of a layout, with so many parcels and kinds of frames."""
        return cls(layout.cells, len(layout.wheel_cells), parcels, layout.bus_count, kinds)

    def describe(self) -> list[dict[str, Any]]:
        """The arrays in their order, as JSON has them."""
        return [asdict(signal) for signal in self._signals]

    def pack(self, version: int, sequence: int, values: Mapping[str, Any]) -> bytes:
        """A snapshot of these values by name; one that is not given is not known.

        Raises ValueError for a value of another shape.
        """
        return b"".join((HEAD.pack(version, sequence & 0xFFFF_FFFF), *self._arrays(values)))

    def _arrays(self, values: Mapping[str, Any]) -> Iterator[bytes]:
        for signal in self._signals:
            kind = _TYPES[signal.type]
            value: Any = values.get(signal.name)
            if value is None:
                value = np.full(signal.shape, 0 if signal.type == "u1" else np.nan)
            array = np.asarray(value, kind).reshape(signal.shape)
            yield array.tobytes()
