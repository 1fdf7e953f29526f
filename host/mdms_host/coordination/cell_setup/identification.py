"""Identity of a cell: read at its bring-up, and compared when it comes back."""

from collections.abc import Iterator, Mapping

from mdms_host.can_link import boards
from mdms_host.can_link.remote_cell import other_protocol
from mdms_host.can_link.sdo_client import PATIENT, Read, SdoClient
from mdms_host.places import Place
from mdms_protocol import indices
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.emergencies import error_text

#: Where a cell reports the revision of its object table, its serial number, and its board.
REVISION = Read(indices.IDENTITY, 3)
SERIAL = Read(indices.IDENTITY, 4)
BOARD = Read(indices.UPDATE, 3)

#: Errors of communication, which are over when communication is: the host's heartbeat lost, bus
#: off, no setpoint. With all others drives shut off for a reason that a person has to look after.
PASSING_CODES = frozenset((0, 0x8130, 0x8140, 0x8250))


class Identification:
    """Reads a cell's revision and serial number; after `begin_again` its errors besides.

    `done` is whether all answers are there. `failure` is why they do not come, None as long as they
    may. `refusal` is the reason to refuse a cell that comes back, None to take it. `serial` is the
    expected serial number, None for any. With `asks_board` it also reads the board. Some
    boards cannot steer.
    """

    def __init__(
        self, node_id: int, axes: int, serial: int | None = None, *, asks_board: bool = False
    ) -> None:
        self._node_id = node_id
        self._serial = serial
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
        for axis, read in enumerate(self._errors, 1):
            code = answers.get((read.index, read.sub), 0)
            if code not in PASSING_CODES:
                return error_text(axis, code)
        return None

    def begin_again(self) -> None:
        """Read anew; the answers to the first read are kept for comparison."""
        if self._client.done and not self._first:
            self._first = dict(self._client.answers)
        self._client = SdoClient(self._node_id, (*self._identity, *self._errors), attempts=PATIENT)

    def poll(self, now_s: float) -> Iterator[Frame]:
        """The request to send now, if any."""
        return self._client.poll(now_s)

    def on_response(self, data: bytes) -> None:
        """Take in an answer of the cell; one to another request is ignored."""
        self._client.on_response(data)
