"""Presence sensors: their bits without flicker, and the correction of a belief by them.

Edges that pass over sensors correct a belief, and so do sensors that contradict it.
"""

from mdms_cell.perception.belief import CONTRADICTION, EDGE
from mdms_cell.perception.footprint import MARGIN
from mdms_cell.perception.heard import BITS, SEEN
from mdms_cell.perception.outline import STEP_UM, X, Y
from mdms_cell.perception.place import AXES, DIRECTIONS, OWN
from mdms_cell.perception.suspicion import PRESENCE
from mdms_cell.ticks import IDLE_MS, diff
from mdms_protocol.compat import const, micropython

#: An edge passes over a sensor no slower.
_PASSING_UM_S = const(1_000)
_PRESENCE_BITS = const(8)


class Presence:
    """The debounced presence sensors: a bit counts once it has read the same for a while.

    `bits` has bit k for sensor k.

    A sensor has to differ from `bits` for `debounce_ms` before its bit changes. So every change is
    late by that time, and by more only if a wrong reading comes between.
    """

    def __init__(self):
        self.bits = 0
        self.debounce_ms = 0
        self._differing = 0
        self._since_ms = [0] * _PRESENCE_BITS

    def read(self):
        """The bits, as the object dictionary has them."""
        return self.bits

    def step(self, reading, now_ms):
        """Take in a reading; in how many milliseconds another is due, if none differs before."""
        differing = reading ^ self.bits
        begun = differing & ~self._differing
        wait_ms = IDLE_MS
        for sensor in range(_PRESENCE_BITS if differing else 0):
            bit = 1 << sensor
            if not differing & bit:
                continue
            if begun & bit:
                self._since_ms[sensor] = now_ms
            left_ms = self.debounce_ms - diff(now_ms, self._since_ms[sensor])
            if left_ms <= 0:
                self.bits ^= bit
                differing ^= bit
            elif left_ms < wait_ms:
                wait_ms = left_ms
        self._differing = differing
        return wait_ms


class Comparison:
    """A cell's presence bits beside the outline of a parcel.

    `wrong` is the mask of the sensors on the wrong side of it. `missing` is whether all sensors
    deep under it are free. `far` is whether a sensor far from it is covered. `clearly` is whether
    there are sensors deep under it or far from it. `nearly` is whether it covers a wheel or a
    sensor, or nearly, as in `Tracking.look`.
    """

    def __init__(self):
        self.wrong = 0
        self.missing = self.far = self.clearly = self.nearly = False

    @micropython.native
    def find(self, outline, footprint, direction, bits):
        """Compare the bits of a cell."""
        bits &= BITS
        deep = footprint.within(outline, direction, -MARGIN) >> AXES
        outside = BITS & ~(footprint.within(outline, direction, MARGIN + 1) >> AXES)
        self.wrong = footprint.within(outline, direction, 0) >> AXES ^ bits
        self.missing = deep != 0 and deep & bits == 0
        self.far = outside & bits != 0
        self.clearly = (deep | outside) != 0
        self.nearly = footprint.within(outline, direction, MARGIN) != 0


class Sensors:
    """The sensors of a cell and of its neighbours, as they show the parcel that `tracking` follows.

    An edge is reported `edge_late_ms` after it has passed the sensor.
    """

    def __init__(self, tracking, footprint, heard, suspicion):
        self._tracking = tracking
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self.edge_late_ms = 1
        self._own = Comparison()
        self._other = Comparison()
        self.reset()

    def reset(self):
        """Another parcel, or none."""
        #: Whose sensors are compared in this beat, beside the cell's own: a direction, or OWN.
        self.turn = 0

    # The beat

    @micropython.native
    def check(self, sync_ms):
        """Correct the belief of a cell under a parcel, until the last SYNC.

        Contradictions count of the cell's own sensors and, in turns, of a neighbour's. The parcel
        is seen by the cell's own sensors or, where it covers none of them, by any around.
        """
        heard, tracking, suspicion = self._heard, self._tracking, self._suspicion
        if heard.edges:
            self.take_edges(sync_ms)
        cases = suspicion.cases >> PRESENCE & 1
        turn = self.turn = self.turn + 1 if self.turn < OWN else 0
        bits = heard.presence[OWN]
        own = self._compare(self._own, OWN)
        missing = bits & SEEN and own.missing
        moved = False
        if bits & SEEN and not turn & 3 and (own.wrong or cases):
            moved = self.weigh(OWN, own, 0)
        if turn != OWN and self._footprint.present >> turn & 1 and not tracking.others >> turn & 1:
            its = self._compare(self._other, turn)
            age_ms = heard.age_ms(turn, sync_ms) if its.wrong or cases else -1
            if age_ms >= 0:
                moved |= self.weigh(turn, its, age_ms)
        if moved:
            self._compare(own, OWN)
        tracking.under = own.nearly
        missing = missing and not (tracking.is_witnessed() and suspicion.has(OWN, PRESENCE))
        if missing or not (bits & BITS or self.is_anything_there()):
            tracking.miss()
        else:
            tracking.missing_beats = 0

    @micropython.native
    def _compare(self, comparison, direction):
        bits = self._heard.presence[direction]
        comparison.find(self._tracking.belief, self._footprint, direction, bits)
        return comparison

    # Edges

    @micropython.native
    def take_edges(self, sync_ms):
        """Take in the edges that sensors have seen until the last SYNC.

        A frame may be 3 ms late, and the parcel has moved on meanwhile.
        """
        heard, tracking, suspicion = self._heard, self._tracking, self._suspicion
        late = tracking.belief.speed() * 3 // 62_500
        for number in range(heard.edges):
            ago_ms = diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms
            if ago_ms <= 0:
                continue
            direction, _, covered = heard.edge(number)
            if tracking.others >> direction & 1 or suspicion.has(direction, PRESENCE):
                continue
            x, y = self._edge_at(number, ago_ms)
            if self._passes(x, y, covered) and not self._is_late(number, ago_ms):
                tracking.belief.correct(x, y, EDGE + late * late)

    @micropython.native
    def _edge_at(self, number, ago_ms):
        """Where that edge is now: it has moved on with the parcel since a sensor saw it."""
        tracking = self._tracking
        centre = tracking.belief.registers
        direction, sensor, _ = self._heard.edge(number)
        x, y = self._footprint.point(direction, AXES + sensor)
        vx, vy, turn = tracking.belief.twist.speeds
        turned = turn * ago_ms // 128_000
        return (
            x + vx * ago_ms // 16_000 - (y - centre[Y]) * turned // 1000,
            y + vy * ago_ms // 16_000 + (x - centre[X]) * turned // 1000,
        )

    @micropython.native
    def _is_late(self, number, ago_ms):
        """Whether that edge may be older, because a frame was lost.

        Sensors that one frame shows to have changed are as far from the edge, within 2 mm.
        """
        heard, outline = self._heard, self._tracking.belief
        direction, came_ms = heard.edge_bytes[number] >> 4, heard.edge_ms[number]
        # The cell's own come in no frame.
        for other in range(heard.edges if direction != OWN else 0):
            if heard.edge_bytes[other] >> 4 == direction and heard.edge_ms[other] == came_ms:
                off = outline.edge(*self._edge_at(number, ago_ms))
                if abs(off - outline.edge(*self._edge_at(other, ago_ms))) > 2_000 // STEP_UM:
                    return True
        return False

    @micropython.native
    def _passes(self, x, y, covered):
        """Whether the parcel's edge passes over a point in the sense in which its sensor changed.

        An edge at rest, or against the motion, comes from the sensor, not from the parcel.
        """
        tracking = self._tracking
        vx, vy, turn = tracking.belief.twist.speeds
        normal = tracking.belief.normal
        tracking.belief.edge(x, y)
        outwards = normal[0] * vx + normal[1] * vy >> 10
        outwards += normal[2] * turn >> 10
        return outwards > _PASSING_UM_S if covered else outwards < -_PASSING_UM_S

    def drop_edges(self, sync_ms):
        """Keep the edges that came after the last SYNC for the next update."""
        heard = self._heard
        kept = 0
        for number in range(heard.edges):
            if diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms <= 0:
                heard.edge_bytes[kept] = heard.edge_bytes[number]
                heard.edge_ms[kept] = heard.edge_ms[number]
                kept += 1
        heard.edges = kept

    # Contradictions

    def show_another(self):
        """Whether something else covers a sensor of the cell.

        It is 30 mm from the parcel, which cannot be so far off its place.
        """
        bits, belief = self._heard.presence[OWN] & BITS, self._tracking.belief
        if not bits or not belief.known or not self._suspicion.trusts(OWN):
            return False
        near = self._footprint.within(belief, OWN, 30_000 // STEP_UM) >> AXES
        return bits & ~near != 0

    def is_anything_there(self):
        """Whether a sensor of a neighbour is covered; by this parcel, as far as is known.

        A cell whose own sensors the parcel does not cover cannot see by them that it is gone.
        """
        presence, tracking = self._heard.presence, self._tracking
        for direction in range(DIRECTIONS):
            covered = presence[direction] & BITS and not tracking.others >> direction & 1
            if covered and self._suspicion.trusts(direction):
                return True
        return False

    def weigh(self, direction, found, age_ms):
        """Judge a cell's sensors by the result, or correct the belief by them.

        Return whether that may have moved it.
        """
        if found.clearly and (direction != OWN or self.turn == OWN):
            self._judge(direction, found.missing or found.far)
        wrong = found.wrong
        if not wrong or not self._suspicion.trusts(direction):
            return False
        self._pull(direction, wrong, age_ms)
        return True

    def _judge(self, direction, contradict):
        """A cell's sensors do or do not contradict by far what others than that cell believe, too.

        Where several do at once, the belief is wrong, and no sensor.
        """
        tracking = self._tracking
        judges = tracking.is_witnessed() if direction == OWN else tracking.is_sure()
        if judges and not (contradict and self._suspicion.crowd()):
            self._suspicion.judge(direction, PRESENCE, contradict)

    def _pull(self, direction, wrong, age_ms):
        """Correct the belief by these sensors, which are on the wrong side of its edge.

        One may have changed since, and the frame got lost, while the parcel has moved on by up to
        32 mm.
        """
        tracking = self._tracking
        late = min(tracking.belief.speed() * age_ms // 62_500, 32 * 16)
        point = AXES
        while wrong:
            if wrong & 1:
                x, y = self._footprint.point(direction, point)
                tracking.belief.correct(x, y, CONTRADICTION + late * late, False)
            wrong >>= 1
            point += 1
