"""Which cells a parcel covers.

It belongs to those whose wheels or sensors are under it, and what lies between does not count. It
needs those whose squares it lies over, which are what it may move within.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.outline import (
    COSINE,
    DISC,
    HALF_LENGTH,
    HALF_WIDTH,
    SHAPE,
    SINE,
    STEP_UM,
    X,
    Y,
)
from mdms_cell.perception.place import AXES, DIRECTIONS, SENSORS
from mdms_protocol.compat import WIDEN, const, micropython, ptr32

# What is used in every beat; constants of another module would be looked up.
_X = const(0)
_Y = const(1)
_COSINE = const(2)
_SINE = const(3)
_SHAPE = const(4)
_HALF_LENGTH = const(5)
_HALF_WIDTH = const(6)
_DISC = const(1)
assert (_X, _Y, _COSINE, _SINE, _SHAPE) == (X, Y, COSINE, SINE, SHAPE)
assert (_HALF_LENGTH, _HALF_WIDTH, _DISC) == (HALF_LENGTH, HALF_WIDTH, DISC)

#: A parcel's cells are those under its outline and this much around it [steps].
MARGIN = 10_000 // STEP_UM
#: A parcel keeps this away from the squares of cells that are not promised to it [steps].
CLEARANCE = 4_000 // STEP_UM
#: An edge that no sensor has seen may lie 32 mm from where it is believed: so much more than that
#: [steps]. An estimate says so by a certainty of this at most.
UNSEEN_ROOM = 28_000 // STEP_UM
UNSEEN_CERTAINTY = const(3)
POINTS = const(7)
assert POINTS == AXES + SENSORS

# Registers of a footprint
POINT_X = const(0)  # the cell's points: its wheels come before its sensors
POINT_Y = const(7)
ALONG_X = const(14)  # directions of wheels by axis [1/512]
ALONG_Y = const(16)
SHIFT = const(18)  # x and y of each neighbour's centre by direction, and last the cell's own
PRESENT = const(36)  # the mask of the neighbours that there are
HALF = const(37)  # a square: a parcel that comes so near to a centre needs that cell
_REGISTERS = const(38)


class Footprint:
    """The points of a cell and its neighbours, in its `registers`.

    In steps of 16 um, from the cell's own centre. Neighbours are cells alike, whose points are the
    cell's own, shifted. Squares, not points, are what a parcel needs: two parcels may not meet
    between the sensors of two cells either.
    """

    def __init__(self, place):
        self._place = place
        self.registers = array("i", [0] * _REGISTERS)
        self.load()

    def load(self):
        """Take over the place's settings."""
        place, registers = self._place, self.registers
        for axis in range(AXES):
            self._put(POINT_X + axis, POINT_Y + axis, place.contact_um(axis))
            # Of 1 / place.UNITY, in 1/512.
            along_x, along_y = place.drive(axis)
            registers[ALONG_X + axis], registers[ALONG_Y + axis] = along_x >> 5, along_y >> 5
        for sensor in range(SENSORS):
            point = AXES + sensor
            self._put(POINT_X + point, POINT_Y + point, place.sensor_um(sensor))
        registers[PRESENT] = place.present()
        for direction in range(DIRECTIONS):
            at = SHIFT + 2 * direction
            self._put(at, at + 1, place.shift_um(direction))
        registers[HALF] = place.pitch_um // (2 * STEP_UM) + CLEARANCE

    def _put(self, x_at, y_at, place_um):
        x_um, y_um = place_um
        self.registers[x_at], self.registers[y_at] = x_um // STEP_UM, y_um // STEP_UM

    def point(self, direction, point):
        """Where that cell's point is: x and y."""
        registers, at = self.registers, SHIFT + 2 * direction
        x, y = registers[POINT_X + point], registers[POINT_Y + point]
        return registers[at] + x, registers[at + 1] + y

    @micropython.native
    def covers(self, outline):
        """Whether the parcel covers a wheel or a sensor of the cell, or nearly."""
        return self.within(outline, DIRECTIONS, MARGIN) != 0

    @micropython.native
    def within(self, outline, direction, limit):
        """The mask of that cell's points that are less than `limit` outside the outline [steps]."""
        return points_within(outline.registers, self.registers, direction, POINTS, limit)

    def reaches(self, outline, room=0):
        """Whether the parcel lies over the cell's own square, or nearly; with room around it."""
        self.registers[HALF] += room
        over = squares_overlapped(outline.registers, self.registers, 1 << DIRECTIONS) != 0
        self.registers[HALF] -= room
        return over


@micropython.viper
def points_within(outline: ptr32, footprint: ptr32, direction: int, points: int, limit: int) -> int:
    """The mask of a cell's first points that are less than `limit` outside an outline [steps]."""
    widen = int(WIDEN)
    shift_x = footprint[SHIFT + 2 * direction] << widen >> widen
    shift_y = footprint[SHIFT + 2 * direction + 1] << widen >> widen
    shift_x -= outline[_X] << widen >> widen
    shift_y -= outline[_Y] << widen >> widen
    cosine = outline[_COSINE] << widen >> widen
    sine = outline[_SINE] << widen >> widen
    length = outline[_HALF_LENGTH] + limit
    width = outline[_HALF_WIDTH] + limit
    radius = length + 3 >> 2 if length > 0 else 0
    square = radius * radius
    disc = outline[_SHAPE] == _DISC
    mask = 0
    bit = 1
    for point in range(points):
        x = (footprint[POINT_X + point] << widen >> widen) + shift_x
        y = (footprint[POINT_Y + point] << widen >> widen) + shift_y
        if disc:
            if (x >> 2) * (x >> 2) + (y >> 2) * (y >> 2) < square:
                mask |= bit
        else:
            along = cosine * x + sine * y >> 13
            if along < length and along > 0 - length:
                across = cosine * y - sine * x >> 13
                if across < width and across > 0 - width:
                    mask |= bit
        bit <<= 1
    return mask


@micropython.viper
def squares_overlapped(outline: ptr32, footprint: ptr32, asked: int) -> int:
    """The mask of those cells of a mask whose squares an outline lies over.

    Two rectangles lie apart where one of their four axes shows a gap.
    """
    widen = int(WIDEN)
    centre_x = outline[_X] << widen >> widen
    centre_y = outline[_Y] << widen >> widen
    cosine = outline[_COSINE] << widen >> widen
    sine = outline[_SINE] << widen >> widen
    length = outline[_HALF_LENGTH]
    width = outline[_HALF_WIDTH]
    upright = cosine if cosine > 0 else 0 - cosine
    aslant = sine if sine > 0 else 0 - sine
    half = footprint[HALF]
    reach_x = half + (upright * length + aslant * width >> 13)
    reach_y = half + (aslant * length + upright * width >> 13)
    shadow = half * (upright + aslant) >> 13
    radius = length + 3 >> 2
    mask = 0
    square = 0
    while asked >> square:
        x = (footprint[SHIFT + 2 * square] << widen >> widen) - centre_x
        y = (footprint[SHIFT + 2 * square + 1] << widen >> widen) - centre_y
        far_x = x if x > 0 else 0 - x
        far_y = y if y > 0 else 0 - y
        if not asked >> square & 1:
            apart = True
        elif outline[_SHAPE] == _DISC:
            far_x = far_x - half >> 2 if far_x > half else 0
            far_y = far_y - half >> 2 if far_y > half else 0
            apart = far_x * far_x + far_y * far_y >= radius * radius
        else:
            along = cosine * x + sine * y >> 13
            across = cosine * y - sine * x >> 13
            apart = far_x > reach_x or far_y > reach_y
            apart = apart or along > length + shadow or along < 0 - length - shadow
            apart = apart or across > width + shadow or across < 0 - width - shadow
        if not apart:
            mask |= 1 << square
        square += 1
    return mask
