"""Whether a cell is set up as a run expects, by one signature over all stored settings."""

from collections.abc import Iterable, Mapping
from zlib import crc32

from mdms_host.can_link.sdo_client import Read, Setting
from mdms_protocol import indices
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import Entry

Place = tuple[int, int]

#: Where a cell reports the signature of its settings.
SIGNATURE = Read(indices.SIGNATURE, 0)
_STORED: Mapping[Place, Entry] = {
    place: entry for place, entry in ENTRIES.items() if entry.stored is not None
}
#: How many differences a message lists.
_LISTED = 4


class Configuration:
    """The stored settings of a cell as a run expects them: the table's defaults and `settings`.

    `values` has the number of each, by (index, sub-index), in the order of the table.
    """

    def __init__(self, node_id: int, settings: Iterable[Setting]) -> None:
        self.values: dict[Place, int] = {
            place: entry.default + (node_id if entry.from_node else 0)
            for place, entry in _STORED.items()
        }
        given = {(each.index, each.sub): each.value for each in settings}
        self.values |= {place: value for place, value in given.items() if place in _STORED}

    @property
    def signature(self) -> int:
        """The CRC-32 over all values as they go over the wire (`mdms_protocol.signature`)."""
        crc = 0
        for place, value in self.values.items():
            kind = _STORED[place].type
            crc = crc32(value.to_bytes(kind.size, "little", signed=kind.low < 0), crc)
        return crc

    def differences(self, found: Mapping[Place, int]) -> str:
        """The settings that a cell has otherwise, in words."""
        differing = [
            f"{_STORED[index, sub].name} (0x{index:04X}:{sub}) is {found[index, sub]}, not {value}"
            for (index, sub), value in self.values.items()
            if found[index, sub] != value
        ]
        more = len(differing) - _LISTED
        listed = ", ".join(differing[:_LISTED]) + (f" and {more} more" if more > 0 else "")
        return listed or "its signature (0x3005) is not that of its settings"
