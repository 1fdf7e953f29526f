"""What a parcel is and where it is to go: the pages that a host sends and cells hand on."""

from mdms_cell.neighbours.geometry.angle import TURN_UM
from mdms_protocol.neighbours import frames as wire

#: A cell is near one parcel, and may be asked for by a few more.
SLOTS = 4


class Program:
    """One parcel's data and goal, as their pages have them; lengths in um, angles as in `angle`.

    `complete` is whether nothing is lacking.
    """

    def __init__(self):
        self.identity = 0
        self.used = 0
        self._pages = bytearray(2 * wire.LENGTH)
        self.clear(0)

    def clear(self, identity):
        """Begin anew, for this identity."""
        self.identity = identity
        self.sequence = 0
        self.has_parcel = self.has_goal = self.complete = False

    def take(self, fields, frame):
        """Take a page, by its fields and as it came; returns whether it is one that is kept."""
        page = fields[wire.PAGE]
        sequence = fields[wire.PROGRAM_SEQUENCE]
        if page == wire.PARCEL:
            self._take_parcel(fields)
        elif page == wire.GOAL:
            self.goal_x_um = fields[wire.PLACE_X] * wire.STEP_UM
            self.goal_y_um = fields[wire.PLACE_Y] * wire.STEP_UM
            self.goal_turn_um = turn_um(fields[wire.PLACE_YAW])
            self.has_goal = True
            self.sequence = sequence
        else:
            return False
        self.complete = self.has_parcel and self.has_goal
        start = wire.LENGTH if page == wire.GOAL else 0
        self._pages[start : start + wire.LENGTH] = frame
        return True

    def _take_parcel(self, fields):
        self.shape = fields[wire.SHAPE]
        self.length_um = fields[wire.PARCEL_LENGTH] * wire.STEP_UM
        self.width_um = fields[wire.PARCEL_WIDTH] * wire.STEP_UM
        self.acceleration_mm_s2 = fields[wire.ACCELERATION] * wire.ACCELERATION_MM_S2
        self.speed_um_s = fields[wire.SPEED] * wire.SPEED_MM_S * 1000
        self.goes_on = bool(fields[wire.PROGRAM_FLAGS] & wire.GO_ON)
        self.any_yaw = bool(fields[wire.PROGRAM_FLAGS] & wire.ANY_YAW)
        self.has_parcel = True

    def write(self, second, buffer, at):
        """Write the frame of the parcel's page, or with `second` of the goal's, as it came."""
        start = wire.LENGTH if second else 0
        buffer[at : at + wire.LENGTH] = self._pages[start : start + wire.LENGTH]


class Programs:
    """The programs that a cell keeps; the one longest unused makes room for another."""

    def __init__(self):
        self._slots = [Program() for _ in range(SLOTS)]
        self._uses = 0

    def find(self, identity):
        """The program of an identity; None if there is none."""
        for slot in self._slots:
            if identity and slot.identity == identity:
                self._uses += 1
                slot.used = self._uses
                return slot
        return None

    def place_for(self, identity):
        """The program of an identity, begun anew if there is none."""
        found = self.find(identity)
        if found is None:
            found = self._slots[0]
            for slot in self._slots:
                if slot.used < found.used:
                    found = slot
            found.clear(identity)
            self._uses += 1
            found.used = self._uses
        return found

    def go_on(self):
        """Whether a parcel is on its way that goes on without the host."""
        return any(slot.identity and slot.complete and slot.goes_on for slot in self._slots)

    def drop(self, identity):
        """Keep nothing of an identity."""
        found = self.find(identity)
        if found is not None:
            found.clear(0)
            found.used = 0


def turn_um(yaw):
    """An angle of the wire as the way of a point at the arm [um]."""
    return yaw * (TURN_UM // 8) // (wire.TURN // 8)


def wire_yaw(turn):
    """The angle of the wire that is nearest to a turn [um at the arm]."""
    return (turn * (wire.TURN // 8) + TURN_UM // 16) // (TURN_UM // 8)
