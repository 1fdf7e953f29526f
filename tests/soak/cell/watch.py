"""What must hold all the time, whatever is going on; what does not is printed as a finding."""

import binascii

import world
from wheels import WHEELS

from mdms_cell import speed_loop
from mdms_protocol import nmt

NODE = 5
BOOT_UP = b"\x00"
HEARTBEAT_MS = 100
#: A TPDO that never changes, sent by its event timer alone; and one that always may.
EVENT_MS = 70
INHIBIT_MS = 20
EVENT_AT_REST_MS = 200

_STATES = (nmt.INITIALISING, nmt.STOPPED, nmt.OPERATIONAL, nmt.PRE_OPERATIONAL)
#: How long a frame may wait for a mailbox.
_LATE_MS = 4
_FINDINGS_MAX = 50


class Grid:
    """Frames that are due at a fixed time and every period after it, for ever."""

    def __init__(self, name, period_ms, watch):
        self._name = name
        self._period_ms = period_ms
        self._watch = watch
        self._due_ms = None
        self._unsure = False
        self._settled = False
        self._optional = False
        self.count = 0

    def start(self, now_ms):
        """The first frame has come now."""
        self._due_ms = now_ms + self._period_ms
        self._unsure = False
        self._settled = False

    def stop(self):
        """No frame is due any more."""
        self._due_ms = None

    def change(self, period_ms):
        """The next frame starts a grid of another period."""
        self._period_ms = period_ms
        self._due_ms = None

    def doubt(self):
        """Frames may be lost or late until `trust`; the grid is the same after it."""
        self._unsure = True

    def trust(self, now_ms):
        """Frames come in time again."""
        self._unsure = False
        # The one that is due about now may have come just before.
        self._optional = True
        while self._due_ms is not None and self._due_ms < now_ms - _LATE_MS:
            self._due_ms += self._period_ms

    def heard(self, now_ms):
        """A frame has come; the first one after a stop starts the grid."""
        self.count += 1
        if self._due_ms is None:
            self.start(now_ms)
        elif not self._unsure:
            late_ms = now_ms - self._due_ms
            if not self._settled and -_LATE_MS <= late_ms < 0:
                # The first frame had to wait for a mailbox, this one had not.
                self._due_ms = now_ms
            elif not 0 <= late_ms <= _LATE_MS:
                self._watch.find(f"{self._name} {late_ms} ms off its grid")
            self._due_ms += self._period_ms
            self._settled = True
            self._optional = False

    def poll(self, now_ms):
        """Notice a frame that has not come."""
        if self._due_ms is None or self._unsure or now_ms - self._due_ms <= _LATE_MS:
            return
        if not self._optional:
            self._watch.find(f"{self._name} missing")
        self._optional = False
        self._due_ms += self._period_ms


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
            if not INHIBIT_MS - _LATE_MS <= gap_ms <= EVENT_AT_REST_MS + _LATE_MS:
                self.find(f"TPDO4 {gap_ms} ms after the one before")
        self._position_ms = None if self.unsure else now_ms

    def poll(self):
        """What must hold after every tick."""
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
            elif now_ms - self._operational_ms > 1:
                self.find(f"motor on, NMT state {state}")

    def _leave(self):
        """No PDOs are due."""
        self.event.stop()
        self.owed = 0
        self._position_ms = None
