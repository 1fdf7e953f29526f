"""A cell in the middle of nine, all under one parcel, for tests and figures of the layer."""

import sys
from array import array

from cell_bench import NODE, Board

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.neighbours import frames as wire

PITCH_UM = 127_000
STEPS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
#: Node ids of the neighbours by direction.
NEIGHBOURS = (6, 9, 8, 7, 4, 1, 2, 3)
SENSORS_UM = ((0, 0), (31_750, 31_750), (-31_750, 31_750), (-31_750, -31_750), (31_750, -31_750))
IDENTITY = 7
LENGTH_UM, WIDTH_UM = 360_000, 300_000
BEAT_MS = 10
#: Cells repeat their state after so long.
REPEAT_MS = 200


def some_of(cases):
    """The cases; a third of them on 32 bits, where bytecode is slow.

    All of them are tried by the same source on CPython, and as machine code at 64 bits.
    """
    return cases if sys.maxsize >> 32 else list(cases)[::3]


def estimate_frame(fields):
    """The frame of an estimate with these fields, by their numbers; the others are 0."""
    numbers = array("i", [0] * wire.ESTIMATE_FIELDS)
    for field, number in fields.items():
        numbers[field] = number
    frame = bytearray(8)
    wire.pack_estimate(numbers, frame, 0)
    return bytes(frame)


def estimate_of(data):
    """The fields of an estimate, by their numbers."""
    fields = array("i", [0] * wire.ESTIMATE_FIELDS)
    assert wire.unpack_estimate(data, fields)
    return list(fields)


def page_frame(fields):
    """The frame of a page with these fields, the last of which may be left out."""
    frame = bytearray(8)
    left_out = wire.PROGRAM_FIELDS - len(fields)
    wire.pack_program(array("i", tuple(fields) + left_out * (0,)), frame)
    return bytes(frame)


def _u32(number):
    return (number & 0xFFFFFFFF).to_bytes(4, "little")


class Middle:
    """The cell, and what its neighbours would send while the parcel goes along x at a speed."""

    #: The neighbours that the cell is told of, and the place of the parcel.
    neighbours = NEIGHBOURS
    placed_x_um = -60_000
    placed_y_um = 0
    #: The size of the parcel, and where it is to go [steps of the wire].
    length_um, width_um = LENGTH_UM, WIDTH_UM
    goal_x = 400
    #: How sure neighbours are of the parcel, as their estimates have it.
    certainty = 9

    def __init__(self, speed_um_s=100_000):
        self.board = Board()
        self.cell = Cell(self.board, NODE)
        self.now_ms = 0
        self.x_um = self.placed_x_um
        self.speed_um_s = speed_um_s
        #: The node id of a neighbour that says nothing, and whether the parcel is off the table.
        self.silent = None
        self.sequence = 1
        self.program_flags = 0
        #: The reports of all neighbours about their program.
        self.its_sequence = 1
        self.its_flags = 0
        self.lifted = False
        #: Whether neighbours' states get lost, and of which directions the speeds do.
        self.losing = False
        self.unheard = ()
        #: Neighbours' statuswords, as bytes.
        self.words = bytes((0x33, 2, 0x33, 2))
        self._states = [None] * 8
        self._stated_ms = [0] * 8
        self._boot()

    def _boot(self):
        self._set_up()
        self._start()
        for _ in range(40):
            self.beat(moving=False)

    def _set_up(self):
        for _ in range(60):
            self._pass(1)
        self._write(indices.PLACE, 1, 1, 2)
        self._write(indices.PLACE, 2, 1, 2)
        for sub, node_id in enumerate(self.neighbours, 1):
            self._write(indices.NEIGHBOURS, sub, 1, node_id)
        self._write(indices.TPDO_PARAMETERS + 1, 5, 2, REPEAT_MS)
        self._write(indices.CONTROL, 0, 1, 1)

    def _start(self):
        cell = self.cell
        cell.on_frame(cob.NMT, bytes((1, NODE)), self.now_ms)
        for word in (cia402.SHUTDOWN, cia402.SWITCH_ON):
            cell.on_frame(cob.RPDO_BASES[1] + NODE, pdo.CONTROLWORD.encode((word, word)), 0)
        self._pages()

    def _write(self, index, sub, size, number):
        head = bytes((0x23 | 4 - size << 2, index & 0xFF, index >> 8, sub))
        self.cell.on_frame(cob.SDO_REQUEST_BASE + NODE, head + _u32(number), self.now_ms)
        assert self.board.take()[-1][1][0] == 0x60

    def _pages(self):
        size = (self.length_um // wire.STEP_UM, self.width_um // wire.STEP_UM)
        shape = wire.RECTANGLE
        number, flags = self.sequence, self.program_flags
        self._page((IDENTITY, wire.PARCEL, number, shape, size[0], size[1], 44, 20, flags))
        y = self.placed_y_um // wire.STEP_UM
        self._page((IDENTITY, wire.PLACE, 1, self.x_um // wire.STEP_UM, y, 0, 0, 0, 0))
        self._page((IDENTITY, wire.GOAL, self.sequence, self.goal_x, 0, 0, 0, 0, 0))

    def _page(self, fields):
        self.cell.on_frame(cob.PROGRAM, page_frame(fields), self.now_ms)

    def _pass(self, time_ms):
        self.now_ms += time_ms
        self.cell.poll(self.now_ms)

    def beat(self, moving=True):
        """One SYNC, what follows it from all neighbours, and the update."""
        cell, speed_um_s = self.cell, self.speed_um_s if moving else 0
        cell._registers[speed_loop.ACTUAL] = speed_um_s
        cell.on_frame(cob.SYNC, b"", self.now_ms)
        self._pass(1)
        for direction in range(8):
            node_id = NEIGHBOURS[direction]
            if node_id == self.silent:
                continue
            speeds = self._speeds(direction, speed_um_s)
            if direction not in self.unheard:
                cell.on_frame(cob.TPDO_BASES[0] + node_id, speeds, self.now_ms)
            fields = self._estimate(direction)
            if fields:
                can_id = cob.TPDO_BASES[2] + node_id
                cell.on_frame(can_id, estimate_frame(fields), self.now_ms)
            self._presence(direction)
        self.board.bits = self._covered(0, 0)
        self._pass(3)
        self._pass(4)
        self._pass(BEAT_MS - 8)
        self.x_um += speed_um_s * BEAT_MS // 1000

    def _speeds(self, _direction, speed_um_s):
        return _u32(speed_um_s) + _u32(0)

    def _estimate(self, direction):
        """The fields of a neighbour's estimate, None where it sends none."""
        dx, dy = STEPS[direction]
        return {
            wire.X: (self.x_um - dx * PITCH_UM) // wire.STEP_UM,
            wire.Y: -dy * PITCH_UM // wire.STEP_UM,
            wire.IDENTITY: IDENTITY,
            wire.STATE: wire.UNDER,
            wire.CERTAINTY: self.certainty,
            wire.HOLD: wire.HOLD_NONE,
            wire.SEQUENCE: self.its_sequence,
            wire.FLAGS: self.its_flags,
        }

    def _covered(self, x_um, y_um):
        bits = 0
        if self.lifted:
            return bits
        for sensor, (own_x, own_y) in enumerate(SENSORS_UM):
            along, across = abs(x_um + own_x - self.x_um), abs(y_um + own_y)
            if along < self.length_um // 2 and across < self.width_um // 2:
                bits |= 1 << sensor
        return bits

    def _presence(self, direction):
        dx, dy = STEPS[direction]
        bits = self._covered(dx * PITCH_UM, dy * PITCH_UM)
        state = self.words + bytes((bits,))
        repeats = self.now_ms - self._stated_ms[direction] >= REPEAT_MS
        if state != self._states[direction] or repeats:
            self._states[direction] = state
            self._stated_ms[direction] = self.now_ms
            if self.losing:
                return
            self.cell.on_frame(cob.TPDO_BASES[1] + NEIGHBOURS[direction], state, self.now_ms)


def targets_um_s(middle):
    registers = middle.cell._registers
    return registers[speed_loop.TARGET], registers[speed_loop.AXIS + speed_loop.TARGET]


def state(middle):
    """Of axis 1, as the statusword has it."""
    return middle.cell._objects.reader(indices.STATUSWORD, 0)[0]() & 0x6F


def estimates(middle):
    """The estimates that the cell has sent since the last call."""
    can_id = cob.TPDO_BASES[2] + NODE
    return [estimate_of(data) for sent_id, data in middle.board.take() if sent_id == can_id]


def run(middle, beats, moving=True):
    for _ in range(beats):
        middle.beat(moving)
