"""Gives cells their node ids by the layer setting services (CiA 305), one request at a time.

Unlike the master of `canopen`, which halves all 128 bits of an identity with a pause at each, this
one first compares all but the serial number with ours, and then searches the serial number alone.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from queue import Empty, SimpleQueue
from typing import NamedTuple

from mdms_protocol.codecs import cob, lss
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import PRODUCT_CODE, REVISION, VENDOR_ID

_KNOWN = (VENDOR_ID, PRODUCT_CODE, REVISION)
_SERIAL = 3
#: How long to wait for an answer [s], one search after the other: a late answer spoils a search.
TIMEOUTS_S = (0.02, 0.05, 0.1, 0.2, 0.4)
#: The share of it that has to pass without another answer before the next request.
_SETTLING = 0.25
#: How long to wait whether cells are there that are not expected [s].
_BESIDE_S = 0.1
#: How often blank cells are asked whether there are any.
_ASKED = 3
#: For requests that are answered as a rule, and for those that write to flash.
ANSWER_S = 0.5
_STORE_S = 3.0


class LssError(Exception):
    """A cell has refused, or not answered, an LSS request."""


class _ContradictionError(Exception):
    """Answers contradict each other: one came after its time."""


class LssAddress(NamedTuple):
    """The identity of a cell, as in its object 0x1018."""

    vendor_id: int
    product_code: int
    revision: int
    serial: int


class LssMaster:
    """Finds, selects and configures cells; `on_response` may be called from another thread.

    In a search, where most requests get no answer, each waits for one of `timeouts_s`.
    """

    def __init__(
        self,
        send: Callable[[Frame], None],
        *,
        timeouts_s: Sequence[float] = TIMEOUTS_S,
        answer_s: float = ANSWER_S,
    ) -> None:
        self._send_frame = send
        self._answers: SimpleQueue[bytes] = SimpleQueue()
        self._timeouts_s = timeouts_s
        self._timeout_s = timeouts_s[0]
        self._answer_s = answer_s

    def on_response(self, data: bytes) -> None:
        """Take in a frame of `cob.LSS_RESPONSE`."""
        self._answers.put(data)

    def any_blank(self) -> bool:
        """Whether a cell without node id is on the bus."""
        answer = self._request(lss.IDENTIFY_UNCONFIGURED, b"", self._answer_s)
        return answer is not None and answer[0] == lss.UNCONFIGURED

    def find_blank(self) -> list[LssAddress]:
        """All cells without node id, by their identities. Raises LssError.

        A fast scan finds the lowest of them, which then keeps out of the next scan.
        """
        self._take_back()
        for timeout_s in self._timeouts_s:
            self._timeout_s = timeout_s
            self.leave()
            try:
                return self._scan_all()
            except _ContradictionError:
                continue
            finally:
                self.leave()
        raise LssError("the answers to the LSS fast scan contradict each other; is the bus busy?")

    def select(self, address: LssAddress) -> None:
        """Put one cell, and no other, into the configuration state. Raises LssError."""
        self.leave()
        for part, number in enumerate(address[:_SERIAL]):
            self._send(lss.SWITCH_VENDOR + part, number.to_bytes(4, "little"))
        answer = self._request(
            lss.SWITCH_SERIAL, address.serial.to_bytes(4, "little"), self._answer_s
        )
        if answer is None or answer[0] != lss.SWITCHED:
            raise LssError(f"no cell answers to serial number {address.serial:08X}")
        if self._others_answer():
            self.leave()
            raise LssError(f"two cells have the serial number {address.serial:08X}")

    def pending_node_id(self) -> int:
        """The node id that the selected cell has, or takes next, `cob.NODE_NONE` for none.

        Raises LssError.
        """
        answer = self._request(lss.INQUIRE_NODE_ID, b"", self._answer_s)
        if answer is None or answer[0] != lss.INQUIRE_NODE_ID:
            raise LssError("the selected cell does not answer")
        return answer[1]

    def find_beside(self, known: Iterable[int]) -> list[int]:
        """Serial numbers of cells beside those known, whatever their node ids, in order.

        Cells answer by their serial numbers though they have lost the fight for a node id, or
        answer SDO at the same time as another. Raises LssError where more answer than a bus has.
        """
        self._timeout_s = _BESIDE_S
        self.leave()
        bounds = [-1, *sorted(set(known)), 1 << 32]
        found: list[int] = []
        for below, above in pairwise(bounds):
            for serial in self._serials(below + 1, above - 1):
                found.append(serial)
                if len(found) > cob.NODE_MAX:
                    raise LssError("something on the bus answers to any serial number")
        return found

    def _serials(self, low: int, high: int) -> Iterator[int]:
        """The serial numbers in a range, both ends included, by halving it."""
        if low > high or not self._any_in(low, high):
            return
        if low == high:
            yield low
            return
        middle = (low + high) // 2
        yield from self._serials(low, middle)
        yield from self._serials(middle + 1, high)

    def _any_in(self, low: int, high: int) -> bool:
        """Whether a cell of our kind has a serial number in a range."""
        *bounds, last = (VENDOR_ID, PRODUCT_CODE, 0, 0xFFFFFFFF, low, high)
        for step, number in enumerate(bounds):
            self._send(lss.IDENTIFY_VENDOR + step, number.to_bytes(4, "little"))
        answer = self._request(
            lss.IDENTIFY_SERIAL_HIGH, last.to_bytes(4, "little"), self._timeout_s
        )
        found = answer is not None and answer[0] == lss.IDENTIFIED
        if found:
            self._others_answer()
        return found

    def set_node_id(self, node_id: int) -> None:
        """Give the selected cell a node id, or `cob.NODE_NONE`. Raises LssError.

        The search of another master puts cells that it finds into the configuration state. If one
        of them takes the id as well, neither keeps it.
        """
        self._configure(lss.CONFIGURE_NODE_ID, bytes((node_id,)), self._answer_s)
        if self._others_answer():
            self._send(lss.CONFIGURE_NODE_ID, bytes((cob.NODE_NONE,)))
            self.leave()
            raise LssError(
                f"more than one cell has taken node id {node_id}: does another host look for cells "
                "at the same time? Run the same again when it has ended"
            )

    def store(self) -> bool:
        """Have the selected cell keep its node id; whether its board can. Raises LssError."""
        result = self._result(lss.STORE, b"", _STORE_S)
        if result == lss.STORE_UNSUPPORTED:
            return False
        self._expect_ok(lss.STORE, result)
        return True

    def leave(self) -> None:
        """End the configuration of all cells; those that were blank boot with their node ids."""
        self._send(lss.SWITCH_GLOBAL, bytes((lss.WAITING,)))

    def _take_back(self) -> None:
        """End the configuration of a master that was killed: an id that is not stored counts not.

        The cell would boot with it, and lose it with its power.
        """
        self._send(lss.CONFIGURE_NODE_ID, bytes((cob.NODE_NONE,)))
        self.leave()
        self._timeout_s = self._answer_s
        self._others_answer()

    def _scan_all(self) -> list[LssAddress]:
        found: list[LssAddress] = []
        # Lost frames are no sign that all are found.
        while any(self._matches(0, lss.SCAN_ALL, 0, 0, self._answer_s) for _ in range(_ASKED)):
            address = LssAddress(*(self._search(part) for part in range(_SERIAL + 1)))
            # A cell that was mistaken for another is found again, or another before it.
            if found and address <= found[-1]:
                raise _ContradictionError
            found.append(address)
        return found

    def _search(self, part: int) -> int:
        """A part of the lowest identity; the next request is about the part that follows."""
        following = (part + 1) % (_SERIAL + 1)
        if part < _SERIAL and self._matches(_KNOWN[part], 0, part, following):
            return _KNOWN[part]
        number = 0
        for bit in reversed(range(32)):
            if not self._matches(number, bit, part, part):
                number |= 1 << bit
        if not self._matches(number, 0, part, following, self._answer_s):
            raise _ContradictionError
        return number

    def _matches(
        self, number: int, bit: int, part: int, following: int, timeout_s: float | None = None
    ) -> bool:
        """Whether a blank cell has a part of its identity that agrees down to this bit."""
        data = number.to_bytes(4, "little") + bytes((bit, part, following))
        answer = self._request(lss.FAST_SCAN, data, timeout_s or self._timeout_s)
        if answer is None or answer[0] != lss.IDENTIFIED:
            return False
        self._others_answer()
        return True

    def _others_answer(self) -> bool:
        """Whether more cells answer, each in its own time; the next request waits for that."""
        count = 0
        with suppress(Empty):
            while True:
                self._answers.get(timeout=self._timeout_s * _SETTLING)
                count += 1
        return count > 0

    def _configure(self, command: int, data: bytes, timeout_s: float) -> None:
        self._expect_ok(command, self._result(command, data, timeout_s))

    def _result(self, command: int, data: bytes, timeout_s: float) -> int:
        """The error code that the selected cell answers with."""
        answer = self._request(command, data, timeout_s)
        if answer is None or answer[0] != command:
            raise LssError("the selected cell does not answer")
        return answer[1]

    def _expect_ok(self, command: int, result: int) -> None:
        if result != lss.OK:
            raise LssError(f"the selected cell refuses LSS command 0x{command:02X}: {result}")

    def _request(self, command: int, data: bytes, timeout_s: float) -> bytes | None:
        """The first answer of eight bytes, None if there is none in time."""
        while not self._answers.empty():
            self._answers.get()
        self._send(command, data)
        try:
            answer = self._answers.get(timeout=timeout_s)
        except Empty:
            return None
        return answer if len(answer) == 8 else None

    def _send(self, command: int, data: bytes) -> None:
        payload = bytes((command,)) + data
        self._send_frame(Frame(cob.LSS_REQUEST, payload + bytes(8 - len(payload))))
