"""The words for the error codes of a cell, as in its emergencies and in 0x603F.

They are those of docs/faults.md and of `What an emergency says` in protocol/README.md.
"""

from collections.abc import Mapping

from mdms_protocol import indices
from mdms_protocol.dictionary import ENTRIES

_TIMEOUT_MS = ENTRIES[indices.SETPOINT_TIMEOUT, 0].default

#: The code of an emergency about a neighbour, whose node id is in the first byte of details.
SUSPICION = 0xFF01

#: The code and the source of a cell that refuses to start where another belongs. That one's node id
#: comes first in its details.
IN_ANOTHERS_PLACE = 0xFF02
PLACE_SOURCE = 10

#: The code of a motors' supply below its limit: an emergency stop, a fuse, a battery.
LOW_SUPPLY = 0x3220
#: The bit of the error register (0x1001) for any of voltage, by CiA 301; no other code sets it.
VOLTAGE_ERROR = 0x04

#: The code of a drive that was stopped while no commands came.
STOPPED_MEANWHILE = 0x9000

#: The meaning of each code.
CODES: Mapping[int, str] = {
    0x2310: "over-current, or the bridge has shut off",
    LOW_SUPPLY: "supply below the undervoltage limit",
    0x6100: "exception in the cell's program; it restarts",
    0x6310: "saved settings that this firmware cannot take",
    0x7121: "wheel stands under voltage: stalled",
    0x7302: "wheel turns against its voltage: motor or encoder reversed",
    0x8130: "heartbeat of the host lost",
    0x8140: "bus off",
    0x8150: "another node has the same node id",
    0x8210: "a receive PDO is too short",
    0x8250: f"no setpoint for {_TIMEOUT_MS} ms",
    0x8611: "speed off its reference for too long",
    STOPPED_MEANWHILE: "stopped by another program while no commands came",
    SUSPICION: "a neighbour contradicts, and is left out",
    IN_ANOTHERS_PLACE: "it stands in the place of another cell, and does not start",
}
#: The source of an emergency, by its source byte, where the code does not say it.
_SOURCES: Mapping[int, str] = {1: "axis 1", 2: "axis 2"}


def is_elsewhere(error_register: int, suspect: int) -> bool:
    """Whether a cell stands in another's place, by its 0x1001 and 0x3015.

    Bit 7 of the register stands for the codes of cells alone (0xFFxx), and a suspicion is the other
    one.
    """
    return bool(error_register & 0x80) and not suspect


def code_text(code: int) -> str:
    """A code and its meaning, as in '0x8250: no setpoint for 50 ms'."""
    return f"0x{code:04X}: {CODES.get(code, 'a code that no cell of this version has')}"


def error_text(source: int, code: int) -> str:
    """A code with its source, where that says more."""
    where = f" ({_SOURCES[source]})" if source in _SOURCES else ""
    return f"{code_text(code)}{where}"
