"""Gives cells their node ids by the layer setting services (CiA 305), one request at a time.

Unlike the master of `canopen`, which halves all 128 bits of an identity with a pause at each, this
one first compares all but the serial number with ours, and then searches the serial number alone.
"""

from collections.abc import Callable, Iterable, Sequence
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
_TIMEOUTS_S = (0.02, 0.05, 0.1, 0.2, 0.4)
#: The share of it that has to pass without another answer before the next request.
_SETTLING = 0.25
#: How long to wait whether cells are there that are not expected [s].
_BESIDE_S = 0.1
#: How often a request is sent while no answer comes: frames may be lost.
_ASKED = 4
#: How often each question of a search is sent at once: most get no answer, and none is waited for
#: twice. Of two frames lost in a hundred, one question of six frames in 3,000 fails.
_COPIES = 4
#: For requests that are answered as a rule, and for those that write to flash.
_ANSWER_S = 0.5
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

    In a search most requests get no answer, so each waits for a short time.
    """

    def __init__(self, send: Callable[[Frame], None]) -> None:
        self._send_frame = send
        self._answers: SimpleQueue[bytes] = SimpleQueue()
        self._timeout_s = _TIMEOUTS_S[0]

    def on_response(self, data: bytes) -> None:
        """Take in a frame of `cob.LSS_RESPONSE`."""
        self._answers.put(data)

    def any_blank(self) -> bool:
        """Whether a cell without node id is on the bus."""
        question = [(lss.IDENTIFY_UNCONFIGURED, b"")]
        return self._ask(question, lss.UNCONFIGURED, _ANSWER_S) is not None

    def find_blank(self) -> list[LssAddress]:
        """All cells without node id, by their identities. Raises LssError.

        A fast scan finds the lowest of them, which then keeps out of the next scan.
        """
        self._take_back()
        for timeout_s in _TIMEOUTS_S:
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
        if not self._switch(address):
            raise LssError(f"no cell answers to serial number {address.serial:08X}")
        if self._others_answer():
            self.leave()
            raise LssError(f"two cells have the serial number {address.serial:08X}")

    def pending_node_id(self) -> int:
        """The node id that the selected cell has, or takes next, `cob.NODE_NONE` for none.

        Raises LssError.
        """
        return self._result(lss.INQUIRE_NODE_ID, b"", _ANSWER_S)

    def find_beside(self, known: Iterable[int]) -> list[int]:
        """Serial numbers of cells beside those known, whatever their node ids, in order.

        Cells answer by their serial numbers though they have lost the fight for a node id, or
        answer SDO at the same time as another. Raises LssError where more answer than a bus has.
        """
        self._timeout_s = _BESIDE_S
        self.leave()
        bounds = [-1, *sorted(set(known)), 1 << 32]
        gaps = [(below + 1, above - 1) for below, above in pairwise(bounds)]
        found: list[int] = []
        while gaps:
            low, high = gaps.pop()
            serial = self._one_in(low, high)
            if serial is not None:
                found.append(serial)
                gaps += [(low, serial - 1), (serial + 1, high)]
            if len(found) > cob.NODE_MAX:
                raise LssError("something on the bus answers to any serial number")
        return sorted(found)

    def _one_in(self, low: int, high: int) -> int | None:
        """A serial number in a range, both ends included, by halving it; None without any."""
        if low > high or not self._any_in(low, high):
            return None
        silent = 0
        while low < high and silent < _ASKED:
            middle = (low + high) // 2
            if self._any_in(low, middle):
                high = middle
            elif self._any_in(middle + 1, high):
                low = middle + 1
            else:
                silent += 1
        return low if low == high else None

    def _any_in(self, low: int, high: int) -> bool:
        """Whether a cell of our kind has a serial number in a range."""
        numbers = (VENDOR_ID, PRODUCT_CODE, 0, 0xFFFFFFFF, low, high)
        question = [
            (lss.IDENTIFY_VENDOR + step, number.to_bytes(4, "little"))
            for step, number in enumerate(numbers)
        ]
        return self._agrees(question, self._timeout_s)

    def set_node_id(self, node_id: int) -> None:
        """Give the selected cell a node id, or `cob.NODE_NONE`. Raises LssError.

        The search of another master puts cells that it finds into the configuration state. If one
        of them takes the id as well, neither keeps it.
        """
        result = self._result(lss.CONFIGURE_NODE_ID, bytes((node_id,)), _ANSWER_S)
        self._expect_ok(lss.CONFIGURE_NODE_ID, result)
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
        # Nobody answers.
        for _ in range(_COPIES):
            self._send(lss.SWITCH_GLOBAL, bytes((lss.WAITING,)))

    def _take_back(self) -> None:
        """End the configuration of a master that was killed: an id that is not stored counts not.

        The cell would boot with it, and lose it with its power.
        """
        self._send(lss.CONFIGURE_NODE_ID, bytes((cob.NODE_NONE,)))
        self.leave()
        self._timeout_s = _ANSWER_S
        self._others_answer()

    def _scan_all(self) -> list[LssAddress]:
        found: list[LssAddress] = []
        # Lost frames are no sign that all are found.
        while any(self._matches(0, lss.SCAN_ALL, 0, 0, _ANSWER_S) for _ in range(_ASKED)):
            address = self._find_lowest()
            # A cell that was mistaken for another is found again, or another before it.
            if found and address <= found[-1]:
                raise _ContradictionError
            found.append(address)
        return found

    def _find_lowest(self) -> LssAddress:
        """The lowest identity; its cell answers no question of the scan from now on."""
        numbers = [*_KNOWN] if self._reach(_KNOWN) else []
        while len(numbers) <= _SERIAL:
            numbers.append(self._search(numbers))
        address = LssAddress(*numbers)
        # Once a cell is found, it says so no more.
        if not self._reach(numbers) and not self._switch(address):
            raise _ContradictionError
        return address

    def _reach(self, numbers: Sequence[int]) -> bool:
        """Whether a blank cell has these first parts; the next question is about the part after.

        A cell says once that a part agrees. So all are asked again where an answer is missing.
        """
        return any(
            self._matches(0, lss.SCAN_ALL, 0, 0)
            and all(
                self._matches(number, 0, part, (part + 1) % (_SERIAL + 1))
                for part, number in enumerate(numbers)
            )
            for _ in range(_ASKED)
        )

    def _search(self, numbers: Sequence[int]) -> int:
        """The next part of the lowest identity that begins with these."""
        if not self._reach(numbers):
            raise _ContradictionError
        part, number = len(numbers), 0
        for bit in reversed(range(32)):
            if not self._matches(number, bit, part, part):
                number |= 1 << bit
        return number

    def _matches(
        self, number: int, bit: int, part: int, following: int, timeout_s: float | None = None
    ) -> bool:
        """Whether a blank cell has a part of its identity that agrees down to this bit."""
        data = number.to_bytes(4, "little") + bytes((bit, part, following))
        return self._agrees([(lss.FAST_SCAN, data)], timeout_s or self._timeout_s)

    def _agrees(self, question: Sequence[tuple[int, bytes]], timeout_s: float) -> bool:
        """Whether a cell identifies itself to a question of a search."""
        answer = self._request([*question] * _COPIES, timeout_s)
        found = answer is not None and answer[0] == lss.IDENTIFIED
        if found:
            self._others_answer()
        return found

    def _others_answer(self) -> bool:
        """Whether more cells answer, each in its own time; the next request waits for that."""
        count = 0
        with suppress(Empty):
            while True:
                self._answers.get(timeout=self._timeout_s * _SETTLING)
                count += 1
        return count > 0

    def _switch(self, address: LssAddress) -> bool:
        """Whether a cell with this address answers, which is in the configuration state then."""
        numbers = (number.to_bytes(4, "little") for number in address)
        question = [(lss.SWITCH_VENDOR + part, data) for part, data in enumerate(numbers)]
        return self._ask(question, lss.SWITCHED, _ANSWER_S) is not None

    def _result(self, command: int, data: bytes, timeout_s: float) -> int:
        """The first byte that the selected cell answers with."""
        answer = self._ask([(command, data)], command, timeout_s)
        if answer is None:
            raise LssError("the selected cell does not answer")
        return answer[1]

    def _expect_ok(self, command: int, result: int) -> None:
        if result != lss.OK:
            raise LssError(f"the selected cell refuses LSS command 0x{command:02X}: {result}")

    def _ask(
        self, messages: Sequence[tuple[int, bytes]], expected: int, timeout_s: float
    ) -> bytes | None:
        """The answer that begins with this byte; None without it, however often it is asked."""
        for _ in range(_ASKED):
            answer = self._request(messages, timeout_s)
            if answer is not None and answer[0] == expected:
                return answer
        return None

    def _request(self, messages: Sequence[tuple[int, bytes]], timeout_s: float) -> bytes | None:
        """The first answer of eight bytes, None if there is none in time."""
        while not self._answers.empty():
            self._answers.get()
        for message in messages:
            self._send(*message)
        try:
            answer = self._answers.get(timeout=timeout_s)
        except Empty:
            return None
        return answer if len(answer) == 8 else None

    def _send(self, command: int, data: bytes) -> None:
        payload = bytes((command,)) + data
        self._send_frame(Frame(cob.LSS_REQUEST, payload + bytes(8 - len(payload))))
