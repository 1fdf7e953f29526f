"""A parcel's bottom seen from above: its place, the points under it, and its nearest edge.

Lengths are whole steps of 16 um, so that a product with a cosine fits 30 bits within 0.6 m.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.angle import ARM_UM, ONE, QUARTER_UM, root
from mdms_protocol.compat import WIDEN, const, micropython, ptr32

STEP_UM = const(16)

RECTANGLE = const(0)
DISC = const(1)

# Registers of an outline
X = const(0)  # its centre [steps]
Y = const(1)
COSINE = const(2)  # of its turn [1/8192]
SINE = const(3)
SHAPE = const(4)  # RECTANGLE or DISC
HALF_LENGTH = const(5)  # of a disc its radius [steps]
HALF_WIDTH = const(6)
REGISTERS = const(7)


class Outline:
    """A rectangle about its centre, or a disc; `place` sets its pose [um; any frame].

    `reach_um` is from its centre to its corners. `normal` is how the distance of the edge that
    `edge` has found last depends on the pose, its sign changed [1/1024].
    """

    def __init__(self):
        self.registers = array("i", [0] * REGISTERS)
        self.normal = array("i", [0] * 3)
        self.set(RECTANGLE, 0, 0)
        self.place(0, 0, 0)

    def set(self, shape, length_um, width_um):
        """Take a shape: length and width of a rectangle, or the diameter of a disc [um]."""
        registers = self.registers
        registers[SHAPE] = shape
        registers[HALF_LENGTH] = length_um // (2 * STEP_UM)
        registers[HALF_WIDTH] = width_um // (2 * STEP_UM)
        self.reach_um = length_um // 2
        if shape == RECTANGLE:
            self.reach_um = root((length_um >> 10) ** 2 + (width_um >> 10) ** 2) << 9

    @micropython.native
    def take_shape_of(self, other):
        """Take the shape of another outline."""
        self.reach_um = other.reach_um
        for number in range(SHAPE, REGISTERS):
            self.registers[number] = other.registers[number]

    @micropython.native
    def place(self, x_um, y_um, turn_um):
        """Take a pose; cosine and sine are within 2 of those of its turn."""
        registers = self.registers
        registers[X], registers[Y] = x_um // STEP_UM, y_um // STEP_UM
        quarter = (turn_um + QUARTER_UM // 2) // QUARTER_UM
        # Radians in 1/8192, at most an eighth of a turn from a multiple of the right angle.
        near = (turn_um - quarter * QUARTER_UM) * 8 // 125
        square = near * near >> 13
        most = (ONE // 12 - square // 360) * square >> 13
        cosine = ONE - (square * (ONE // 2 - most // 2) >> 13)
        sine = near * (ONE - (square * (ONE - square // 20) >> 13) // 6) >> 13
        if quarter & 1:
            cosine, sine = -sine, cosine
        if quarter & 2:
            cosine, sine = -cosine, -sine
        registers[COSINE], registers[SINE] = cosine, sine

    @micropython.native
    def edge(self, x, y):
        """How far a point is outside, negative inside [steps]; outside a corner a little less.

        Leaves the direction of the edge that is nearest to it in `normal`.
        """
        registers, normal = self.registers, self.normal
        x, y = x - registers[X], y - registers[Y]
        if registers[SHAPE] == DISC:
            from_centre = root((x >> 2) * (x >> 2) + (y >> 2) * (y >> 2)) * 4
            most = max(from_centre, 1)
            normal[0], normal[1], normal[2] = x * ONE // most >> 3, y * ONE // most >> 3, 0
            return from_centre - registers[HALF_LENGTH]
        cosine, sine = registers[COSINE], registers[SINE]
        along, across = cosine * x + sine * y >> 13, cosine * y - sine * x >> 13
        before_length = abs(along) - registers[HALF_LENGTH]
        before_width = abs(across) - registers[HALF_WIDTH]
        if before_length > before_width:
            # The way outwards, and how far along the edge the point is.
            sign, out_x, out_y, aside = (1 if along > 0 else -1), cosine, sine, -across
        else:
            sign, out_x, out_y, aside = (1 if across > 0 else -1), -sine, cosine, along
        normal[0], normal[1] = sign * out_x >> 3, sign * out_y >> 3
        normal[2] = (sign * aside << 10) // (ARM_UM // STEP_UM)
        return max(before_length, before_width)


@micropython.native
def gap(one, other):
    """How far two outlines are apart by their sides; negative where these show no gap [steps].

    Where a corner is next to a corner, it is less than the distance.
    """
    x, y = other[X] - one[X], other[Y] - one[Y]
    if one[SHAPE] == DISC and other[SHAPE] == DISC:
        between = root((x >> 2) * (x >> 2) + (y >> 2) * (y >> 2)) * 4
        return between - one[HALF_LENGTH] - other[HALF_LENGTH]
    return max(_beyond(one, other, x, y), _beyond(other, one, x, y))


def _beyond(one, other, x, y):
    """How far another outline, with its centre there, lies beyond the sides of a rectangle."""
    if one[SHAPE] == DISC:
        return -(1 << 20)  # it has none
    cosine, sine = one[COSINE], one[SINE]
    if other[SHAPE] == DISC:
        reach_along = reach_across = other[HALF_LENGTH]
    else:
        upright = abs(cosine * other[COSINE] + sine * other[SINE]) >> 13
        aslant = abs(sine * other[COSINE] - cosine * other[SINE]) >> 13
        length, width = other[HALF_LENGTH], other[HALF_WIDTH]
        reach_along = upright * length + aslant * width >> 13
        reach_across = aslant * length + upright * width >> 13
    along, across = abs(cosine * x + sine * y) >> 13, abs(cosine * y - sine * x) >> 13
    return max(along - one[HALF_LENGTH] - reach_along, across - one[HALF_WIDTH] - reach_across)


@micropython.viper
def contains(outline: ptr32, x: int, y: int, limit: int) -> int:
    """1 for a point that is inside the outline, or less than `limit` outside each side [steps]."""
    widen = int(WIDEN)
    x -= outline[X] << widen >> widen
    y -= outline[Y] << widen >> widen
    length = outline[HALF_LENGTH] + limit
    if outline[SHAPE] == DISC:
        # Squares of distances from its centre, in 64 um.
        radius = length + 3 >> 2 if length > 0 else 0
        return 1 if (x >> 2) * (x >> 2) + (y >> 2) * (y >> 2) < radius * radius else 0
    width = outline[HALF_WIDTH] + limit
    cosine = outline[COSINE] << widen >> widen
    sine = outline[SINE] << widen >> widen
    along = cosine * x + sine * y >> 13
    across = cosine * y - sine * x >> 13
    inside = 0 - length < along < length
    return 1 if inside and 0 - width < across and across < width else 0


@micropython.viper
def overlaps_square(outline: ptr32, x: int, y: int, half: int) -> int:
    """1 where the bottom lies over a square about a point, `half` from its centre to its sides.

    Two rectangles lie apart where one of their four axes shows a gap.
    """
    widen = int(WIDEN)
    x -= outline[X] << widen >> widen
    y -= outline[Y] << widen >> widen
    far_x = x if x > 0 else 0 - x
    far_y = y if y > 0 else 0 - y
    length = outline[HALF_LENGTH]
    if outline[SHAPE] == DISC:
        radius = length + 3 >> 2
        far_x = far_x - half >> 2 if far_x > half else 0
        far_y = far_y - half >> 2 if far_y > half else 0
        return 1 if far_x * far_x + far_y * far_y < radius * radius else 0
    width = outline[HALF_WIDTH]
    cosine = outline[COSINE] << widen >> widen
    sine = outline[SINE] << widen >> widen
    upright = cosine if cosine > 0 else 0 - cosine
    aslant = sine if sine > 0 else 0 - sine
    if far_x > half + (upright * length + aslant * width >> 13):
        return 0
    if far_y > half + (aslant * length + upright * width >> 13):
        return 0
    shadow = half * (upright + aslant) >> 13
    along = cosine * x + sine * y >> 13
    across = cosine * y - sine * x >> 13
    if along > length + shadow or along < 0 - length - shadow:
        return 0
    return 0 if across > width + shadow or across < 0 - width - shadow else 1
