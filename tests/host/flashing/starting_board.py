"""The serial port of a board that starts, in the time of a test, as pyserial offers it.

As ports/stm32/main.c and shared/runtime/pyexec.c of MicroPython 1.29 have it: without power all
that comes is lost, Ctrl-C interrupts `main.py` alone, and all else waits for the prompt. Left out:
editing of lines, raw paste, and interrupting code from the prompt.
"""

from contextlib import redirect_stdout
from io import StringIO

FRIENDLY = b"MicroPython v1.29.0; PYBv1.1\r\n>>> "
RAW = b"raw REPL; CTRL-B to exit\r\n>"
#: The bytes that the UART of the prompt keeps.
RECEIVE_BYTES = 260
#: Of a program that prints without end, as fast as it is read.
BYTE_S = 0.0005


class TestClock:
    """Time passes while somebody sleeps."""

    is_real = False

    __test__ = False

    def __init__(self):
        self._now_s = 0.0

    def now_s(self):
        return self._now_s

    def sleep(self, seconds):
        self._now_s += max(0.0, seconds)


class StartingBoard:
    """Has power from `on_s`, runs `main.py` from `main_s`, and takes `farewell_s` to end it.

    Its watchdog bites so many times when `main.py` has ended: it has no power for a second then,
    and starts anew. `interrupts_s` are the times at which Ctrl-C has ended something; `says` is the
    text that the program prints without end, and then it does not end. The port is there from
    `there_s`.
    """

    is_open = False
    write_timeout = None
    rts = dtr = True

    def __init__(
        self, clock, *, on_s=0.0, main_s=0.0, farewell_s=0.0, bites=0, there_s=0.0, says=b""
    ):
        self._clock = clock
        self._on_s, self._main_s, self._farewell_s = on_s, main_s, farewell_s
        self._start_s = main_s - on_s
        self._bites, self._there_s, self._says = bites, there_s, says
        self._ends_s = None
        self._step = None
        self._received, self._line, self._sent = bytearray(), bytearray(), bytearray()
        self.interrupts_s = []
        self.names = {}

    # The calls of mpremote to pyserial

    def isOpen(self):
        return self.is_open

    def open(self):
        if self._clock.now_s() < self._there_s:
            raise OSError
        self.is_open = True
        self._sent.clear()

    def close(self):
        self.is_open = False

    @property
    def in_waiting(self):
        self._turn()
        if self._is_main() and self._says and not self._sent:
            self._clock.sleep(len(self._says) * BYTE_S)
            self._sent += self._says
        return len(self._sent)

    def inWaiting(self):
        return self.in_waiting

    def read(self, count):
        self._turn()
        data = bytes(self._sent[:count])
        del self._sent[:count]
        return data

    def write(self, data):
        self._turn()
        for byte in data:
            self._receive(byte)
        self._turn()

    # The events on the board

    def _is_main(self):
        return self._step is None and self._clock.now_s() >= self._main_s

    def _receive(self, byte):
        now_s = self._clock.now_s()
        if now_s < self._on_s:
            return
        if byte == 3 and self._is_main():
            self.interrupts_s.append(now_s)
            # A second one ends the farewell as well.
            self._ends_s = now_s + (self._farewell_s if self._ends_s is None else 0.0)
        elif len(self._received) < RECEIVE_BYTES:
            self._received.append(byte)

    def _turn(self):
        ends_s = self._ends_s
        if ends_s is not None and not self._says and self._clock.now_s() >= ends_s:
            self._ends_s = None
            self._end_main()
        while self._step is not None and self._received:
            self._step(self._received.pop(0))

    def _end_main(self):
        self._sent += b"Traceback (most recent call last):\r\nKeyboardInterrupt: \r\n"
        if self._bites:
            self._bites -= 1
            self._received.clear()
            self._on_s = self._clock.now_s() + 1.0
            self._main_s = self._on_s + self._start_s
            return
        self._sent += FRIENDLY
        self._step = self._at_prompt

    def _at_prompt(self, byte):
        if byte in b"\r\x03":
            self._sent += b"\r\n>>> "
        elif byte == 1:
            self._sent += b"\r\n" + RAW
            self._line.clear()
            self._step = self._in_raw

    def _in_raw(self, byte):
        if byte == 1:
            self._sent += RAW
        if byte in b"\x01\x03":
            self._line.clear()
        elif byte != 4:
            self._line.append(byte)
        elif not self._line:
            self._sent += b"OK\r\nMPY: soft reboot\r\n" + RAW
            self.names = {}
        else:
            self._sent += b"OK" + self._run(bytes(self._line).decode()) + b"\x04\x04>"
            self._line.clear()
        if self._line == b"\x05A":
            # mpremote asks for raw paste, and takes a no for an answer.
            self._line.clear()
            self._step = self._refuse

    def _refuse(self, _byte):
        self._sent += b"R\x00"
        self._step = self._in_raw

    def _run(self, code):
        with redirect_stdout(StringIO()) as printed:
            exec(code, self.names)
        return printed.getvalue().replace("\n", "\r\n").encode()
