"""Which cells a parcel covers.

It belongs to those whose wheels or sensors are under it, and what lies between does not count. It
needs those whose squares it lies over, which are what it may move within.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.neighbours.geometry.outline import (
    STEP_UM,
    points_by_depth,
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
    neighbours that there are. Neighbours are cells alike, at `shift_x` and `shift_y` by direction.
    `wheels` is of all wheels that may be heard of, the cell's own last: two arrays of their
    places, and by axis two of their directions [1/512].
    """

    def __init__(self, place):
        self._place = place
        self.x = array("i", [0] * POINTS)
        self.y = array("i", [0] * POINTS)
        self.shift_x = array("i", [0] * (DIRECTIONS + 1))
        self.shift_y = array("i", [0] * (DIRECTIONS + 1))
        self.along_x = array("i", [0] * AXES)
        self.along_y = array("i", [0] * AXES)
        wheels = AXES * (DIRECTIONS + 1)
        wheel_x, wheel_y = array("i", [0] * wheels), array("i", [0] * wheels)
        self.wheels = wheel_x, wheel_y, self.along_x, self.along_y
        self.load()

    def load(self):
        """Take over the place's tables."""
        place = self._place
        for axis in range(AXES):
            self._put(axis, place.contacts, axis)
            # Of 1 / place.UNITY, in 1/512.
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

    def _load_wheels(self):
        wheel_x, wheel_y, _, _ = self.wheels
        for direction in range(DIRECTIONS + 1):
            for axis in range(AXES):
                wheel_x[AXES * direction + axis] = self.shift_x[direction] + self.x[axis]
                wheel_y[AXES * direction + axis] = self.shift_y[direction] + self.y[axis]

    def _put(self, point, lengths_um, number):
        self.x[point] = lengths_um[2 * number] // STEP_UM
        self.y[point] = lengths_um[2 * number + 1] // STEP_UM

    def covers(self, outline):
        """Whether the parcel covers a wheel or a sensor of the cell, or nearly."""
        return self.within(outline, DIRECTIONS, MARGIN) != 0

    def within(self, outline, direction, limit):
        """The mask of that cell's points that are less than `limit` outside the outline [steps]."""
        x, y = self.shift_x[direction], self.shift_y[direction]
        return points_within(outline.registers, self.x, self.y, POINTS, x, y, limit)

    def by_depth(self, outline, direction, clear):
        """Three masks of that cell's points in one number; see `points_by_depth`."""
        x, y = self.shift_x[direction], self.shift_y[direction]
        return points_by_depth(outline.registers, self.x, self.y, POINTS, x, y, clear)

    def wheels_under(self, outline):
        """The mask of all wheels that the parcel lies over, two a direction."""
        x, y, _, _ = self.wheels
        return points_within(outline.registers, x, y, AXES * (DIRECTIONS + 1), 0, 0, 0)

    def reaches(self, outline):
        """Whether the parcel lies over the cell's own square, or nearly."""
        return self._squares(outline, 1 << DIRECTIONS) != 0

    def mask(self, outline, mask=0):
        """The neighbours whose squares the parcel lies over, or nearly, besides those of a mask.

        Squares, not points: two parcels may not meet between the sensors of two cells either.
        """
        return mask | self._squares(outline, self.present & ~mask)

    def _squares(self, outline, asked):
        x, y = self.shift_x, self.shift_y
        return squares_overlapped(outline.registers, x, y, self._half, asked)
