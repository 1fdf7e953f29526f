"""The identity and the settings of one cell: read, written, verified, and taken back.

Cells that steer are written three more settings. They are to steer by themselves, to give the beat
where SYNC is missing, and to end the motion when the host's heartbeat is missing. At the end all of
that is taken back. Otherwise cells would go on giving the beat, and report the host's silence.
"""

from collections.abc import Iterable, Iterator, Mapping
from zlib import crc32

from mdms_host.can_link import boards
from mdms_host.can_link.remote_cell import other_protocol
from mdms_host.can_link.sdo_client import PATIENT, Read, SdoClient, Setting
from mdms_host.places import Place
from mdms_model.buses import WATCHED_HEARTBEAT_S
from mdms_protocol import indices
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.emergencies import STOPPED_MEANWHILE, error_text
from mdms_protocol.entry import Entry

#: Where a cell reports the revision of its object table, its serial number, and its board.
REVISION = Read(indices.IDENTITY, 3)
SERIAL = Read(indices.IDENTITY, 4)
BOARD = Read(indices.UPDATE, 3)

#: Errors of communication, which are over when communication is: the host's heartbeat lost, bus
#: off, no setpoint. With all others drives shut off for a reason that a person has to look after.
PASSING_CODES = frozenset((0, 0x8130, 0x8140, 0x8250))


class Identification:
    """Reads a cell's revision and serial number; after `begin_again` its errors and `kept` besides.

    `done` is whether all answers are there. `failure` is why they do not come, None as long as they
    may. `refusal` is the reason to refuse a cell that comes back, None to take it. `serial` is the
    expected serial number, None for any. With `asks_board` it also reads the board. Some
    boards cannot steer. `kept` is a setting of this run, which a restart loses.
    """

    def __init__(
        self,
        node_id: int,
        axes: int,
        serial: int | None = None,
        *,
        kept: Setting,
        asks_board: bool = False,
    ) -> None:
        self._node_id = node_id
        self._serial = serial
        self._kept = kept
        self._errors = tuple(
            Read(indices.ERROR_CODE + axis * indices.AXIS_OFFSET, 0) for axis in range(axes)
        )
        self._first: Mapping[Place, int] = {}
        self._identity = (REVISION, SERIAL, BOARD) if asks_board else (REVISION, SERIAL)
        self._client = SdoClient(node_id, self._identity, attempts=PATIENT)

    @property
    def done(self) -> bool:
        """See above."""
        return self._client.done

    @property
    def failure(self) -> str | None:
        """See above."""
        return self._client.failure

    @property
    def other_protocol(self) -> str | None:
        """The message about another protocol revision; None if the revision fits."""
        revision = self._client.answers.get((REVISION.index, REVISION.sub))
        return None if revision is None else other_protocol(revision)

    @property
    def other_board(self) -> str | None:
        """The message about an unexpected serial number; None if the number fits."""
        serial = self._client.answers.get((SERIAL.index, SERIAL.sub))
        if None in (serial, self._serial) or serial == self._serial:
            return None
        return f"has serial number {serial:08X}, but the array file lists {self._serial:08X} there"

    @property
    def cannot_steer(self) -> str | None:
        """Why its board cannot steer, if that was asked; None where it can."""
        board = self._client.answers.get((BOARD.index, BOARD.sub))
        return None if board is None else boards.cannot_steer(board)

    @property
    def shut_off(self) -> bool:
        """Whether a drive has shut off, for any reason; after `begin_again`."""
        return any(self._codes)

    @property
    def stopped(self) -> bool:
        """Whether the cell was stopped after a drive had shut off; after `begin_again`."""
        return STOPPED_MEANWHILE in self._codes

    @property
    def has_lost_settings(self) -> bool:
        """Whether the cell has lost the settings of this run; after `begin_again`."""
        return self._client.answers.get((self._kept.index, self._kept.sub)) != self._kept.value

    @property
    def _codes(self) -> list[int]:
        """The codes of the errors that stand, 0 for none; after `begin_again`."""
        return [self._client.answers.get((read.index, read.sub), 0) for read in self._errors]

    @property
    def refusal(self) -> str | None:
        """See above; an error stays in a cell's drive until it is reset, or the cell restarts."""
        if self.other_protocol:
            return f"it {self.other_protocol}"
        if self.other_board:
            return f"it {self.other_board}"
        if self.cannot_steer:
            return f"it {self.cannot_steer}"
        answers = self._client.answers
        for read, meaning in ((SERIAL, "serial number"), (REVISION, "firmware revision")):
            before, now = (each.get((read.index, read.sub)) for each in (self._first, answers))
            if None not in (before, now) and before != now:
                return f"its {meaning} is 0x{now:08X}, and was 0x{before:08X}: another cell"
        for axis, code in enumerate(self._codes, 1):
            if code not in PASSING_CODES:
                return error_text(axis, code)
        return None

    def begin_again(self) -> None:
        """Read anew; the answers to the first read are kept for comparison."""
        if self._client.done and not self._first:
            self._first = dict(self._client.answers)
        reads = (*self._identity, *self._errors, Read(self._kept.index, self._kept.sub))
        self._client = SdoClient(self._node_id, reads, attempts=PATIENT)

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The request to send now, if any."""
        return self._client.poll(now_s)

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell; one to another request is ignored."""
        self._client.on_response(data)


#: How long the host may be silent: two heartbeats may get lost, and the next be 3 ms late.
HEARTBEAT_LIMIT_MS = round(3e3 * WATCHED_HEARTBEAT_S) + 3

_CONSUMED = (indices.CONSUMER_TIMES, 1)
_TAKEOVER = (indices.LEASE, 3)
_CONTROL = (indices.CONTROL, 0)
#: In the order in which they are taken back: the host's silence must not count by then.
PLACES = (_CONSUMED, _CONTROL, _TAKEOVER)


def steering_settings() -> tuple[Setting, ...]:
    """Settings of a cell that has its place; after the last one the cell steers."""
    return (
        Setting(*_CONSUMED, cob.HOST_NODE << 16 | HEARTBEAT_LIMIT_MS),
        Setting(*_TAKEOVER, 1),
        Setting(*_CONTROL, 1),
    )


def taken_back() -> Iterator[Setting]:
    """Settings that undo these."""
    return (Setting(*place, ENTRIES[place].default) for place in PLACES)


#: Where a cell reports the signature of its settings.
SIGNATURE = Read(indices.SIGNATURE, 0)
_STORED: Mapping[Place, Entry] = {
    place: entry for place, entry in ENTRIES.items() if entry.stored is not None
}
#: All settings count.
NOTHING: Mapping[Place, int] = {}
#: How many differences a message lists.
_LISTED_DIFFERENCES = 4


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
        more = len(differing) - _LISTED_DIFFERENCES
        listed = ", ".join(differing[:_LISTED_DIFFERENCES]) + (
            f" and {more} more" if more > 0 else ""
        )
        if listed or any(found[place] != self.values[place] for place in self._spare):
            return listed
        return "its signature (0x3005) is not that of its settings"


def _signature(values: Mapping[Place, int]) -> int:
    crc = 0
    for place, value in values.items():
        kind = _STORED[place].type
        crc = crc32(value.to_bytes(kind.size, "little", signed=kind.low < 0), crc)
    return crc


class SetUp:
    """Writes settings, then compares the signature of all stored settings; once a bring-up.

    If it differs, all stored settings are read. Settings that an earlier run of cells that steer
    left behind are set back. `verified` is whether all settings are as expected. `failure` is why a
    transfer cannot be done, and `mismatch` the other differences. Both are None as long as there is
    nothing.
    """

    def __init__(
        self, node_id: int, settings: tuple[Setting, ...], configuration: Configuration
    ) -> None:
        self.verified = False
        self.mismatch: str | None = None
        self._configuration = configuration
        self._client = SdoClient(node_id, (*settings, SIGNATURE), attempts=PATIENT)
        self._corrected = False

    @property
    def failure(self) -> str | None:
        """See above."""
        return self._client.failure

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The request to send now, if any."""
        return self._client.poll(now_s)

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell; one to another request is ignored."""
        self._client.on_response(data)
        if self._client.done and not self.verified:
            self._verify()

    def _verify(self) -> None:
        """Compare the signature; if it differs, read all stored settings."""
        answers = self._client.answers
        values = self._configuration.values
        if self._configuration.accepts(answers[SIGNATURE.index, SIGNATURE.sub]):
            self.verified = True
        elif not answers.keys() >= values.keys():
            self._client.append(Read(*place) for place in values)
        elif not self._corrected and (left := self._left_by_cells()):
            self._corrected = True
            reads = (Read(each.index, each.sub) for each in left)
            self._client.append((*left, *reads, SIGNATURE))
        else:
            self.mismatch = self._configuration.differences(answers) or None
            self.verified = self.mismatch is None

    def _left_by_cells(self) -> list[Setting]:
        """Settings that undo an unfinished run in which cells steered."""
        answers, values = self._client.answers, self._configuration.values
        return [
            Setting(*place, values[place]) for place in PLACES if answers[place] != values[place]
        ]
