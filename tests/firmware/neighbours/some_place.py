"""A place for a footprint, made of numbers in place of objects."""

from mdms_cell.perception.place import AXES, DIRECTIONS, SENSORS, STEPS


class SomePlace:
    """A cell with these points, wheels before sensors [um], which push along `drives`.

    Its neighbours are at `shifts_um` by direction; they all are there.
    """

    pitch_um = 127_000

    def __init__(
        self,
        points_um=((0, 0),) * (AXES + SENSORS),
        drives=((16384, 0), (0, 16384)),
        shifts_um=((0, 0),) * 8,
    ):
        self._points_um = points_um
        self._drives = drives
        self._shifts_um = shifts_um

    def contact_um(self, axis):
        """Where a wheel touches."""
        return self._points_um[axis]

    def sensor_um(self, sensor):
        """Where a sensor is."""
        return self._points_um[AXES + sensor]

    def drive(self, axis):
        """The direction of a wheel."""
        return self._drives[axis]

    def present(self):
        """All neighbours."""
        return 255

    def shift_um(self, direction):
        """Where a neighbour is."""
        return self._shifts_um[direction]


#: The wheels and sensors of a cell, and eight neighbours a pitch away [um].
WHEELS_UM = ((0, -30_000), (30_000, 0))
SENSORS_UM = ((0, 0), (40_000, 40_000), (40_000, -40_000), (-40_000, 40_000), (-40_000, -40_000))
SHIFTS_UM = [
    tuple(SomePlace.pitch_um * step for step in STEPS[2 * direction : 2 * direction + 2])
    for direction in range(DIRECTIONS)
]
