"""The served bus as a python-can interface: `-i mdms -c NAME` in any program that uses python-can.

Found by python-can through the entry point `can.interface`.
"""

import contextlib
import copy
import selectors
import socket
import threading
from collections import deque
from typing import Any

import can

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import ERROR, EXTENDED, EXTENDED_MASK, REMOTE
from mdms_sim.serve import packet
from mdms_sim.serve.clock import epoch_now_s

_HELLO_TIMEOUT_S = 2.0
_READ_BYTES = 1 << 16
#: `select` alone refuses descriptors of 1024 and above. Windows has nothing else.
_Selector = getattr(selectors, "PollSelector", selectors.SelectSelector)


class MdmsBus(can.BusABC):
    """A client of a bus that `mdms serve` runs on this machine.

    `channel` is the served name. With `receive_own_messages` a frame sent is received as well. With
    another `bitrate` than the bus has, every frame either way becomes an error frame, as on a wire.
    Raises can.CanInitializationError when nothing is served under the name.
    """

    def __init__(
        self,
        channel: str = "array18",
        receive_own_messages: bool = False,
        bitrate: int | None = None,
        **options: Any,
    ) -> None:
        self.channel_info = f"mdms {channel}"
        self._receive_own_messages = receive_own_messages
        self._sending = threading.Lock()
        self._waiting: deque[can.Message] = deque()
        self._rest = bytearray()
        self._socket, served_bitrate = _connect(channel)
        self._is_in_step = bitrate in (None, served_bitrate)
        super().__init__(channel, **options)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a message to the bus; can.CanOperationError if it takes none within `timeout`.

        Frames of CAN FD and error frames raise it too.
        """
        if msg.is_fd or msg.is_error_frame:
            raise can.CanOperationError(
                "the served bus takes frames of classic CAN alone, and no FD or error frames"
            )
        if not self._is_in_step:
            self._waiting.append(_error_frame())
            return
        data = packet.pack(_frame_of(msg), 0.0)
        with self._sending:
            self._send_all(memoryview(data), timeout)
        if self._receive_own_messages:
            own = copy.deepcopy(msg)
            own.is_rx = False
            own.timestamp = epoch_now_s()
            self._waiting.append(own)

    def _send_all(self, data: memoryview, timeout: float | None) -> None:
        # Once a packet has begun it must be completed, or the stream would be out of step.
        wait_s = timeout
        while data:
            try:
                writable = _is_ready(self._socket, selectors.EVENT_WRITE, wait_s)
                data = data[self._socket.send(data) :] if writable else data
            except OSError as error:
                raise can.CanOperationError(f"the served bus is gone: {error}") from error
            except ValueError as error:
                raise can.CanOperationError(f"the served bus is closed: {error}") from None
            if not writable:
                raise can.CanOperationError("the served bus takes no more frames; it is full")
            wait_s = None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._waiting and self._readable(timeout):
            self._read()
        try:
            return self._waiting.popleft(), False
        except IndexError:
            return None, False

    def _readable(self, timeout: float | None) -> bool:
        try:
            return _is_ready(self._socket, selectors.EVENT_READ, timeout)
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"the served bus is closed: {error}") from None

    def _read(self) -> None:
        try:
            data = self._socket.recv(_READ_BYTES)
        except OSError as error:
            raise can.CanOperationError(f"the served bus is gone: {error}") from error
        if not data:
            raise can.CanOperationError("the served bus is gone: it was closed")
        self._rest += data
        whole = len(self._rest) // packet.SIZE * packet.SIZE
        frames = packet.unpack(bytes(self._rest[:whole]))
        del self._rest[:whole]
        if not self._is_in_step:
            self._waiting.extend(_error_frame() for _ in frames)
            return
        self._waiting.extend(_message_of(frame, epoch_s or 0.0) for frame, epoch_s in frames)

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        """The buses served on this machine by this user."""
        return [
            {"interface": "mdms", "channel": path.stem}
            for path in sorted(packet.runtime_folder().glob("*.sock"))
        ]


def _connect(channel: str) -> tuple[socket.socket, int]:
    """The connection to a served bus, and its bit rate. Raises can.CanInitializationError."""
    if not hasattr(socket, "AF_UNIX"):
        raise can.CanInitializationError(
            "a served bus is reached by a Unix socket, which this system has not; use Linux, macOS "
            "or WSL, or an adapter: -i and -c"
        )
    path = packet.socket_path(channel)
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.settimeout(_HELLO_TIMEOUT_S)
        connection.connect(str(path))
        connection.sendall(packet.HELLO)
        hello = connection.recv(packet.GREETING_SIZE, socket.MSG_WAITALL)
    except (BrokenPipeError, ConnectionResetError):
        hello = b""
    except (TimeoutError, BlockingIOError) as error:
        connection.close()
        raise can.CanInitializationError(
            f"{channel!r} is served, but its server does not answer within {_HELLO_TIMEOUT_S:g} s: "
            "it is suspended or too busy; have it go on, or end it"
        ) from error
    except OSError as error:
        connection.close()
        raise can.CanInitializationError(_no_bus(channel, error)) from error
    if not hello:
        connection.close()
        raise can.CanInitializationError(f"{path} takes no more clients; end one, then try again")
    if not hello.startswith(packet.HELLO) or len(hello) != packet.GREETING_SIZE:
        connection.close()
        raise can.CanInitializationError(
            f"{path} speaks {hello!r}, not {packet.HELLO!r}; use the same version on both sides"
        )
    connection.setblocking(True)
    return connection, packet.bitrate_of(hello)


def _is_ready(connection: socket.socket, event: int, timeout: float | None) -> bool:
    """Whether it can be read or written in time. Raises ValueError if it is closed."""
    with _Selector() as selector:
        selector.register(connection, event)
        return bool(selector.select(timeout))


def _error_frame() -> can.Message:
    """The report of a controller about a frame at another bit rate than its own."""
    return can.Message(timestamp=epoch_now_s(), is_error_frame=True, is_extended_id=False)


def _no_bus(channel: str, error: OSError) -> str:
    """Nothing is served under a name; the message lists the served ones."""
    names = sorted(path.stem for path in packet.runtime_folder().glob("*.sock"))
    # A server that was killed has left its socket.
    names = [name for name in names if name != channel]
    buses = [name for name in names if name.rpartition(".")[0] == channel]
    if buses:
        return f"{channel} is a table of several buses; name one: {', '.join(buses)}"
    there = f"served are: {', '.join(names)}" if names else "nothing is served"
    return (
        f"no bus is served as {channel!r} ({error.strerror or error}); {there}; start one with: "
        "mdms serve array18"
    )


def _frame_of(message: can.Message) -> Frame:
    can_id = message.arbitration_id
    if message.is_extended_id:
        can_id |= EXTENDED
    if message.is_remote_frame:
        return Frame(can_id | REMOTE, bytes(message.dlc))
    return Frame(can_id, bytes(message.data))


def _message_of(frame: Frame, epoch_s: float) -> can.Message:
    remote = bool(frame.can_id & REMOTE)
    return can.Message(
        timestamp=epoch_s,
        arbitration_id=frame.can_id & EXTENDED_MASK,
        is_extended_id=bool(frame.can_id & EXTENDED),
        is_remote_frame=remote,
        is_error_frame=bool(frame.can_id & ERROR),
        dlc=len(frame.data),
        data=None if remote else frame.data,
        is_rx=True,
    )
