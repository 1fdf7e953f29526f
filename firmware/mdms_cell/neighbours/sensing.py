"""What presence sensors correct of a belief: edges as they pass, and what contradicts it."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython

from mdms_cell import ticks
from mdms_cell.neighbours.belief import CONTRADICTION, EDGE
from mdms_cell.neighbours.geometry.footprint import POINTS
from mdms_cell.neighbours.geometry.outline import (
    LEVER,
    NORMAL_X,
    NORMAL_Y,
    X,
    Y,
    points_by_depth,
)
from mdms_cell.neighbours.geometry.place import AXES, DIRECTIONS, SENSORS
from mdms_cell.neighbours.heard import OWN
from mdms_cell.neighbours.suspicion import PRESENCE

#: A frame may be this late; the parcel has moved on meanwhile.
_LATENCY_MS = const(3)
#: An edge passes over a sensor no slower.
_PASSING_UM_S = const(1_000)
#: A sensor so far inside the outline has to be covered, one so far outside free, 10 mm [steps].
_CLEAR = const(625)
#: A parcel moves on by no more than this while a state is lost, 32 mm [1/16 mm].
_MOST_LATE = const(512)
#: Sensors that one frame shows to have changed are as far from the edge, 2 mm [steps].
_TOGETHER = const(125)
#: The mask of a cell's sensors.
_SENSORS = (1 << SENSORS) - 1
#: So many neighbours that have the parcel show that a cell's own sensors are wrong.
_WITNESSES = const(2)


class Sensing:
    """Corrects the belief of one parcel; `others` marks by direction who is at another.

    An edge is reported `edge_late_ms` after it has passed the sensor.
    """

    def __init__(self, footprint, heard, suspicion, *, agreement, belief, twist, others):
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self._agreement = agreement
        self._belief = belief
        self._outline = belief.outline
        self._twist = twist
        self._others = others
        self.edge_late_ms = 1
        self._turn = 0

    def reset(self):
        """There is no parcel."""
        self._turn = 0

    def correct(self, sync_ms):
        """Take in the edges that sensors have seen until the last SYNC."""
        heard = self._heard
        late = self._twist.size() * _LATENCY_MS // 62_500
        for number in range(heard.edges):
            ago_ms = ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms
            if ago_ms <= 0:
                continue
            direction, _, covered = heard.edge(number)
            if self._others[direction] or self._suspicion.has(direction, PRESENCE):
                continue
            x, y = self._edge_at(number, ago_ms)
            if self._passes(x, y, covered) and not self._is_late(number, ago_ms):
                self._belief.correct(x, y, EDGE + late * late)

    def _edge_at(self, number, ago_ms):
        """Where that edge is now: it has moved on with the parcel since a sensor saw it."""
        heard, footprint, centre = self._heard, self._footprint, self._outline.registers
        direction, sensor, _ = heard.edge(number)
        point = AXES + sensor
        x = footprint.shift_x[direction] + footprint.x[point]
        y = footprint.shift_y[direction] + footprint.y[point]
        vx, vy, turn = self._twist.speeds()
        turned = turn * ago_ms // 128_000
        return (
            x + vx * ago_ms // 16_000 - (y - centre[Y]) * turned // 1000,
            y + vy * ago_ms // 16_000 + (x - centre[X]) * turned // 1000,
        )

    def _is_late(self, number, ago_ms):
        """Whether that edge may be older: others of its frame are elsewhere, so one was lost."""
        heard = self._heard
        direction, time_ms = heard.edge(number)[0], heard.edge_ms[number]
        if direction == OWN:
            return False
        off = self._outline.edge(*self._edge_at(number, ago_ms))
        for other in range(heard.edges):
            if heard.edge_ms[other] == time_ms and heard.edge(other)[0] == direction:
                between = off - self._outline.edge(*self._edge_at(other, ago_ms))
                if not -_TOGETHER <= between <= _TOGETHER:
                    return True
        return False

    def _passes(self, x, y, covered):
        """Whether the parcel's edge passes over a point in the sense in which its sensor changed.

        An edge at rest, or against the motion, comes from the sensor, not from the parcel.
        """
        vx, vy, turn = self._twist.speeds()
        edge = self._outline.registers
        self._outline.edge(x, y)
        outwards = edge[NORMAL_X] * vx + edge[NORMAL_Y] * vy >> 10
        outwards += edge[LEVER] * turn >> 10
        return outwards > _PASSING_UM_S if covered else outwards < -_PASSING_UM_S

    def drop_edges(self, sync_ms):
        """Keep the edges that came after the last SYNC for the next update."""
        heard = self._heard
        kept = 0
        for number in range(heard.edges):
            if ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms <= 0:
                heard.keep_edge(number, kept)
                kept += 1
        heard.edges = kept

    @micropython.native
    def contradict(self, sync_ms, sure):
        """Correct by sensors that contradict: the cell's own and, in turns, a neighbour's.

        `sure` is whether nothing is against the belief; returns whether no sensor shows the parcel.
        """
        heard, footprint = self._heard, self._footprint
        turn = self._turn = (self._turn + 1) % (DIRECTIONS + 1)
        missing = heard.seen[OWN] and self._compare(OWN, not turn & 3, 0, sure)
        if turn != OWN and footprint.present >> turn & 1 and not self._others[turn]:
            age_ms = heard.age_ms(turn, sync_ms)
            if age_ms >= 0:
                self._compare(turn, True, age_ms, sure)
        if missing and self._is_witnessed() and self._suspicion.has(OWN, PRESENCE):
            missing = False
        return missing or not (heard.presence[OWN] or self._is_anything_there())

    def _is_anything_there(self):
        """Whether a sensor of a neighbour is covered; by this parcel, as far as is known.

        A cell whose own sensors the parcel does not cover cannot see by them that it is gone.
        """
        presence, others = self._heard.presence, self._others
        for direction in range(DIRECTIONS):
            if presence[direction] and not others[direction] and self._suspicion.trusts(direction):
                return True
        return False

    def _is_witnessed(self):
        """Whether neighbours have the parcel where this cell believes it."""
        return self._agreement.near >= _WITNESSES

    @micropython.native
    def _compare(self, direction, correcting, age_ms, sure):
        """Compare a cell's sensors with the belief; returns whether all deep under it are free."""
        bits = self._heard.presence[direction]
        outline, footprint = self._outline.registers, self._footprint
        x, y = footprint.shift_x[direction], footprint.shift_y[direction]
        masks = points_by_depth(outline, footprint.x, footprint.y, POINTS, x, y, _CLEAR)
        deep = masks >> AXES & _SENSORS
        missing = deep != 0 and not deep & bits
        if correcting:
            far = _SENSORS & ~(masks >> 20 + AXES)
            if (deep or far) and (direction != OWN or self._turn == OWN):
                self._judge_sensors(direction, missing or bits & far != 0, sure)
            wrong = (masks >> 10 + AXES ^ bits) & _SENSORS
            if wrong and self._suspicion.trusts(direction):
                self._pull(direction, wrong, age_ms)
        return missing

    @micropython.native
    def _judge_sensors(self, direction, contradict, sure):
        """A cell's sensors do or do not contradict by far what others than that cell believe, too.

        Where several do at once, the belief is wrong, and no sensor.
        """
        judges = self._is_witnessed() if direction == OWN else sure
        if judges and not (contradict and self._suspicion.crowd()):
            self._suspicion.judge(direction, PRESENCE, contradict)

    def _pull(self, direction, wrong, age_ms):
        """Correct the belief by these sensors, which are on the wrong side of its edge.

        One may have changed since, and the frame got lost, while the parcel has moved on.
        """
        footprint = self._footprint
        late = min(self._twist.size() * age_ms // 62_500, _MOST_LATE)
        point = AXES
        while wrong:
            if wrong & 1:
                x = footprint.shift_x[direction] + footprint.x[point]
                y = footprint.shift_y[direction] + footprint.y[point]
                self._belief.correct(x, y, CONTRADICTION + late * late, False)
            wrong >>= 1
            point += 1
