"""A board whose CAN controller is a pair of pipes and whose flash is a file; on MicroPython.

It stands for a Teensy 4.1: frames that come over the pipes while the program does something else
wait in them as they would in the cell's inbox, but without end. Wheels stand still, and no voltage
may be at them. Left out: bus-off, interrupts, the watchdog, which is the other process.
"""

import gc
import os
import select
import struct
import sys
import time
from array import array

from file_flash import FileFlash

from boards import flash
from mdms_cell.drive import speed_loop
from mdms_cell.queues import Inbox
from mdms_cell.runner import FRAMES_PER_TURN
from mdms_protocol.codecs import update

#: Of a Teensy 4.1: MicroPython's heap there is 768 KB (ports/mimxrt/boards/MIMXRT1062.ld), and
#: `boards.cell_board` leaves 128 KB of it. Code of 64 bits takes 1.4 times as much as a board's.
IMAGE_ROOM = (768 - 128) * 1024
RECORD = "<HBB8s"
SIZE = 12


class PipeBoard:
    """As `boards.cell_board.CellBoard`, and the bus of that."""

    number = update.TEENSY41
    bytecode = sys.implementation._mpy & update.BYTECODE
    serial = 0x00000055
    slots = None
    bus_off = False

    def __init__(self, read_fd, write_fd, tell_fd):
        self.registers = array("i", [0] * speed_loop.REGISTERS)
        self.settings = flash.memory("/flash", self.asleep)
        self.inbox = Inbox(registers=self.registers)
        self._pipe = open(read_fd, "rb")  # noqa: SIM115 - open as long as the process lives
        self._out = open(write_fd, "wb")  # noqa: SIM115
        self._teller = open(tell_fd, "wb")  # noqa: SIM115
        self._ready = select.poll()
        self._ready.register(self._pipe, select.POLLIN)
        self._identifiers = ()
        self._tick = None
        self._ticked_ms = 0

    # The calls of the runner

    def start(self, tick, watchdog):
        self._tick, self._ticked_ms = tick, time.ticks_ms()

    def stop(self):
        self._tick = None

    def service(self, now_ms):
        """All ticks and frames that interrupts would have brought meanwhile."""
        while self._tick is not None and time.ticks_diff(now_ms, self._ticked_ms) > 0:
            self._ticked_ms = time.ticks_add(self._ticked_ms, 1)
            self._tick()
        for _ in range(FRAMES_PER_TURN):
            if not self._ready.poll(0):
                break
            self.inbox.take(self)

    def recv(self, into):
        """The next frame, as a controller gives it; None if the cell does not take it."""
        can_id, length, _, data = struct.unpack(RECORD, self._pipe.read(SIZE))
        if can_id not in self._identifiers:
            return None
        into[0], into[1] = can_id, data[:length]
        return into

    def feed(self):
        pass

    def show(self, now_ms, state, faulty):
        pass

    # The calls of the cell

    def sample(self, registers):
        registers[speed_loop.SUPPLY] = 24_000_000

    def drive(self, registers):
        for axis in range(speed_loop.AXES):
            assert not registers[axis * speed_loop.AXIS + speed_loop.VOLTAGE], "a motor is on"

    def presence(self):
        return 0

    def place(self):
        return 0

    def send(self, can_id, data):
        self._out.write(struct.pack(RECORD, can_id, len(data), 0, bytes(data)))
        return True

    def listen(self, identifiers):
        self._identifiers = identifiers

    def motors_off(self):
        pass

    def asleep(self):
        return True

    def heap_free(self):
        gc.collect()
        return gc.mem_free()

    def flash_free(self):
        sizes = os.statvfs("/flash")
        return sizes[0] * sizes[3]

    def slots_room(self):
        return 256 * 1024

    def image_room(self):
        return IMAGE_ROOM

    def restart(self):
        """The other process sees to it, as a reset does: nothing here goes on."""
        self._teller.write(b"restart %d\n" % FileFlash.operations)
        while True:
            time.sleep(1)


def held():
    return False


def board():
    return PipeBoard(*[int(text) for text in sys.argv[2:5]])
