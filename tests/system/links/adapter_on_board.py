"""The adapter's own program on a board with faked peripherals, whose bus is a pair of pipes.

Run on MicroPython as `adapter_on_board.py BOARD READ_FD WRITE_FD`. A record has 12 bytes:
identifier, length, flags, data. One with the flag COMMAND does something to the controller, or to
its bus; any other is a frame that arrives. The controller is as strict as its port's source: its
mailboxes, its FIFOs, bus-off and `restart` are those of `can_bx` and `can_fd`. A millisecond of the
board passes with each turn of the program.
"""

import select
import struct
import sys

import machine
import world
from bench import Bench

import adapter_main

RECORD = "<HBB8s"
SIZE = 12
COMMAND = 0x80
BUS_OFF, SHORT, CLEAR, INTERRUPTS_OFF, INTERRUPTS_ON = range(5)


class PipedBoard:
    """A board whose LEDs are looked at once a turn: there the bus goes on."""

    def __init__(self, name, read_fd, write_fd):
        bench = Bench(name)
        self._board = bench.board
        self._can = bench.can
        self.bus = bench.board.bus
        self.serial = 0x1234ABCD
        self._in = open(read_fd, "rb")  # noqa: SIM115 - open as long as the process lives
        self._out = open(write_fd, "wb")  # noqa: SIM115
        self._ready = select.poll()
        self._ready.register(self._in, select.POLLIN)

    def show(self, now_ms, state, faulty):
        """A board's work on its LEDs; then the events on the bus since the last call."""
        self._board.show(now_ms, state, faulty)
        while self._ready.poll(0):
            can_id, length, flags, data = struct.unpack(RECORD, self._in.read(SIZE))
            if flags & COMMAND:
                self._obey(can_id)
            else:
                self._can.deliver(can_id, data[:length], flags)
        for can_id, data in world.sent:
            self._out.write(struct.pack(RECORD, can_id, len(data), 0, data))
        world.sent.clear()

    def _obey(self, command):
        if command == BUS_OFF:
            self._can.fall_silent()
        elif command in (SHORT, CLEAR):
            world.levels[self._can.RECEIVE_PIN] = 0 if command == SHORT else 1
        elif command == INTERRUPTS_OFF:
            machine.disable_irq()
        else:
            machine.enable_irq(False)


adapter_main.run(PipedBoard(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])), adapter_main.port())
