"""Makes the board an SLCAN adapter over USB; copied as `main.py` instead of the cell's.

`docs/boards.md` has the way to the prompt. Both wheels stay off.
"""

import gc
import select
import sys
import time

import micropython

from boards.detect import board_module
from mdms_adapter.adapter import Adapter
from mdms_cell.queues import Inbox

#: Frames that may wait while the program does something else: 60 ms of a full bus.
INBOX_SIZE = 512


def run(board, line):
    """Carry frames until the board is switched off."""
    bus = board.bus
    bus.inbox = Inbox(INBOX_SIZE)
    bus.listen(None)
    adapter = Adapter(bus, line, board.serial)
    gc.collect()
    bus.start()
    while True:
        now_ms = time.ticks_ms()
        adapter.turn(now_ms)
        board.show(now_ms, adapter.state, adapter.lost)


def port():
    """The serial line to the host: USB as an STM32 board has it, or standard input and output.

    Ctrl-C in it is a byte like any other from here on.
    """
    micropython.kbd_intr(-1)
    try:
        from pyb import USB_VCP
    except ImportError:
        return StandardPort()
    usb = USB_VCP()
    usb.setinterrupt(-1)
    return UsbPort(usb)


class UsbPort:
    """A `pyb.USB_VCP`; it reads and writes as many bytes as there are."""

    def __init__(self, usb):
        self._usb = usb

    def read(self, most):
        """Bytes that have come, b"" if none have."""
        return self._usb.recv(most, timeout=0)

    def write(self, data):
        """How many bytes were taken; none while no host has the port open."""
        return self._usb.send(data, timeout=0) if self._usb.isconnected() else len(data)


class StandardPort:
    """Standard input and output, which are asked before each byte, and before each piece."""

    #: Bytes that an output takes without waiting once it is ready.
    PIECE = 512

    def __init__(self):
        self._input = sys.stdin.buffer
        self._output = sys.stdout.buffer
        self._ready = select.poll()
        self._ready.register(self._input, select.POLLIN)
        self._room = select.poll()
        self._room.register(self._output, select.POLLOUT)

    def read(self, most):
        """Bytes that have come, b"" if none have. Raises EOFError when the other end is gone."""
        data = bytearray()
        while len(data) < most and self._ready.poll(0):
            byte = self._input.read(1)
            if not byte:
                raise EOFError
            data += byte
        return data

    def write(self, data):
        """How many bytes were taken."""
        if not self._room.poll(0):
            return 0
        return self._output.write(data[: self.PIECE])


if __name__ == "__main__":
    module = board_module(sys.implementation._machine)
    if not module.held():
        run(module.board(), port())
