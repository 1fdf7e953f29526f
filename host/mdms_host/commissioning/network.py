"""Single cells by `canopen`: which there are, their identities, and their settings.

`canopen` gets its frames from our link, so that its reader outlives garbage on the line.
"""

import logging
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from queue import SimpleQueue
from typing import TypeVar

import can
import canopen

from mdms_host.can_link.link import Link, hand_over
from mdms_host.can_link.remote_cell import UPDATE_RUNS, other_protocol, takes_firmware
from mdms_host.clock import Clock
from mdms_host.commissioning.lss_master import LssMaster
from mdms_model.participant import Participant
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import DEVICE_NAME, ENTRIES, PRODUCT_CODE, VENDOR_ID
from mdms_protocol.emergencies import LOW_SUPPLY, VOLTAGE_ERROR, code_text
from mdms_protocol.entry import Entry

_NAMES = {
    nmt.STOP: "'stop'",
    nmt.ENTER_PRE_OPERATIONAL: "'enter pre-operational', as mdms stop does",
    nmt.RESET_NODE: "'reset node'",
    nmt.RESET_COMMUNICATION: "'reset communication'",
}


class ForeignStops:
    """Notes them as they come in, by the node that they are for.

    An emergency stop is one of them: most cells lack their supply, or have lacked it, or restarted.
    Letting go of it is to turn no wheel.
    """

    def __init__(self) -> None:
        self._codes: dict[int, int] = {}
        self._has_supply: dict[int, bool] = {}
        self._was_cut: set[int] = set()
        #: The nodes that have restarted since they were heard first.
        self.restarted: set[int] = set()

    def on_frame(self, frame: Frame) -> None:
        """Note a command, a heartbeat, and an emergency; any other frame is left alone."""
        if frame.can_id == cob.NMT and len(frame.data) == 2 and frame.data[0] in _NAMES:
            self._codes[frame.data[1]] = frame.data[0]
        node = frame.can_id & cob.NODE_MAX
        is_cell = node not in (0, cob.HOST_NODE)
        if is_cell and frame.can_id == cob.HEARTBEAT_BASE + node:
            if node in self._has_supply and nmt.decode_heartbeat(frame.data) == nmt.INITIALISING:
                self._was_cut.add(node)
                self.restarted.add(node)
            self._has_supply.setdefault(node, True)
        elif is_cell and frame.can_id == cob.EMCY_BASE + node and len(frame.data) == _WHOLE:
            self.note_supply(node, frame.data[2])

    def note_supply(self, node_id: int, error_register: int) -> None:
        """Note whether a cell has its supply, by its error register (0x1001)."""
        self._has_supply[node_id] = not error_register & VOLTAGE_ERROR
        if error_register & VOLTAGE_ERROR:
            self._was_cut.add(node_id)

    def turns_agreed(self) -> None:
        """A person lets wheels turn from now on: only supplies that are lost later were cut."""
        self._was_cut.clear()

    def forget(self, node_id: int) -> None:
        """A node answers no more; its next heartbeat brings it back."""
        self._has_supply.pop(node_id, None)

    @property
    def heard(self) -> list[int]:
        """The nodes that have sent a heartbeat or an emergency."""
        return sorted(self._has_supply)

    def emergency_stop(self, node_id: int) -> str | None:
        """The emergency stop that the other cells report; None without one.

        A cell itself may measure wrongly.
        """
        # Frames come in by another thread.
        others = dict(self._has_supply)
        others.pop(node_id, None)
        low = [node for node, has in others.items() if not has or node in self._was_cut]
        if 2 * len(low) <= len(others):
            return None
        return f"an emergency stop: {code_text(LOW_SUPPLY)}, or a restart, at node {ranges(low)}"

    def reason(self, node_id: int | None = None) -> str | None:
        """Which command another host has sent to a node, or to all; None if it has sent none.

        Without a node id, to any.
        """
        for node in self._codes if node_id is None else (node_id, nmt.ALL_NODES):
            if node in self._codes:
                return f"another host has sent {_NAMES[self._codes[node]]}"
        return None


#: A slow adapter on a busy machine is to be in time. A cell aborts a transfer after 1 s.
_ANSWER_S = 0.5
#: Attempts at a request. Of two frames lost in a hundred, one read in 400,000 fails.
_ATTEMPTS = 4
#: Refusals of a valid step of a transfer: a request of another program has broken it off.
_INTERRUPTED = (sdo.UNKNOWN_COMMAND, sdo.TOGGLE_NOT_ALTERNATED, sdo.INVALID_SEQUENCE)
#: Erasing a sector of flash may take a board this long.
_FLASH_S = 3.0
#: A cell writes no flash while a wheel brakes: 2 s at most (0x3004), unless that was set longer.
_BRAKES_S = 2.5
#: A reset, and the time for which a cell makes sure that its node id is its own.
_BOOT_S = 3.0
_LOOK_S = 0.005
#: Refusals of a node that has no such object.
_ABSENT = (sdo.NO_SUCH_OBJECT, sdo.NO_SUCH_SUB_INDEX)
#: Bytes of an SDO answer, and of an emergency.
_WHOLE = 8
#: Listen for so long before anything is asked [s].
HEAR_S = 0.1
#: No entry that is read here has more bytes.
_LONGEST = 1024


_Result = TypeVar("_Result")


class CommissioningError(Exception):
    """A request to a cell has failed."""


class RefusedError(CommissioningError):
    """The cell answered, and refused; the message has its reason, and `code` is its abort code."""

    def __init__(self, message: str = "", code: int = 0) -> None:
        super().__init__(message)
        self.code = code


class SilentError(CommissioningError):
    """The cell did not answer."""


class UpdateRunsError(CommissioningError):
    """Firmware comes in over the bus, and a request to a cell would break that off."""


@dataclass(frozen=True, slots=True)
class Identity:
    """The identity that a node reports."""

    name: str
    software: str
    vendor_id: int
    product_code: int
    revision: int
    serial: int

    @property
    def is_cell(self) -> bool:
        """Whether it is a cell of our kind."""
        ours = (DEVICE_NAME, VENDOR_ID, PRODUCT_CODE)
        return (self.name, self.vendor_id, self.product_code) == ours

    @property
    def other_protocol(self) -> str | None:
        """The complaint about a cell that speaks another revision of the protocol."""
        return other_protocol(self.revision)


#: That of a node that tells none.
NO_IDENTITY = Identity("?", "", 0, 0, 0, 0)


class Commissioning:
    """All nodes of a bus, one request at a time; the end of its `with` statement closes the bus.

    Its calls raise DeviceGoneError when the bus is gone.
    """

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        # canopen logs the errors that it also raises.
        logging.getLogger("canopen").setLevel(logging.CRITICAL)
        self.states: dict[int, int] = {}
        self.foreign_stops = ForeignStops()
        self._booted: set[int] = set()
        self._host_node_answers = False
        self._update_runs = False
        self._arrivals: SimpleQueue[tuple[Frame, float]] | None = None
        self._clock = clock
        self._nodes: dict[int, canopen.RemoteNode] = {}
        # The link delivers frames from its first moment on.
        self._network = _LinkedNetwork(self._send)
        self.lss = LssMaster(self._send)
        self.link = Link(bus, clock, self._on_frame)

    def __enter__(self) -> "Commissioning":
        return self

    def __exit__(self, *_error: object) -> None:
        self.link.close()

    def find(self, listen_s: float = 0.3) -> list[int]:
        """Node ids that tell of themselves within the time; the device type of all is requested.

        The host's own is among them if a node answers there: a cell that has it. Raises
        UpdateRunsError.
        """
        self._clock.sleep(HEAR_S)
        self.refuse_update()
        # A node that has another id by now, or is gone, counts no more.
        self._network.scanner.nodes.clear()
        self._network.scanner.search(cob.NODE_MAX)
        self._clock.sleep(listen_s)
        self.link.check()
        found = set(self._network.scanner.nodes)
        if not self._host_node_answers:
            # Another host has a heartbeat there, and answers nothing.
            found.discard(cob.HOST_NODE)
        return sorted(found)

    def refuse_update(self) -> None:
        """Raises UpdateRunsError where a cell has taken firmware since the bus was opened."""
        if self._update_runs:
            raise UpdateRunsError(
                f"{UPDATE_RUNS}, and a request would break that off; let mdms flash --bus end first"
            )

    @property
    def other_host(self) -> bool:
        """Whether a host other than this one has sent its heartbeat, and no cell answers there."""
        return cob.HOST_NODE in self.states and not self._host_node_answers

    def drive(self, participant: Participant, over: Callable[[], bool]) -> None:
        """Bring a participant onto the same bus until it is over, about which is asked often.

        Raises DeviceGoneError.
        """
        arrivals: SimpleQueue[tuple[Frame, float]] = SimpleQueue()
        self._arrivals = arrivals
        try:
            while not over():
                self.link.check()
                now_s = self._clock.now_s()
                if participant.wake_s <= now_s:
                    self.link.send_polled(participant, now_s)
                wait_s = participant.wake_s - self._clock.now_s()
                hand_over(arrivals, wait_s, participant.on_frame)
        finally:
            self._arrivals = None

    def identity(self, node_id: int) -> Identity:
        """The identity of a node; one that lacks an object of it, as no cell does, is called '?'.

        Raises SilentError, RefusedError.
        """
        try:
            name = self.read_text(node_id, indices.DEVICE_NAME)
            software = self.read_text(node_id, indices.SOFTWARE_VERSION)
            numbers = [self.read(node_id, indices.IDENTITY, sub) for sub in range(1, 5)]
        except RefusedError as refusal:
            if refusal.code not in _ABSENT:
                raise
            return NO_IDENTITY
        return Identity(name, software, *numbers)

    def read(self, node_id: int, index: int, sub: int = 0) -> int:
        """An integer of the object table. Raises SilentError, RefusedError, KeyError."""
        entry = _entry(index, sub)
        data = self._upload(node_id, entry)
        return int.from_bytes(data, "little", signed=entry.type.low < 0)

    def read_text(self, node_id: int, index: int, sub: int = 0) -> str:
        """A text of the object table. Raises SilentError, RefusedError, KeyError.

        Any node may say anything: what no person can read becomes a question mark.
        """
        text = self._upload(node_id, _entry(index, sub)).decode("ascii", "replace")
        return "".join(each if each.isprintable() else "?" for each in text)

    def write(self, node_id: int, index: int, sub: int, value: int) -> None:
        """Write an integer. Raises OutOfRangeError before sending, SilentError, RefusedError."""
        entry = _entry(index, sub)
        pdo.check(entry, value)
        data = value.to_bytes(entry.type.size, "little", signed=entry.type.low < 0)
        self._download(node_id, entry, data, _ANSWER_S)

    def write_bytes(self, node_id: int, index: int, sub: int, data: bytes) -> None:
        """Write to an object of any length, which flash may keep. Raises as `write`."""
        self._download(node_id, _entry(index, sub), data, _FLASH_S)

    def store(self, node_id: int) -> None:
        """Have a cell store all its settings (0x1010). Raises SilentError, RefusedError."""
        self._sign(node_id, indices.STORE, b"save")

    def restore_defaults(self, node_id: int) -> None:
        """Erase the stored settings of a cell (0x1011), and restart it with defaults.

        Its node id stays. Raises SilentError, RefusedError.
        """
        self._sign(node_id, indices.RESTORE, b"load")
        self.restart(node_id)

    def restart(self, node_id: int) -> None:
        """Reset a node, and wait until it is back. Raises SilentError."""
        for attempt in range(1, _ATTEMPTS + 1):
            self.expect_boot(node_id)
            self.command(nmt.RESET_NODE, node_id)
            try:
                self.await_boot(node_id)
            except SilentError:
                if attempt == _ATTEMPTS:
                    raise
            else:
                return

    def expect_boot(self, node_id: int) -> None:
        """From now on, a boot-up message of this node counts."""
        self._booted.discard(node_id)

    def refuse_booted(self, node_id: int) -> None:
        """Raises CommissioningError where a node has booted since it was expected to."""
        if node_id in self._booted:
            raise CommissioningError(
                f"node {node_id} restarted meanwhile, and may have the settings of before; look at "
                "its supply, then run the same again"
            )

    def await_boot(self, node_id: int) -> None:
        """Return once the node has booted since it was expected to. Raises SilentError."""
        end_s = self._clock.now_s() + _BOOT_S
        while node_id not in self._booted:
            self.link.check()
            if self._clock.now_s() > end_s:
                raise SilentError(f"node {node_id} has not come up within {_BOOT_S:g} s")
            self._clock.sleep(_LOOK_S)

    def command(self, code: int, node_id: int = nmt.ALL_NODES) -> None:
        """Send an NMT command; raises ValueError for an unknown one."""
        self.link.send(nmt.command(code, node_id))

    def _sign(self, node_id: int, index: int, signature: bytes) -> None:
        """Write what makes 0x1010 and 0x1011 act, to all parameters, once no wheel brakes."""
        end_s = self._clock.now_s() + _BRAKES_S
        while True:
            try:
                return self._download(node_id, _entry(index, 1), signature, _FLASH_S)
            except RefusedError as refusal:
                on = self.states.get(node_id) == nmt.OPERATIONAL
                if refusal.code != sdo.WRONG_STATE or on or self._clock.now_s() >= end_s:
                    raise
            self._clock.sleep(_LOOK_S)

    def _download(self, node_id: int, entry: Entry, data: bytes, answer_s: float) -> None:
        place = (entry.index, entry.sub)
        self._transfer(node_id, entry, lambda node: node.sdo.download(*place, data), answer_s)

    def _upload(self, node_id: int, entry: Entry) -> bytes:
        return self._transfer(node_id, entry, lambda node: _read_all(node, entry), _ANSWER_S)

    def _transfer(
        self,
        node_id: int,
        entry: Entry,
        transfer: Callable[[canopen.RemoteNode], _Result],
        answer_s: float,
    ) -> _Result:
        """Do a transfer, again while it gets no answer or is broken off: each may be repeated.

        Turns `canopen`'s errors into ours, with node and object.
        """
        # Without an object dictionary: ours is `mdms_protocol.dictionary`.
        if node_id not in self._nodes:
            self._nodes[node_id] = self._network.add_node(node_id)
        node = self._nodes[node_id]
        node.sdo.RESPONSE_TIMEOUT = answer_s
        place = f"node {node_id}, 0x{entry.index:04X}:{entry.sub} {entry.name}"
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                return transfer(node)
            except canopen.SdoAbortedError as error:
                if error.code not in _INTERRUPTED or attempt == _ATTEMPTS:
                    raise RefusedError(f"{place}: refused, {error}", error.code) from None
            except canopen.SdoCommunicationError as error:
                if attempt == _ATTEMPTS:
                    raise SilentError(f"{place}: {error}") from None
        raise AssertionError

    def _send(self, frame: Frame) -> None:
        self.link.send(frame)

    def _on_frame(self, frame: Frame, now_s: float) -> None:
        """In the reader's thread: record heartbeats, pass all to participants and `canopen`."""
        self.foreign_stops.on_frame(frame)
        if (arrivals := self._arrivals) is not None:
            arrivals.put((frame, now_s))
        node = frame.can_id - cob.HEARTBEAT_BASE
        state = nmt.decode_heartbeat(frame.data) if 0 < node <= cob.NODE_MAX else None
        if state is not None:
            self.states[node] = state
        if state == nmt.INITIALISING:
            self._booted.add(node)
        if takes_firmware(frame):
            self._update_runs = True
        if frame.can_id == cob.SDO_RESPONSE_BASE + cob.HOST_NODE:
            self._host_node_answers = True
        if frame.can_id == cob.LSS_RESPONSE:
            self.lss.on_response(frame.data)
        if frame.can_id & ~cob.NODE_MAX in cob.TPDO_BASES:
            # Gateways repeat those of other buses, under node ids that nobody answers to here.
            return
        if len(frame.data) == _WHOLE:
            self._network.notify(frame.can_id, bytearray(frame.data), now_s)
        else:
            # `canopen` takes the length of an answer, and of an emergency, for granted.
            self._network.scanner.on_message_received(frame.can_id)


class _LinkedNetwork(canopen.Network):
    """A `canopen` network that sends by a function of ours, and is notified by a link."""

    def __init__(self, send: Callable[[Frame], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._send(Frame(can_id, bytes(data)))


def _read_all(node: canopen.RemoteNode, entry: Entry) -> bytes:
    data = b""
    with node.sdo.open(entry.index, entry.sub, buffering=0) as stream:
        while piece := stream.read(_WHOLE):
            data += piece
            if len(data) > _LONGEST:
                reason = f"its answer goes on after {_LONGEST} bytes"
                raise canopen.SdoCommunicationError(reason)
    return data


def _entry(index: int, sub: int) -> Entry:
    if (index, sub) not in ENTRIES:
        raise KeyError(f"a cell has no object 0x{index:04X}:{sub}")
    return ENTRIES[index, sub]


def ranges(numbers: Iterable[int]) -> str:
    """Numbers as people write them: 1-4, 7, 9-12."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def counted(count: int, one: str, many: str | None = None) -> str:
    """A count with its noun, and with its verb where `many` is given."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"


def operational_text(node_ids: Collection[int]) -> str:
    """Advice about nodes that are operational, and whose wheels may turn."""
    if len(node_ids) == 1:
        return f"node {ranges(node_ids)} is operational; turn it off first: mdms stop"
    return (
        f"{len(node_ids)} cells (node {ranges(node_ids)}) are operational, as a run leaves them; "
        "turn them off first: mdms stop"
    )
