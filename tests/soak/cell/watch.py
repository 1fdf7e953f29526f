"""Conditions that hold all the time, in any situation; each violation is printed as a finding."""

import binascii

import world
from grid import LATE_MS, Grid
from wheels import WHEELS

from mdms_cell.drive import speed_loop
from mdms_protocol.codecs import nmt

NODE = 5
BOOT_UP = b"\x00"
HEARTBEAT_MS = 100
#: A TPDO that never changes, sent by its event timer alone; and one that always may.
EVENT_MS = 70
INHIBIT_MS = 20
EVENT_AT_REST_MS = 200
#: The braking time limit, 0x3004, and a tick.
BRAKING_MS = 2_001

_STATES = (nmt.INITIALISING, nmt.STOPPED, nmt.OPERATIONAL, nmt.PRE_OPERATIONAL)
_FINDINGS_MAX = 50


class Watch:
    """Sees every frame that the cell sends, and its registers after every tick."""

    def __init__(self):
        self.cell = None
        self.registers = None
        self.findings = 0
        self.frames = 0
        self.sum = 0
        self.owed = 0
        self.unsure = False
        self.heartbeat = Grid("heartbeat", HEARTBEAT_MS, self)
        self.event = Grid("TPDO3", EVENT_MS, self)
        self._position_ms = None
        self._operational_ms = 0

    def find(self, text):
        """Tell that something does not hold."""
        self.findings += 1
        print("finding", world.now_ms, text)
        if self.findings >= _FINDINGS_MAX:
            raise RuntimeError("too many findings")

    def expect(self, holds, text):
        """A finding, unless this holds."""
        if not holds:
            self.find(text)

    def forget_position(self):
        """TPDO4 may be sent at any time."""
        self._position_ms = None

    def doubt(self):
        """The bus is off: frames may be lost or late."""
        self.unsure = True
        self.owed = 0
        self._position_ms = None
        self.heartbeat.doubt()
        self.event.doubt()

    def trust(self):
        """Frames come in time again."""
        self.unsure = False
        self.owed = 0
        self.heartbeat.trust(world.now_ms)
        self.event.trust(world.now_ms)

    def sync(self):
        """The cell has been sent a SYNC that it answers."""
        self.expect(not self.owed, "SYNC not answered")
        self.owed = 0 if self.unsure else 1

    def hear(self, can_id, data):
        """The cell has sent a frame."""
        head = bytes((can_id & 0xFF, can_id >> 8, len(data)))
        self.sum = binascii.crc32(data, binascii.crc32(head, self.sum))
        self.frames += 1
        if can_id == 0x700 + NODE:
            if data == BOOT_UP:
                self.heartbeat.start(world.now_ms)
            else:
                self.heartbeat.heard(world.now_ms)
        elif self.cell.state == nmt.OPERATIONAL:
            self._hear_pdo(can_id)

    def _hear_pdo(self, can_id):
        if can_id == 0x180 + NODE:
            self.expect(self.owed or self.unsure, "TPDO1 without SYNC")
            self.owed = 0
        elif can_id == 0x380 + NODE:
            self.event.heard(world.now_ms)
        elif can_id == 0x480 + NODE:
            self._hear_position()

    def _hear_position(self):
        now_ms = world.now_ms
        if self._position_ms is not None and not self.unsure:
            gap_ms = now_ms - self._position_ms
            if not INHIBIT_MS - LATE_MS <= gap_ms <= EVENT_AT_REST_MS + LATE_MS:
                self.find(f"TPDO4 {gap_ms} ms after the one before")
        self._position_ms = None if self.unsure else now_ms

    def poll(self):
        """Check the conditions after every tick."""
        now_ms = world.now_ms
        self.heartbeat.poll(now_ms)
        self.event.poll(now_ms)
        state = self.cell.state
        self.expect(state in _STATES, "NMT state")
        if state == nmt.OPERATIONAL:
            self._operational_ms = now_ms
        else:
            self._leave()
        for place in range(2):
            mode = self.registers[place * speed_loop.AXIS + speed_loop.MODE]
            if mode == speed_loop.OFF:
                self.expect(not world.pulses[WHEELS[place][1]], "voltage while off")
            elif now_ms - self._operational_ms > (BRAKING_MS if mode == speed_loop.BRAKE else 1):
                # A lost heartbeat leads out of 'operational' at once, and the wheel brakes on.
                self.find(f"motor on, NMT state {state}")

    def _leave(self):
        """No PDOs are due."""
        self.event.stop()
        self.owed = 0
        self._position_ms = None
