"""A parcel's bottom seen from above: which points lie under it, and where its nearest edge is.

Lengths are whole steps of 16 um, so that a product with a cosine fits 30 bits within 0.6 m.
"""

try:
    import micropython
except ImportError:
    from mdms_cell.cpython import micropython

try:
    from micropython import const
except ImportError:
    from mdms_cell.cpython import const

from mdms_cell.neighbours.angle import ARM_UM, ONE, cosine, root, sine

STEP_UM = const(16)
_ARM = const(8000)
assert _ARM * STEP_UM == ARM_UM

RECTANGLE = const(0)
DISC = const(1)


class Outline:
    """A rectangle about its centre, or a disc; `place` sets its pose [um; any frame].

    `x`, `y`, `half_length` and `half_width` are in steps, `cosine` and `sine` of its turn in
    1/8192.

    `edge` leaves where the nearest edge lies in `normal_x`, `normal_y` and `lever`: the derivative
    of the distance by the pose, its sign changed, in 1/1024.
    """

    def __init__(self):
        self.set(RECTANGLE, 0, 0)
        self.place(0, 0, 0)
        self.normal_x = self.normal_y = self.lever = 0

    def set(self, shape, length_um, width_um):
        """Take a shape: length and width of a rectangle, or the diameter of a disc [um]."""
        self.shape = shape
        self.half_length = length_um // (2 * STEP_UM)
        self.half_width = width_um // (2 * STEP_UM)
        self.reach_um = length_um // 2
        if shape == RECTANGLE:
            self.reach_um = root((length_um >> 10) ** 2 + (width_um >> 10) ** 2) << 9

    def place(self, x_um, y_um, turn_um):
        """Take a pose."""
        self.x = x_um // STEP_UM
        self.y = y_um // STEP_UM
        self.cosine = cosine(turn_um)
        self.sine = sine(turn_um)

    @micropython.native
    def distance(self, x, y):
        """How far a point is outside, negative inside [steps]; outside a corner a little less."""
        x -= self.x
        y -= self.y
        if self.shape == DISC:
            return root((x >> 2) ** 2 + (y >> 2) ** 2) * 4 - self.half_length
        along = abs(self.cosine * x + self.sine * y >> 13) - self.half_length
        across = abs(self.cosine * y - self.sine * x >> 13) - self.half_width
        return along if along > across else across

    @micropython.native
    def overlaps(self, x, y, half):
        """Whether the bottom lies over a square about a point [steps; half its side].

        Two rectangles lie apart where one of their four axes shows a gap.
        """
        x -= self.x
        y -= self.y
        if self.shape == DISC:
            x, y = max(abs(x) - half, 0), max(abs(y) - half, 0)
            return root((x >> 2) ** 2 + (y >> 2) ** 2) * 4 < self.half_length
        cosine, sine = abs(self.cosine), abs(self.sine)
        length, width = self.half_length, self.half_width
        if abs(x) > half + (cosine * length + sine * width >> 13):
            return False
        if abs(y) > half + (sine * length + cosine * width >> 13):
            return False
        shadow = half * (cosine + sine) >> 13
        if abs(self.cosine * x + self.sine * y >> 13) > length + shadow:
            return False
        return abs(self.cosine * y - self.sine * x >> 13) <= width + shadow

    def edge(self, x, y):
        """The distance of a point, with the direction of the edge that is nearest to it."""
        x -= self.x
        y -= self.y
        if self.shape == DISC:
            return self._rim(x, y)
        along = self.cosine * x + self.sine * y >> 13
        across = self.cosine * y - self.sine * x >> 13
        before_length = abs(along) - self.half_length
        before_width = abs(across) - self.half_width
        if before_length > before_width:
            sign = 1 if along > 0 else -1
            self._face(sign * self.cosine, sign * self.sine, -sign * across)
            return before_length
        sign = 1 if across > 0 else -1
        self._face(-sign * self.sine, sign * self.cosine, sign * along)
        return before_width

    def _face(self, normal_x, normal_y, lever):
        self.normal_x = normal_x >> 3
        self.normal_y = normal_y >> 3
        self.lever = (lever << 10) // _ARM

    def _rim(self, x, y):
        from_centre = root((x >> 2) ** 2 + (y >> 2) ** 2) * 4
        most = max(from_centre, 1)
        self._face(x * ONE // most, y * ONE // most, 0)
        return from_centre - self.half_length
