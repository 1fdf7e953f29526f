"""Sends to a python-can bus whose transmit queue may be full: it is waited for, for a while."""

import errno
from re import search

import can

from mdms_host.can_link.slcan_port import SlcanPort
from mdms_host.clock import Clock

#: One attempt of an interface that waits by itself; a control cycle has room for several.
_ATTEMPT_S = 0.002
#: A frame of 8 bytes at 250 kbit/s takes as long; so much later there may be room for one.
_PAUSE_S = 0.0005
#: The queue of SocketCAN (10 frames) is full, that of a socket, of a USB adapter.
_FULL = frozenset((errno.ENOBUFS, errno.EAGAIN, errno.ETIMEDOUT))


def is_full(error: BaseException | None) -> bool:
    """Whether a frame could not be sent for want of room only.

    python-can has no class for it: SocketCAN's error has a number or the text 'Transmit buffer
    full', USB adapters' and serial lines' stand behind it as its cause.
    """
    while error is not None:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if number in _FULL or isinstance(error, TimeoutError):
            return True
        if type(error).__name__ == "SerialTimeoutException":
            return True
        if search(r"\bfull\b", str(error).lower()):
            return True
        error = error.__cause__
    return False


class Transmitter:
    """`waited` counts frames that a full queue has delayed, `unsent` those that never left.

    `full_since_s` is when the queue was found full, None while it is not.
    """

    def __init__(self, port: can.BusABC | SlcanPort, clock: Clock) -> None:
        self.waited = 0
        self.unsent = 0
        self.full_since_s: float | None = None
        self._port = port
        self._clock = clock

    def send(self, message: can.Message, until_s: float) -> bool:
        """Send a frame, or give it up at `until_s`, after one attempt at least.

        Raises what the device raises when it is not for want of room.
        """
        waited = False
        while not self._attempt(message):
            now_s = self._clock.now_s()
            if self.full_since_s is None:
                self.full_since_s = now_s
            if now_s >= until_s:
                self.unsent += 1
                return False
            waited = True
            self._clock.sleep(_PAUSE_S)
        self.full_since_s = None
        self.waited += waited
        return True

    def _attempt(self, message: can.Message) -> bool:
        try:
            self._port.send(message, timeout=_ATTEMPT_S)
        except (can.CanError, OSError) as error:
            if is_full(error):
                return False
            self.unsent += 1
            raise
        return True
