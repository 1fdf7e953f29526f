"""Which cells a parcel covers.

It belongs to those whose wheels or sensors are under it, and what lies between does not count. It
needs those whose squares it lies over, which are what it may move within.
"""

try:
    import micropython
except ImportError:
    from mdms_cell.cpython import micropython

from array import array

from mdms_cell.neighbours.outline import STEP_UM
from mdms_cell.neighbours.place import AXES, DIRECTIONS, SENSORS
from mdms_cell.neighbours.twist import WHEEL

#: A parcel's cells are those under its outline and this much around it [steps].
MARGIN = 10_000 // STEP_UM
#: A parcel keeps this away from the squares of cells that are not promised to it [steps].
CLEARANCE = 4_000 // STEP_UM
POINTS = AXES + SENSORS


class Footprint:
    """The points of a cell and its neighbours [steps of 16 um; from the cell's own centre].

    Wheels come before sensors; `x` and `y` are of POINTS points. `present` is the mask of the
    neighbours that there are. Neighbours are cells alike, at
    `shift_x` and `shift_y` by direction.
    """

    def __init__(self, place):
        self._place = place
        self.x = array("i", [0] * POINTS)
        self.y = array("i", [0] * POINTS)
        self.shift_x = array("i", [0] * (DIRECTIONS + 1))
        self.shift_y = array("i", [0] * (DIRECTIONS + 1))
        self.along_x = array("i", [0] * AXES)
        self.along_y = array("i", [0] * AXES)
        #: All wheels that may be heard of, the cell's own last, as `TwistFit` wants them.
        self.wheels = array("i", [0] * (WHEEL * AXES * (DIRECTIONS + 1)))
        self.load()

    def load(self):
        """Take over the place's tables."""
        place = self._place
        for axis in range(AXES):
            self._put(axis, place.contacts, axis)
            # Directions in 1/512, as `twist` wants them.
            self.along_x[axis] = place.drives[2 * axis] >> 5
            self.along_y[axis] = place.drives[2 * axis + 1] >> 5
        for sensor in range(SENSORS):
            self._put(AXES + sensor, place.sensors, sensor)
        for direction in range(DIRECTIONS):
            self.shift_x[direction] = place.shifts[2 * direction] // STEP_UM
            self.shift_y[direction] = place.shifts[2 * direction + 1] // STEP_UM
        self._load_wheels()
        self.present = 0
        for direction in range(DIRECTIONS):
            if place.nodes[direction]:
                self.present |= 1 << direction
        self._half = self._place.pitch_um // (2 * STEP_UM) + CLEARANCE
        self._radius = 0
        for point in range(POINTS):
            # Not the distance itself, but never less.
            self._radius = max(self._radius, abs(self.x[point]) + abs(self.y[point]))

    def _load_wheels(self):
        wheels = self.wheels
        for direction in range(DIRECTIONS + 1):
            for axis in range(AXES):
                at = WHEEL * (AXES * direction + axis)
                wheels[at] = self.shift_x[direction] + self.x[axis]
                wheels[at + 1] = self.shift_y[direction] + self.y[axis]
                wheels[at + 2] = self.along_x[axis]
                wheels[at + 3] = self.along_y[axis]

    def _put(self, point, lengths_um, number):
        self.x[point] = lengths_um[2 * number] // STEP_UM
        self.y[point] = lengths_um[2 * number + 1] // STEP_UM

    def covered(self, outline, direction):
        """Whether the parcel covers a wheel or a sensor of the cell there, or nearly."""
        x, y = self.shift_x[direction], self.shift_y[direction]
        distance = outline.distance(x, y)
        if distance > self._radius + MARGIN:
            return False
        for point in range(POINTS):
            if outline.distance(x + self.x[point], y + self.y[point]) < MARGIN:
                return True
        return False

    def reached(self, outline):
        """Whether the parcel lies over the cell's own square, or nearly."""
        return outline.overlaps(0, 0, self._half)

    @micropython.native
    def mask(self, outline, mask=0):
        """The neighbours whose squares the parcel lies over, or nearly, besides those of a mask.

        Squares, not points: two parcels may not meet between the sensors of two cells either.
        """
        shift_x, shift_y, half = self.shift_x, self.shift_y, self._half
        for direction in range(DIRECTIONS):
            bit = 1 << direction
            if mask & bit or not self.present & bit:
                continue
            if outline.overlaps(shift_x[direction], shift_y[direction], half):
                mask |= bit
        return mask
