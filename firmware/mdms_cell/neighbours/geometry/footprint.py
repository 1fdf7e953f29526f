"""Which cells a parcel covers.

It belongs to those whose wheels or sensors are under it, and what lies between does not count. It
needs those whose squares it lies over, which are what it may move within.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
except ImportError:
    from mdms_protocol.cpython import micropython

from array import array

from mdms_cell.neighbours.geometry.outline import (
    STEP_UM,
    points_within,
    squares_overlapped,
)
from mdms_cell.neighbours.geometry.place import AXES, DIRECTIONS, SENSORS

#: A parcel's cells are those under its outline and this much around it [steps].
MARGIN = 10_000 // STEP_UM
#: A parcel keeps this away from the squares of cells that are not promised to it [steps].
CLEARANCE = 4_000 // STEP_UM
POINTS = AXES + SENSORS


class Footprint:
    """The points of a cell and its neighbours [steps of 16 um; from the cell's own centre].

    Wheels come before sensors; `x` and `y` are of POINTS points. `present` is the mask of the
    neighbours that there are. Neighbours are cells alike, at `shift_x` and `shift_y` by direction,
    where the cell itself comes last; a parcel that comes within `half` a square of their centres
    needs them. Squares, not points: two parcels may not meet between the sensors of two cells
    either. `along_x` and `along_y` are the directions of wheels by axis [1/512].
    """

    def __init__(self, place):
        self._place = place
        self.x = array("i", [0] * POINTS)
        self.y = array("i", [0] * POINTS)
        self.shift_x = array("i", [0] * (DIRECTIONS + 1))
        self.shift_y = array("i", [0] * (DIRECTIONS + 1))
        self.along_x = array("i", [0] * AXES)
        self.along_y = array("i", [0] * AXES)
        self.load()

    def load(self):
        """Take over the place's tables."""
        place = self._place
        for axis in range(AXES):
            self._put(axis, place.contact_um(axis))
            # Of 1 / place.UNITY, in 1/512.
            along_x, along_y = place.drive(axis)
            self.along_x[axis], self.along_y[axis] = along_x >> 5, along_y >> 5
        for sensor in range(SENSORS):
            self._put(AXES + sensor, place.sensor_um(sensor))
        for direction in range(DIRECTIONS):
            self.shift_x[direction] = place.shifts[2 * direction] // STEP_UM
            self.shift_y[direction] = place.shifts[2 * direction + 1] // STEP_UM
        self.present = 0
        for direction in range(DIRECTIONS):
            if place.nodes[direction]:
                self.present |= 1 << direction
        self.half = self._place.pitch_um // (2 * STEP_UM) + CLEARANCE

    def _put(self, point, place_um):
        x_um, y_um = place_um
        self.x[point], self.y[point] = x_um // STEP_UM, y_um // STEP_UM

    @micropython.native
    def covers(self, outline):
        """Whether the parcel covers a wheel or a sensor of the cell, or nearly."""
        return points_within(outline.registers, self.x, self.y, POINTS, 0, 0, MARGIN) != 0

    @micropython.native
    def within(self, outline, direction, limit, points=POINTS):
        """The mask of that cell's points that are less than `limit` outside the outline [steps]."""
        x, y = self.shift_x[direction], self.shift_y[direction]
        return points_within(outline.registers, self.x, self.y, points, x, y, limit)

    def reaches(self, outline):
        """Whether the parcel lies over the cell's own square, or nearly."""
        x, y = self.shift_x, self.shift_y
        return squares_overlapped(outline.registers, x, y, self.half, 1 << DIRECTIONS) != 0
