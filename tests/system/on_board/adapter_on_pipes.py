"""The adapter's own program on a board whose CAN controller is a pair of pipes; on MicroPython.

Run as `micropython adapter_on_pipes.py READ_FD WRITE_FD`. A record has 12 bytes: identifier,
length, flags, data. What lies in the pipe has come by interrupt since the last turn. Left out:
bus-off, mailboxes that are full.
"""

import select
import struct
import sys

import adapter_main
from mdms_adapter.ports import port

RECORD = "<HBB8s"
SIZE = 12


class Controller:
    """Gives records as `machine.CAN.recv` gives frames."""

    def __init__(self, read_fd):
        self._pipe = open(read_fd, "rb")  # noqa: SIM115 - open as long as the process lives
        self._ready = select.poll()
        self._ready.register(self._pipe, select.POLLIN)

    def waits(self):
        return bool(self._ready.poll(0))

    def recv(self, into):
        can_id, length, flags, data = struct.unpack(RECORD, self._pipe.read(SIZE))
        into[0] = can_id
        into[1] = memoryview(data)[:length]
        into[2] = flags
        into[3] = 0
        return into


class PipeBus:
    """The bus as `boards.bus.Bus` has it."""

    off = False

    def __init__(self, read_fd, write_fd):
        self._controller = Controller(read_fd)
        self._out = open(write_fd, "wb")  # noqa: SIM115
        self.inbox = None

    def listen(self, identifiers):
        assert identifiers is None

    def start(self):
        pass

    def service(self, now_ms):
        while self._controller.waits():
            self.inbox.take(self._controller)

    def send(self, can_id, data):
        self._out.write(struct.pack(RECORD, can_id, len(data), 0, data))
        return True


class Board:
    """A board with nothing but its bus."""

    serial = 0x1234ABCD

    def __init__(self, read_fd, write_fd):
        self.bus = PipeBus(read_fd, write_fd)

    def show(self, now_ms, state, faulty):
        pass


adapter_main.run(Board(int(sys.argv[1]), int(sys.argv[2])), port())
