"""Where a cell and its up to eight neighbours stand, from the object dictionary.

Lengths are whole micrometres from the cell's own centre, along the axes of the table's frame.
Neighbours are numbered by direction, counterclockwise from +x: 0 east, 1 north-east, 2 north, 3
north-west, 4 west, 5 south-west, 6 south, 7 south-east; the opposite of d is d ^ 4. They are taken
for cells like this one, a pitch away: their wheels and sensors are its own, moved by `shifts`.
"""

from array import array
from math import cos, sin

from mdms_protocol import indices
from mdms_protocol.codecs import cob

DIRECTIONS = 8
#: In the place of a direction: the host.
HOST = 8

# What comes from a neighbour, in the order of its transmit PDOs
SPEEDS = 0
STATE = 1
ESTIMATE = 2
PROGRAM = 3

#: Parts of one in the cosines of `drives`.
UNITY = 1 << 14

AXES = 2
SENSORS = 5

_STEPS = (1, 0, 1, 1, 0, 1, -1, 1, -1, 0, -1, -1, 0, -1, 1, -1)
_MICRO = 1_000_000


class Place:
    """Integer tables, in small ints; `changed()` is called when other nodes are neighbours.

    `column` and `row` count from 1; where one is 0 the place is unknown. `x_um` and `y_um` are the
    cell's centre [table frame]. Of direction d, `nodes[d]` is the node id, 0 for none, and
    `shifts[2 * d]` and the next are where that neighbour's centre is. Of axis a, `contacts[2 * a]`
    and the next are where the wheel touches, `drives[2 * a]` and the next the direction in which it
    pushes [1 / UNITY]. Of sensor s, `sensors[2 * s]` and the next are its place.
    """

    def __init__(self, objects, changed):
        self._objects = objects
        self._changed = changed
        self.nodes = array("B", bytes(DIRECTIONS))
        self.shifts = array("i", bytes(8 * DIRECTIONS))
        self.contacts = array("i", bytes(8 * AXES))
        self.drives = array("i", bytes(8 * AXES))
        self.sensors = array("i", bytes(8 * SENSORS))
        on_setting = self._on_setting
        for index in (indices.PLACE, indices.NEIGHBOURS, indices.SENSOR_OFFSETS):
            objects.watch(index, on_setting)
        for index in (indices.DIRECTION, indices.CONTACT_X, indices.CONTACT_Y):
            for axis in range(AXES):
                objects.watch(index + axis * indices.AXIS_OFFSET, on_setting)
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
        for place, step in enumerate(_STEPS):
            self.shifts[place] = step * self.pitch_um
        for place in range(2 * SENSORS):
            self.sensors[place] = number(indices.SENSOR_OFFSETS, place + 1)
        for axis in range(AXES):
            self._load_axis(axis, axis * indices.AXIS_OFFSET)

    def _load_axis(self, axis, offset):
        number = self._objects.number
        self.contacts[2 * axis] = number(indices.CONTACT_X + offset)
        self.contacts[2 * axis + 1] = number(indices.CONTACT_Y + offset)
        angle_rad = number(indices.DIRECTION + offset) / _MICRO
        self.drives[2 * axis] = round(cos(angle_rad) * UNITY)
        self.drives[2 * axis + 1] = round(sin(angle_rad) * UNITY)

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
        if before != (bytes(self.nodes), self.known):
            self._changed()
