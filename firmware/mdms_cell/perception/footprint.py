"""Which cells a parcel covers.

A parcel belongs to the cells whose wheels or sensors are under it; the space between does not
count. It needs the cells whose squares it lies over, since it may move within those squares only.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.angle import ARM_UM
from mdms_cell.perception.outline import STEP_UM, X, Y, contains, overlaps_square
from mdms_cell.perception.place import AXES, DIRECTIONS, OWN, SENSORS
from mdms_protocol.compat import WIDEN, micropython, ptr32

#: A parcel's cells are those under its outline and this much around it [steps].
MARGIN = 10_000 // STEP_UM
#: A parcel keeps this away from the squares of cells that are not promised to it [steps].
CLEARANCE = 4_000 // STEP_UM
#: The points of a cell: its wheels come before its sensors.
POINTS = AXES + SENSORS


class Footprint:
    """The points of a cell and its neighbours, in steps of 16 um from the cell's own centre.

    Neighbours have the cell's own points, shifted. `points` has x and y of each point. `shifts` has
    those of each centre by direction, the cell's own last. `along` is the direction in which each
    wheel pushes, x and y by axis [1/512]. `levers` are the levers of the wheels about a parcel's
    centre, see `find_levers`. `present` is the mask of the neighbours that exist. A parcel that
    comes within `half` of a centre, along x and y, needs that cell. It needs squares and not
    points, because two parcels may not meet between two cells' sensors either.
    """

    def __init__(self, place):
        self._place = place
        self.points = array("i", [0] * (2 * POINTS))
        self.along = array("i", [0] * (2 * AXES))
        self.shifts = array("i", [0] * (2 * (DIRECTIONS + 1)))
        self.levers = array("i", [0] * (AXES * (DIRECTIONS + 1)))
        #: Of a wheel about the cell's own centre: its lever, times the steps of the arm.
        self._moments = array("i", [0] * len(self.levers))
        self.load()

    def load(self):
        """Take over the place's settings."""
        place = self._place
        for axis in range(AXES):
            _put(self.points, axis, place.contact_um(axis))
            # Of 1 / place.UNITY, in 1/512.
            along_x, along_y = place.drive(axis)
            self.along[2 * axis], self.along[2 * axis + 1] = along_x >> 5, along_y >> 5
        for sensor in range(SENSORS):
            _put(self.points, AXES + sensor, place.sensor_um(sensor))
        self.present = place.present()
        for direction in range(DIRECTIONS):
            _put(self.shifts, direction, place.shift_um(direction))
        for wheel in range(len(self.levers)):
            axis = wheel % AXES
            x, y = self.point(wheel // AXES, axis)
            self._moments[wheel] = self.along[2 * axis + 1] * x - self.along[2 * axis] * y
        self.half = place.pitch_um // (2 * STEP_UM) + CLEARANCE

    def point(self, direction, point):
        """Where that cell's point is: x and y."""
        points, shifts = self.points, self.shifts
        x, y = points[2 * point], points[2 * point + 1]
        return shifts[2 * direction] + x, shifts[2 * direction + 1] + y

    @micropython.native
    def within(self, outline, direction, limit, count=POINTS):
        """The mask of that cell's first points that are less than `limit` outside [steps].

        Of the first AXES it has the wheels alone.
        """
        return points_within(outline.registers, self.points, self.shifts, direction, count, limit)

    @micropython.native
    def squares(self, outline, asked, room=0):
        """The mask of those cells in a mask whose squares, with room around, a parcel lies over."""
        return squares_overlapped(outline.registers, self.shifts, self.half + room, asked)

    def reaches(self, outline):
        """Whether the parcel lies over the cell's own square, or nearly."""
        return self.squares(outline, 1 << OWN) != 0

    @micropython.native
    def find_levers(self, outline, directions):
        """Find the `levers` of the wheels of the cells in a mask.

        A lever is how fast a wheel rolls while the parcel turns, in 1/512 of the turn's speed. That
        of axis a in direction d has the number 2 * d + a.
        """
        x, y, along, levers = outline.registers[X], outline.registers[Y], self.along, self.levers
        for axis in range(AXES):
            moment = along[2 * axis + 1] * x - along[2 * axis] * y
            for wheel in range(axis, len(levers), AXES):
                if directions >> wheel // AXES & 1:
                    levers[wheel] = (self._moments[wheel] - moment) // (ARM_UM // STEP_UM)

    @micropython.native
    def wheel_speed(self, direction, axis, twist):
        """How fast that wheel rolls with a parcel of this twist [um/s], by the lever found last."""
        along, (vx, vy, turn) = self.along, twist
        lever = self.levers[AXES * direction + axis]
        return along[2 * axis] * vx + along[2 * axis + 1] * vy + lever * turn >> 9


def _put(numbers, pair, place_um):
    x_um, y_um = place_um
    numbers[2 * pair], numbers[2 * pair + 1] = x_um // STEP_UM, y_um // STEP_UM


@micropython.viper
def points_within(  # noqa: PLR0917 - viper takes words
    outline, points: ptr32, shifts: ptr32, direction: int, count: int, limit: int
) -> int:
    """The mask of a cell's first points that are less than `limit` outside an outline [steps]."""
    widen = int(WIDEN)
    shift_x = shifts[2 * direction] << widen >> widen
    shift_y = shifts[2 * direction + 1] << widen >> widen
    mask = 0
    for point in range(count):
        x = (points[2 * point] << widen >> widen) + shift_x
        y = (points[2 * point + 1] << widen >> widen) + shift_y
        mask |= int(contains(outline, x, y, limit)) << point
    return mask


@micropython.viper
def squares_overlapped(outline, shifts: ptr32, half: int, asked: int) -> int:
    """The mask of those cells of a mask whose squares an outline lies over."""
    widen = int(WIDEN)
    mask = 0
    cell = 0
    while asked >> cell:
        if asked >> cell & 1:
            x = shifts[2 * cell] << widen >> widen
            y = shifts[2 * cell + 1] << widen >> widen
            mask |= int(overlaps_square(outline, x, y, half)) << cell
        cell += 1
    return mask
