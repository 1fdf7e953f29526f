"""A parcel's bottom seen from above: where it lies, and where its nearest edge is.

Lengths are whole steps of 16 um, so that a product with a cosine fits 30 bits within 0.6 m.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.angle import ARM_UM, ONE, QUARTER_UM, root
from mdms_protocol.compat import WIDEN, const, micropython, ptr32

STEP_UM = const(16)
# What is used in every beat; constants of another module would be looked up.
_ARM = const(8000)
_ONE = const(8192)
_QUARTER_UM = const(201_062)
assert (_ARM * STEP_UM, _ONE, _QUARTER_UM) == (ARM_UM, ONE, QUARTER_UM)

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
NORMAL_X = const(7)  # of the edge that `edge` found last: the derivative of its distance by the
NORMAL_Y = const(8)  # pose, its sign changed [1/1024]
LEVER = const(9)
#: Those of its belief and of its twist follow in the same array; see `belief` and `twist`.
REGISTERS = const(10)
REACH = const(31)  # from its centre to its corners [um]
_ALL_REGISTERS = const(32)


class Outline:
    """A rectangle about its centre, or a disc; `place` sets its pose [um; any frame]."""

    def __init__(self):
        self.registers = array("i", [0] * _ALL_REGISTERS)
        self.set(RECTANGLE, 0, 0)
        self.place(0, 0, 0)

    def set(self, shape, length_um, width_um):
        """Take a shape: length and width of a rectangle, or the diameter of a disc [um]."""
        registers = self.registers
        registers[SHAPE] = shape
        registers[HALF_LENGTH] = length_um // (2 * STEP_UM)
        registers[HALF_WIDTH] = width_um // (2 * STEP_UM)
        registers[REACH] = length_um // 2
        if shape == RECTANGLE:
            registers[REACH] = root((length_um >> 10) ** 2 + (width_um >> 10) ** 2) << 9

    def place(self, x_um, y_um, turn_um):
        """Take a pose."""
        place(self.registers, x_um, y_um, turn_um)

    def edge(self, x, y):
        """How far a point is outside, negative inside [steps]; outside a corner a little less.

        Leaves where the edge that is nearest to it lies in NORMAL_X, NORMAL_Y and LEVER.
        """
        return edge(self.registers, x, y)


@micropython.viper
def place(outline: ptr32, x_um: int, y_um: int, turn_um: int):
    """Set the pose of an outline; cosine and sine are within 2 of those of its turn."""
    outline[X] = x_um // STEP_UM
    outline[Y] = y_um // STEP_UM
    quarter = (turn_um + _QUARTER_UM // 2) // _QUARTER_UM
    # Radians in 1/8192, at most an eighth of a turn from a multiple of the right angle.
    near = (turn_um - quarter * _QUARTER_UM) * 8 // 125
    square = near * near >> 13
    most = (_ONE // 12 - square // 360) * square >> 13
    cosine = _ONE - (square * (_ONE // 2 - most // 2) >> 13)
    sine = near * (_ONE - (square * (_ONE - square // 20) >> 13) // 6) >> 13
    if quarter & 1:
        cosine, sine = 0 - sine, cosine
    if quarter & 2:
        cosine, sine = 0 - cosine, 0 - sine
    outline[COSINE] = cosine
    outline[SINE] = sine


@micropython.viper
def edge(outline: ptr32, x: int, y: int) -> int:
    """How far a point is outside; see `Outline.edge`."""
    widen = int(WIDEN)
    x -= outline[X] << widen >> widen
    y -= outline[Y] << widen >> widen
    if outline[SHAPE] == DISC:
        from_centre = int(root((x >> 2) * (x >> 2) + (y >> 2) * (y >> 2))) * 4
        most = from_centre if from_centre > 1 else 1
        outline[NORMAL_X] = x * _ONE // most >> 3
        outline[NORMAL_Y] = y * _ONE // most >> 3
        outline[LEVER] = 0
        return from_centre - outline[HALF_LENGTH]
    cosine = outline[COSINE] << widen >> widen
    sine = outline[SINE] << widen >> widen
    along = cosine * x + sine * y >> 13
    across = cosine * y - sine * x >> 13
    before_length = (along if along > 0 else 0 - along) - outline[HALF_LENGTH]
    before_width = (across if across > 0 else 0 - across) - outline[HALF_WIDTH]
    if before_length > before_width:
        distance = before_length
        sign = 1 if along > 0 else -1
        outline[NORMAL_X] = sign * cosine >> 3
        outline[NORMAL_Y] = sign * sine >> 3
        outline[LEVER] = (0 - sign * across << 10) // _ARM
    else:
        distance = before_width
        sign = 1 if across > 0 else -1
        outline[NORMAL_X] = 0 - sign * sine >> 3
        outline[NORMAL_Y] = sign * cosine >> 3
        outline[LEVER] = (sign * along << 10) // _ARM
    return distance
