"""Whether a cell is set up as a run expects, by one signature over all stored settings."""

from collections.abc import Iterable, Mapping
from zlib import crc32

from mdms_host.can_link.sdo_client import Read, Setting
from mdms_host.places import Place
from mdms_protocol import indices
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import Entry

#: Where a cell reports the signature of its settings.
SIGNATURE = Read(indices.SIGNATURE, 0)
_STORED: Mapping[Place, Entry] = {
    place: entry for place, entry in ENTRIES.items() if entry.stored is not None
}
#: All settings count.
NOTHING: Mapping[Place, int] = {}
#: How many differences a message lists.
_LISTED = 4


class Configuration:
    """The stored settings of a cell as a run expects them: the table's defaults and `settings`.

    `values` has the number of each, by (index, sub-index), in the order of the table. The run does
    not rely on the entries of `spare`, as far as `settings` leaves them alone: they may have any
    value, and have those of `spare` in a cell that was told its place.
    """

    def __init__(
        self, node_id: int, settings: Iterable[Setting], spare: Mapping[Place, int] = NOTHING
    ) -> None:
        self.values: dict[Place, int] = {
            place: entry.default + (node_id if entry.from_node else 0)
            for place, entry in _STORED.items()
        }
        given = {(each.index, each.sub): each.value for each in settings}
        self.values |= {place: value for place, value in given.items() if place in _STORED}
        self._spare = {place: value for place, value in spare.items() if place not in given}

    @property
    def signature(self) -> int:
        """The CRC-32 over all values as they go over the wire (`mdms_protocol.signature`)."""
        return _signature(self.values)

    def accepts(self, signature: int) -> bool:
        """Whether a cell with this signature is as expected, with its place told or without."""
        return signature in (self.signature, _signature(self.values | self._spare))

    def differences(self, found: Mapping[Place, int]) -> str:
        """The settings that a cell has otherwise, in words; none where only spare ones differ."""
        differing = [
            f"{_STORED[index, sub].name} (0x{index:04X}:{sub}) is {found[index, sub]}, not {value}"
            for (index, sub), value in self.values.items()
            if found[index, sub] != value and (index, sub) not in self._spare
        ]
        more = len(differing) - _LISTED
        listed = ", ".join(differing[:_LISTED]) + (f" and {more} more" if more > 0 else "")
        if listed or any(found[place] != self.values[place] for place in self._spare):
            return listed
        return "its signature (0x3005) is not that of its settings"


def _signature(values: Mapping[Place, int]) -> int:
    crc = 0
    for place, value in values.items():
        kind = _STORED[place].type
        crc = crc32(value.to_bytes(kind.size, "little", signed=kind.low < 0), crc)
    return crc
