"""Places of a cell and its up to eight neighbours, from the object dictionary.

Lengths are whole micrometres from the cell's own centre, along the axes of the table's frame.
Directions are numbered counterclockwise in steps of 45 degrees, from 0 for +x (east) to 7 for
south-east. The opposite of d is d ^ 4. Neighbours are taken for cells like this one, a pitch away.
Their wheels and sensors are its own, moved by `shift_um`.
"""

from array import array
from math import cos, sin

from mdms_protocol import indices
from mdms_protocol.codecs import cob

DIRECTIONS = 8
#: In the place of a direction: the cell itself, and the host.
OWN = 8
HOST = 8

# Kinds of frames of a neighbour, in the order of its transmit PDOs
SPEEDS = 0
STATE = 1
ESTIMATE = 2
PROGRAM = 3

#: Parts of one in the cosines of `drive`.
UNITY = 1 << 14

AXES = 2
SENSORS = 5

#: How far each neighbour is along x and y [pitches].
STEPS = (1, 0, 1, 1, 0, 1, -1, 1, -1, 0, -1, -1, 0, -1, 1, -1)


class Place:
    """Integer tables, in small ints; `changed(others)` is called when a setting is written.

    `others` is whether other nodes are neighbours now, or the place is known for the first time.
    `column` and `row` count from 1, and 0 means that the place is unknown. `x_um` and `y_um` are
    the cell's centre [table frame]. `nodes[d]` is the node id in direction d, 0 for none.
    """

    def __init__(self, objects, changed):
        self._objects = objects
        self._changed = changed
        self.nodes = array("B", bytes(DIRECTIONS))
        on_setting = self._on_setting
        objects.watch(on_setting, indices.PLACE, indices.NEIGHBOURS, indices.SENSOR_OFFSETS)
        for axis in range(AXES):
            at = axis * indices.AXIS_OFFSET
            own = (indices.DIRECTION + at, indices.CONTACT_X + at, indices.CONTACT_Y + at)
            objects.watch(on_setting, *own)
        self.load()

    @property
    def known(self):
        """Whether the cell has been given its place."""
        return self.column != 0 and self.row != 0

    def names(self, node_id):
        """Whether that node is among the neighbours."""
        return any(each == node_id for each in self.nodes)

    def load(self):
        """Take over everything from the dictionary."""
        number = self._objects.number
        self.column, self.row = number(indices.PLACE, 1), number(indices.PLACE, 2)
        self.x_um, self.y_um = number(indices.PLACE, 3), number(indices.PLACE, 4)
        self.pitch_um = number(indices.PLACE, 5)
        for direction in range(DIRECTIONS):
            self.nodes[direction] = number(indices.NEIGHBOURS, direction + 1)

    def present(self):
        """The mask of the directions in which there is a neighbour."""
        mask = 0
        for direction in range(DIRECTIONS):
            if self.nodes[direction]:
                mask |= 1 << direction
        return mask

    def direction_of(self, column, row):
        """The direction of the neighbour at this column and row; None if there is none."""
        step = column - self.column, row - self.row
        for direction in range(DIRECTIONS):
            if step == STEPS[2 * direction : 2 * direction + 2] and self.nodes[direction]:
                return direction
        return None

    def shift_um(self, direction):
        """Where the centre of a neighbour is [from the cell's own centre]."""
        return STEPS[2 * direction] * self.pitch_um, STEPS[2 * direction + 1] * self.pitch_um

    def contact_um(self, axis):
        """Where the wheel of an axis touches [from the cell's own centre]."""
        number, offset = self._objects.number, axis * indices.AXIS_OFFSET
        return number(indices.CONTACT_X + offset), number(indices.CONTACT_Y + offset)

    def drive(self, axis):
        """The direction in which that wheel pushes [1 / UNITY]."""
        angle_rad = self._objects.number(indices.DIRECTION + axis * indices.AXIS_OFFSET) / 1_000_000
        return round(cos(angle_rad) * UNITY), round(sin(angle_rad) * UNITY)

    def sensor_um(self, sensor):
        """Where a sensor is [from the cell's own centre]."""
        number = self._objects.number
        return tuple(number(indices.SENSOR_OFFSETS, 2 * sensor + place) for place in (1, 2))

    def receivers(self):
        """Identifier, kind and direction of all that the cell takes from its neighbours and host.

        The host's only kind is a program, under the identifier of RPDO 3, if that is valid.
        """
        for direction in range(DIRECTIONS):
            node_id = self.nodes[direction]
            if node_id:
                for kind in range(len(cob.TPDO_BASES)):
                    yield cob.TPDO_BASES[kind] + node_id, kind, direction
        cob_id = self._objects.number(indices.RPDO_PARAMETERS + 2, 1)
        if not cob_id & cob.INVALID:
            yield cob_id & cob.IDENTIFIER, PROGRAM, HOST

    def _on_setting(self, _index, _sub):
        before = bytes(self.nodes), self.known
        self.load()
        self._changed(before != (bytes(self.nodes), self.known))
