"""Corrects a belief by sensors: by edges that pass over them, and by those that contradict it."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from mdms_cell.perception.belief import CONTRADICTION, EDGE
from mdms_cell.perception.footprint import POINT_X, POINT_Y, POINTS, PRESENT, SHIFT
from mdms_cell.perception.heard import BITS, OWN, SEEN
from mdms_cell.perception.outline import (
    COSINE,
    DISC,
    HALF_LENGTH,
    HALF_WIDTH,
    LEVER,
    NORMAL_X,
    NORMAL_Y,
    SHAPE,
    SINE,
    X,
    Y,
)
from mdms_cell.perception.place import AXES, DIRECTIONS
from mdms_cell.perception.suspicion import CASES, PRESENCE
from mdms_cell.ticks import diff
from mdms_protocol.compat import WIDEN, const, micropython, ptr8, ptr32

#: A frame may be this late; the parcel has moved on meanwhile.
_LATENCY_MS = const(3)
#: An edge passes over a sensor no slower.
_PASSING_UM_S = const(1_000)
#: A sensor so far inside the outline has to be covered, one so far outside free, 10 mm [steps].
_CLEAR = const(625)
#: A sensor so far outside is not covered by this parcel, whatever its place is off, 30 mm [steps].
_ELSEWHERE = const(1875)
#: A parcel moves on by no more than this while a state is lost, 32 mm [1/16 mm].
_MOST_LATE = const(512)
#: Sensors that one frame shows to have changed are as far from the edge, 2 mm [steps].
_TOGETHER = const(125)

# What is used in every beat; constants of another module would be looked up.
_OWN = const(8)
_PRESENCE = const(0)
_CASES = const(45)
_AXES = const(2)
_POINTS = const(7)
_X = const(0)
_Y = const(1)
_COSINE = const(2)
_SINE = const(3)
_SHAPE = const(4)
_HALF_LENGTH = const(5)
_HALF_WIDTH = const(6)
_DISC = const(1)
_POINT_Y = const(7)
_SHIFT = const(18)
_SEEN = const(0x80)
_BITS = const(0x1F)
assert (_SEEN, _BITS) == (SEEN, BITS)
_PRESENT = const(36)
assert (0, _POINT_Y, _SHIFT, _PRESENT) == (POINT_X, POINT_Y, SHIFT, PRESENT)
assert (_OWN, _PRESENCE, _CASES) == (OWN, PRESENCE, CASES)
assert (_AXES, _POINTS) == (AXES, POINTS)
assert (_X, _Y, _COSINE, _SINE, _SHAPE) == (X, Y, COSINE, SINE, SHAPE)
assert (_HALF_LENGTH, _HALF_WIDTH, _DISC) == (HALF_LENGTH, HALF_WIDTH, DISC)

# What `_compare` finds: the mask of sensors on the wrong side of the outline, and bits
_WRONG = const(31)
_MISSING = const(32)  # all sensors deep under it are free
_FAR = const(64)  # a sensor far from it is covered
_CLEARLY = const(128)  # there are sensors deep under it, or far from it
_NEARLY = const(256)  # it covers a wheel or a sensor, or nearly, as by `Footprint.covers`


class Sensors:
    """What the sensors of a cell and of its neighbours show of the parcel that `tracking` follows.

    An edge is reported `edge_late_ms` after it has passed the sensor.
    """

    def __init__(self, tracking, footprint, heard, suspicion):
        self._tracking = tracking
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self.edge_late_ms = 1
        self.turn = 0

    # Edges

    @micropython.native
    def take_edges(self, sync_ms):
        """Take in the edges that sensors have seen until the last SYNC."""
        heard, tracking, suspicion = self._heard, self._tracking, self._suspicion
        late = tracking.belief.speed() * _LATENCY_MS // 62_500
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
        vx, vy, turn = tracking.belief.speeds()
        turned = turn * ago_ms // 128_000
        return (
            x + vx * ago_ms // 16_000 - (y - centre[Y]) * turned // 1000,
            y + vy * ago_ms // 16_000 + (x - centre[X]) * turned // 1000,
        )

    @micropython.native
    def _is_late(self, number, ago_ms):
        """Whether that edge may be older: others of its frame are elsewhere, so one was lost."""
        heard, outline = self._heard, self._tracking.belief
        others = _of_one_frame(heard.edge_bytes, heard.edge_ms, heard.edges, number)
        if not others:
            return False
        off = outline.edge(*self._edge_at(number, ago_ms))
        for other in range(heard.edges):
            if others >> other & 1:
                between = off - outline.edge(*self._edge_at(other, ago_ms))
                if not -_TOGETHER <= between <= _TOGETHER:
                    return True
        return False

    @micropython.native
    def _passes(self, x, y, covered):
        """Whether the parcel's edge passes over a point in the sense in which its sensor changed.

        An edge at rest, or against the motion, comes from the sensor, not from the parcel.
        """
        tracking = self._tracking
        vx, vy, turn = tracking.belief.speeds()
        edge = tracking.belief.registers
        tracking.belief.edge(x, y)
        outwards = edge[NORMAL_X] * vx + edge[NORMAL_Y] * vy >> 10
        outwards += edge[LEVER] * turn >> 10
        return outwards > _PASSING_UM_S if covered else outwards < -_PASSING_UM_S

    def drop_edges(self, sync_ms):
        """Keep the edges that came after the last SYNC for the next update."""
        heard = self._heard
        kept = 0
        for number in range(heard.edges):
            if diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms <= 0:
                heard.keep_edge(number, kept)
                kept += 1
        heard.edges = kept

    # Contradictions

    def show_another(self):
        """Whether something else covers a sensor of the cell: one far from the parcel."""
        bits = self._heard.presence[OWN] & _BITS
        if not bits or not self._suspicion.trusts(OWN):
            return False
        near = self._footprint.within(self._tracking.belief, OWN, _ELSEWHERE) >> AXES
        return bits & ~near != 0

    def is_anything_there(self):
        """Whether a sensor of a neighbour is covered; by this parcel, as far as is known.

        A cell whose own sensors the parcel does not cover cannot see by them that it is gone.
        """
        presence, tracking = self._heard.presence, self._tracking
        for direction in range(DIRECTIONS):
            if (
                presence[direction] & _BITS
                and not tracking.others >> direction & 1
                and self._suspicion.trusts(direction)
            ):
                return True
        return False

    def weigh(self, direction, found, age_ms):
        """Judge a cell's sensors by what was found, or correct the belief by them.

        Returns whether that may have moved it.
        """
        if found & _CLEARLY and (direction != OWN or self.turn == OWN):
            self._judge(direction, found & (_MISSING | _FAR) != 0)
        wrong = found & _WRONG
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

        One may have changed since, and the frame got lost, while the parcel has moved on.
        """
        tracking = self._tracking
        late = min(tracking.belief.speed() * age_ms // 62_500, _MOST_LATE)
        point = AXES
        while wrong:
            if wrong & 1:
                x, y = self._footprint.point(direction, point)
                tracking.belief.correct(x, y, CONTRADICTION + late * late, False)
            wrong >>= 1
            point += 1


def checker(sensors, tracking, footprint, heard, suspicion):
    """What corrects the belief of a cell under a parcel, until the last SYNC.

    It looks up what changes, and nothing else. Contradictions count of the cell's own sensors and,
    in turns, of a neighbour's. The parcel is seen by the cell's own sensors or, where it covers
    none of them, by any around.
    """

    @micropython.native
    def check(  # noqa: PLR0917 - all is at hand
        sync_ms,
        sensors=sensors,
        tracking=tracking,
        footprint=footprint.registers,
        heard=heard,
        suspicion=suspicion,
        out=suspicion.out,
        registers=tracking.belief.registers,
        presence=heard.presence,
        compare=_compare,
    ):
        if heard.edges:
            sensors.take_edges(sync_ms)
        cases = out[_CASES] >> _PRESENCE & 1
        turn = sensors.turn
        turn = sensors.turn = turn + 1 if turn < _OWN else 0
        moved = missing = False
        bits = presence[_OWN]
        own = compare(registers, footprint, _OWN, bits)
        if bits & _SEEN:
            missing = own & _MISSING != 0
            if not turn & 3 and (own & _WRONG or cases):
                moved = sensors.weigh(_OWN, own, 0)
        if turn != _OWN and footprint[_PRESENT] >> turn & 1 and not tracking.others >> turn & 1:
            its = compare(registers, footprint, turn, presence[turn])
            if its & _WRONG or cases:
                age_ms = heard.age_ms(turn, sync_ms)
                if age_ms >= 0:
                    moved |= sensors.weigh(turn, its, age_ms)
        if moved:
            own = compare(registers, footprint, _OWN, bits)
        tracking.under = own & _NEARLY != 0
        if missing:
            missing = not (tracking.is_witnessed() and suspicion.has(_OWN, _PRESENCE))
        if missing or not (bits & _BITS or sensors.is_anything_there()):
            tracking.miss()
        else:
            tracking.missing_beats = 0

    return check


@micropython.viper
def _of_one_frame(edges: ptr8, edge_ms: ptr32, count: int, number: int) -> int:
    """The mask of the edges that came in the same frame as this one; the cell's own in none."""
    direction = edges[number] >> 4
    mask = 0
    if direction != int(OWN):
        for other in range(count):
            if edge_ms[other] == edge_ms[number] and edges[other] >> 4 == direction:
                mask |= 1 << other
    return mask & ~(1 << number)


@micropython.viper
def _compare(outline: ptr32, footprint: ptr32, direction: int, bits: int) -> int:
    """Compare a cell's presence bits with an outline; returns what is found, as above."""
    widen = int(WIDEN)
    shift_x = footprint[_SHIFT + 2 * direction] << widen >> widen
    shift_y = footprint[_SHIFT + 2 * direction + 1] << widen >> widen
    shift_x -= outline[_X] << widen >> widen
    shift_y -= outline[_Y] << widen >> widen
    disc = outline[_SHAPE] == _DISC
    cosine = outline[_COSINE] << widen >> widen
    sine = outline[_SINE] << widen >> widen
    length = outline[_HALF_LENGTH]
    width = outline[_HALF_WIDTH]
    deep = -_CLEAR
    inside = 0
    nearly = _CLEAR
    near = _CLEAR + 1
    if disc:
        # Squares of distances from its centre, in 64 um.
        deep = length - _CLEAR + 3 >> 2
        deep = deep * deep if deep > 0 else 0
        inside = (length + 3 >> 2) * (length + 3 >> 2)
        nearly = (length + _CLEAR + 3 >> 2) * (length + _CLEAR + 3 >> 2)
        near = (length + _CLEAR + 4 >> 2) * (length + _CLEAR + 4 >> 2)
    found = 0
    covered = 0
    sensor = 0 - _AXES
    for point in range(_POINTS):
        x = (footprint[point] << widen >> widen) + shift_x
        y = (footprint[_POINT_Y + point] << widen >> widen) + shift_y
        if disc:
            outside = (x >> 2) * (x >> 2) + (y >> 2) * (y >> 2)
        else:
            along = cosine * x + sine * y >> 13
            across = cosine * y - sine * x >> 13
            along = (along if along > 0 else 0 - along) - length
            across = (across if across > 0 else 0 - across) - width
            outside = along if along > across else across
        if outside < nearly:
            found |= _NEARLY
        if sensor >= 0:
            shown = bits >> sensor & 1
            if (1 if outside < inside else 0) != shown:
                found |= 1 << sensor
            if outside < deep:
                found |= _CLEARLY | _MISSING
                covered |= shown
            elif outside >= near:
                found |= _CLEARLY | (_FAR if shown else 0)
        sensor += 1
    return found & ~_MISSING if covered else found
