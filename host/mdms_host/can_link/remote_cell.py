"""The state of one cell as its frames reported it last, and whether it speaks the host's protocol.

The upper half of the revision in its identity (0x1018:3) is the object table's: cells of another
have other objects, or the same with another meaning. The lower half changes nothing for the host
(CiA 301, 7.5.2.21).
"""

from collections.abc import Callable, Mapping
from math import inf

from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import REVISION
from mdms_protocol.emergencies import IN_ANOTHERS_PLACE, LOW_SUPPLY, SUSPICION

_MAJOR = 16
OURS = REVISION >> _MAJOR


def speaks_ours(revision: int) -> bool:
    """Whether a cell of this revision is understood."""
    return revision >> _MAJOR == OURS


def other_protocol(revision: int) -> str | None:
    """The complaint about a cell of another revision; None without one."""
    if speaks_ours(revision):
        return None
    return (
        f"speaks revision {revision >> _MAJOR} of the protocol, this host {OURS}; "
        "flash the same version: mdms flash"
    )


#: What to do about cells that may not be off.
CUT = "cut the motors' power"
BROKEN_OFF = f"the stop was broken off, so nobody knows what is off; {CUT}"
UPDATE_RUNS = "firmware comes into cells over the bus"
#: Blocks of an update come so close after one another, though a cell erases its flash meanwhile.
UPDATE_S = 2.0


def takes_firmware(frame: Frame) -> bool:
    """Whether a frame is the answer of a cell to a block of its new firmware."""
    is_answer = frame.can_id & ~cob.NODE_MAX == cob.SDO_RESPONSE_BASE and len(frame.data) == 8
    return is_answer and frame.data[0] & sdo.SPECIFIER == sdo.BLOCK_DOWNLOAD_RESPONSE


_DRIVING = frozenset((cia402.OPERATION_ENABLED, cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION))
_NAMES: Mapping[int | None, str] = dict(cia402.NAMES.items())

#: Takes the data of a frame, and the time [s].
Handler = Callable[[bytes, float], None]


class RemoteCell:
    """The last known state of the cell with this number (from 1), node id and bus (None: the only).

    Everything is None until the cell has reported it, and again once it sends no PDOs any more.
    `garbage` counts its frames that could not be decoded and were dropped. `errors` has the code of
    each error that stands, by its source; `suspect` is the node id of the neighbour that it
    suspects, 0 for none. `lacks_supply` is whether its motors' supply is below the limit, or its
    drives have shut off for that.
    `handlers` has the function for each identifier. Speeds come often and are read seldom, so they
    are kept as they came (`speeds_data`) and decoded when read.
    """

    def __init__(self, number: int, node_id: int, bus: int | None = None) -> None:
        self.number = number
        self.node_id = node_id
        self.bus = bus or 0
        #: How messages call this cell.
        self.name = f"cell {number} (node {node_id}{'' if bus is None else f' of bus {bus}'})"
        self.last_heartbeat_s: float | None = None
        self.nmt_state: int | None = None
        self.drive_states: tuple[int | None, ...] | None = None
        self.presence: int | None = None
        self.speeds_data: bytes | None = None
        self.errors: dict[int, int] = {}
        self.suspect = 0
        self.garbage = 0
        self._voltage = True
        self._heard_s = -inf
        #: Whether a PDO has come since the last heartbeat that left the cell no more of them.
        self._told = False
        self.handlers: dict[int, Handler] = {
            cob.HEARTBEAT_BASE + node_id: self.on_heartbeat,
            pdo.STATUS.can_id(node_id): self.on_status,
            pdo.ACTUAL_VELOCITY.can_id(node_id): self.on_speeds,
            cob.EMCY_BASE + node_id: self.on_emergency,
        }

    def on_frame(self, can_id: int, data: bytes, now_s: float) -> None:
        """Take in a frame of this cell; one that cannot be decoded is counted and dropped."""
        handler = self.handlers.get(can_id)
        if handler is not None:
            handler(data, now_s)

    @property
    def speeds_um_s(self) -> tuple[int, ...] | None:
        """The speeds reported last [um/s]."""
        return None if self.speeds_data is None else pdo.ACTUAL_VELOCITY.decode(self.speeds_data)

    @property
    def emergency(self) -> int | None:
        """The code of the error that came last of those that stand; None if there is none."""
        return next(reversed(self.errors.values()), None)

    @property
    def lacks_supply(self) -> bool:
        """See above."""
        return not self._voltage or LOW_SUPPLY in self.errors.values()

    @property
    def elsewhere(self) -> bool:
        """Whether it stands in another cell's place, and so refuses to start."""
        return IN_ANOTHERS_PLACE in self.errors.values()

    @property
    def moving(self) -> bool:
        """Whether any axis may be driving its motor."""
        return not _DRIVING.isdisjoint(self.drive_states or ())

    @property
    def drive_text(self) -> str:
        """The states of the drives in words."""
        if self.drive_states is None:
            return "no statusword yet"
        return ", ".join(
            f"axis {axis} {_NAMES.get(state, 'in no known state')}"
            for axis, state in enumerate(self.drive_states, 1)
        )

    def silence_s(self, now_s: float) -> float:
        """For how long neither a heartbeat nor a state has come [s]; inf if none ever has."""
        return now_s - self._heard_s

    def on_heartbeat(self, data: bytes, now_s: float) -> None:
        """A heartbeat: the cell is alive, and in this NMT state."""
        state = nmt.decode_heartbeat(data)
        if state is None:
            self.garbage += 1
            return
        if state == nmt.INITIALISING:
            # It has restarted, and reports its faults anew.
            self.errors.clear()
            self.suspect = 0
            self._voltage = True
            self.drive_states = None
        if state != nmt.OPERATIONAL and self._told:
            # It sends no PDOs, and no drive runs: a fault alone may still stand.
            self._told, self.speeds_data, self.presence = False, None, None
            if self.moving:
                self.drive_states = None
        self.last_heartbeat_s, self.nmt_state = now_s, state
        self._heard_s = now_s

    def on_status(self, data: bytes, now_s: float) -> None:
        """Its second TPDO: the statuswords and the presence bits."""
        values = pdo.STATUS.decode(data)
        if values is None:
            self.garbage += 1
            return
        self._heard_s = now_s
        *statuswords, self.presence = values
        self.drive_states = tuple(map(cia402.state, statuswords))
        self._voltage = all(word & cia402.VOLTAGE_ENABLED for word in statuswords)
        self._told = True

    def on_speeds(self, data: bytes, now_s: float) -> None:
        """Its first TPDO: the speeds at the last SYNC."""
        if len(data) == pdo.ACTUAL_VELOCITY.length:
            self.speeds_data, self._told = data, True
        else:
            self.garbage += 1

    def on_emergency(self, data: bytes, now_s: float) -> None:
        """An emergency: an error has come up, or that of its source is gone (code 0)."""
        if len(data) != 8:
            self.garbage += 1
            return
        code, source = int.from_bytes(data[:2], "little"), data[3]
        # A changed one becomes the last.
        if SUSPICION in (self.errors.pop(source, None), code):
            self.suspect = data[4] if code == SUSPICION else 0
        if code:
            self.errors[source] = code
