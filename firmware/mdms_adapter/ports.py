"""The serial line to the host: USB as an STM32 board has it, or standard input and output."""

import select
import sys

import micropython


def port():
    """The line of this board; Ctrl-C in it is a byte like any other from here on."""
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
