"""What a cell makes of what it and its neighbours have seen: where the parcel is, how it moves.

A cell under the parcel keeps a belief of its own: it rolls it on by the wheels of its
neighbourhood, corrects it where sensors see an edge, and agrees with the neighbours under the same
parcel. A cell beside the parcel follows those that are under it.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr32

from array import array

from mdms_cell import ticks
from mdms_cell.neighbours.agreement import Agreement
from mdms_cell.neighbours.belief import CONTRADICTION, EDGE, Belief
from mdms_cell.neighbours.geometry.footprint import ALL_WHEELS, POINTS
from mdms_cell.neighbours.geometry.outline import (
    LEVER,
    NORMAL_X,
    NORMAL_Y,
    X,
    Y,
    points_by_depth,
    points_within,
)
from mdms_cell.neighbours.geometry.place import AXES, DIRECTIONS, SENSORS
from mdms_cell.neighbours.heard import NEVER, OWN
from mdms_cell.neighbours.right_of_way import PROMISED, UNDER
from mdms_cell.neighbours.suspicion import PRESENCE, WHEELS
from mdms_cell.neighbours.twist import WHEELS as TWIST_WHEELS
from mdms_cell.neighbours.twist import TwistFit
from mdms_protocol.neighbours import frames as wire

_FEW_WHEELS = const(5)
#: A frame may be this late; the parcel has moved on meanwhile.
_LATENCY_MS = const(3)
#: A pose is announced no longer after the SYNC of the belief that it was made of.
_AHEAD_MAX_MS = const(50)
#: A cell beside a parcel follows its neighbours for so long after the last of them.
_FOLLOW_BEATS = const(5)
#: An edge passes over a sensor no slower.
_PASSING_UM_S = const(1_000)
#: A sensor so far inside the outline has to be covered, one so far outside free, 10 mm [steps].
_CLEAR = const(625)
#: A parcel moves on by no more than this while a state is lost, 32 mm [1/16 mm].
_MOST_LATE = const(512)
#: Sensors that one frame shows to have changed are as far from the edge, 2 mm [steps].
_TOGETHER = const(125)
#: A sensor so far outside is not covered by this parcel, whatever its place is off, 30 mm [steps].
_ELSEWHERE = const(1875)
#: The mask of all directions.
_ALL = (1 << DIRECTIONS) - 1
#: The mask of a cell's sensors.
_SENSORS = (1 << SENSORS) - 1
#: So many neighbours that have the parcel show that a cell's own sensors are wrong.
_WITNESSES = const(2)
#: A cell whose sensors miss the parcel for so long steers no more, and then has it no longer.
DOUBT_BEATS = const(20)
LOST_BEATS = const(100)


class Tracking:
    """The belief of one parcel; `identity` is 0 without one, `missing_beats` since it was seen.

    An edge is reported `edge_late_ms` after it has passed the sensor.
    """

    def __init__(self, place, footprint, heard, suspicion):
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self._agreement = Agreement(place, heard, suspicion)
        # By direction who is at another parcel.
        self._others = bytearray(DIRECTIONS + 1)
        self.edge_late_ms = 1
        self.belief = Belief()
        self.outline = self.belief.outline
        self.twist = TwistFit()
        # The pose that was sent last [um]; `_sent` is None where none was.
        self._pose = array("i", (0, 0, 0))
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.identity = 0
        self.shaped = False
        self.under = False
        self.missing_beats = 0
        self._followed_beats = 0
        self._follows = False
        self._sent = None
        self._turn = 0
        self.certainty = 0
        self.belief.drop()
        self.twist.reset()
        self._agreement.reset()

    def adopt(self, identity):
        """Follow this parcel from now on."""
        self.drop()
        self.identity = identity

    def take_shape(self, program):
        """The parcel's outline is known now."""
        self.outline.set(program.shape, program.length_um, program.width_um)
        self.shaped = True
        self._look()

    def place(self, x_um, y_um, turn):
        """The parcel was put there [um; from the cell's own centre]."""
        self.belief.start(x_um, y_um, turn)
        self.twist.reset()
        self._look()

    def _look(self):
        self.under = self.shaped and self.belief.known and self._footprint.covers(self.outline)

    @micropython.native
    def update(self, step_ms, sync_ms):
        """Bring the belief to the last SYNC, `step_ms` after that of the last update."""
        heard = self._heard
        if self.identity and self.shaped:
            belief, agreement, twist = self.belief, self._agreement, self.twist.registers
            masks = _sort(
                heard.estimates,
                heard.estimate_beat,
                heard.speeds_beat,
                heard.beat,
                self.identity,
                self._others,
                self._suspicion.out,
            )
            self._fit(masks >> DIRECTIONS)
            # A few wheels, all on one side, do not show how a parcel turns.
            self._follows = follows = not self.under or twist[TWIST_WHEELS] < _FEW_WHEELS
            sent = self._sent
            outvoted = agreement.gather(masks & _ALL, None if follows else sent)
            if not (follows or outvoted) or not self._follow():
                belief.roll(twist, 2000 // step_ms)
                if sent is not None:
                    agreement.agree(belief, sent, self.certainty)
                belief.place()
            if self.under:
                if heard.edges:
                    self._correct(sync_ms)
                self._check_sensors(sync_ms)
            self._look()
        if heard.edges:
            self._drop_edges(sync_ms)

    @micropython.native
    def _fit(self, wheels):
        """Find the twist by those wheels that lie under the parcel, by the belief of before."""
        if not self.belief.known:
            self.twist.reset()
            return
        outline, footprint = self.outline.registers, self._footprint
        xs, ys = footprint.wheel_x, footprint.wheel_y
        wheels &= points_within(outline, xs, ys, ALL_WHEELS, 0, 0, 0)
        self.twist.fit(outline, footprint, self._heard.speeds, wheels)

    def _correct(self, sync_ms):
        """Take in the edges that sensors have seen until the last SYNC."""
        heard = self._heard
        late = self.twist.size() * _LATENCY_MS // 62_500
        for number in range(heard.edges):
            ago_ms = ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms
            if ago_ms <= 0:
                continue
            direction, _, covered = heard.edge(number)
            if self._others[direction] or self._suspicion.has(direction, PRESENCE):
                continue
            x, y = self._edge_at(number, ago_ms)
            if self._passes(x, y, covered) and not self._is_late(number, ago_ms):
                self.belief.correct(x, y, EDGE + late * late)

    def _edge_at(self, number, ago_ms):
        """Where that edge is now: it has moved on with the parcel since a sensor saw it."""
        heard, footprint, centre = self._heard, self._footprint, self.outline.registers
        direction, sensor, _ = heard.edge(number)
        point = AXES + sensor
        x = footprint.shift_x[direction] + footprint.x[point]
        y = footprint.shift_y[direction] + footprint.y[point]
        vx, vy, turn = self.twist.speeds()
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
        off = self.outline.edge(*self._edge_at(number, ago_ms))
        for other in range(heard.edges):
            if heard.edge_ms[other] == time_ms and heard.edge(other)[0] == direction:
                between = off - self.outline.edge(*self._edge_at(other, ago_ms))
                if not -_TOGETHER <= between <= _TOGETHER:
                    return True
        return False

    def _passes(self, x, y, covered):
        """Whether the parcel's edge passes over a point in the sense in which its sensor changed.

        An edge at rest, or against the motion, comes from the sensor, not from the parcel.
        """
        vx, vy, turn = self.twist.speeds()
        edge = self.outline.registers
        self.outline.edge(x, y)
        outwards = edge[NORMAL_X] * vx + edge[NORMAL_Y] * vy >> 10
        outwards += edge[LEVER] * turn >> 10
        return outwards > _PASSING_UM_S if covered else outwards < -_PASSING_UM_S

    def _drop_edges(self, sync_ms):
        """Keep the edges that came after the last SYNC for the next update."""
        heard = self._heard
        kept = 0
        for number in range(heard.edges):
            if ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms <= 0:
                heard.keep_edge(number, kept)
                kept += 1
        heard.edges = kept

    @micropython.native
    def _check_sensors(self, sync_ms):
        """Correct by sensors that contradict: the cell's own and, in turns, a neighbour's."""
        heard, footprint = self._heard, self._footprint
        turn = self._turn = (self._turn + 1) % (DIRECTIONS + 1)
        missing = heard.seen[OWN] and self._compare(OWN, not turn & 3, 0)
        if turn != OWN and footprint.present >> turn & 1 and not self._others[turn]:
            age_ms = heard.age_ms(turn, sync_ms)
            if age_ms >= 0:
                self._compare(turn, True, age_ms)
        if missing and self.is_witnessed() and self._suspicion.has(OWN, PRESENCE):
            missing = False
        if missing or not (heard.presence[OWN] or self._is_anything_there()):
            self.missing_beats = min(self.missing_beats + 1, LOST_BEATS)
        else:
            self.missing_beats = 0

    def _is_anything_there(self):
        """Whether a sensor of a neighbour is covered; by this parcel, as far as is known.

        A cell whose own sensors the parcel does not cover cannot see by them that it is gone.
        """
        presence, others = self._heard.presence, self._others
        for direction in range(DIRECTIONS):
            if presence[direction] and not others[direction] and self._suspicion.trusts(direction):
                return True
        return False

    def is_witnessed(self):
        """Whether neighbours have the parcel where this cell believes it."""
        return self._agreement.near >= _WITNESSES

    @micropython.native
    def _compare(self, direction, correcting, age_ms):
        """Compare a cell's sensors with the belief; returns whether all deep under it are free."""
        bits = self._heard.presence[direction]
        outline, footprint = self.outline.registers, self._footprint
        x, y = footprint.shift_x[direction], footprint.shift_y[direction]
        masks = points_by_depth(outline, footprint.x, footprint.y, POINTS, x, y, _CLEAR)
        deep = masks >> AXES & _SENSORS
        missing = deep != 0 and not deep & bits
        if correcting:
            far = _SENSORS & ~(masks >> 20 + AXES)
            if (deep or far) and (direction != OWN or self._turn == OWN):
                self._judge_sensors(direction, missing or bits & far != 0)
            wrong = (masks >> 10 + AXES ^ bits) & _SENSORS
            if wrong and self._suspicion.trusts(direction):
                self._pull(direction, wrong, age_ms)
        return missing

    @micropython.native
    def _judge_sensors(self, direction, contradict):
        """A cell's sensors do or do not contradict by far what others than that cell believe, too.

        Where several do at once, the belief is wrong, and no sensor.
        """
        judges = self.is_witnessed() if direction == OWN else self.is_sure()
        if judges and not (contradict and self._suspicion.crowd()):
            self._suspicion.judge(direction, PRESENCE, contradict)

    def _pull(self, direction, wrong, age_ms):
        """Correct the belief by these sensors, which are on the wrong side of its edge.

        One may have changed since, and the frame got lost, while the parcel has moved on.
        """
        footprint = self._footprint
        late = min(self.twist.size() * age_ms // 62_500, _MOST_LATE)
        point = AXES
        while wrong:
            if wrong & 1:
                x = footprint.shift_x[direction] + footprint.x[point]
                y = footprint.shift_y[direction] + footprint.y[point]
                self.belief.correct(x, y, CONTRADICTION + late * late, False)
            wrong >>= 1
            point += 1

    def is_other(self, direction):
        """Whether that cell's wheels and sensors serve another parcel."""
        return self._others[direction]

    def _follow(self):
        """Take what those under the parcel believe; returns whether there are any."""
        if self._agreement.follow(self.belief):
            self._followed_beats = 0
            return True
        if not self.under:
            self._followed_beats += 1
            if self._followed_beats > _FOLLOW_BEATS:
                self.belief.drop()
        return False

    def is_over(self):
        """Whether the parcel lies over the cell's square; not only over its wheels and sensors."""
        return self.under or (
            self.shaped and self.belief.known and self._footprint.reaches(self.outline)
        )

    def is_of_another(self):
        """Whether something else covers a sensor of the cell: one far from the parcel."""
        if not self._heard.presence[OWN] or not self._suspicion.trusts(OWN):
            return False
        near = self._footprint.within(self.outline, OWN, _ELSEWHERE) >> AXES
        return self._heard.presence[OWN] & ~near != 0

    @micropython.native
    def is_sure(self):
        """Whether this cell has a belief of its own that nothing is against."""
        return (
            self._sent is not None
            and self.under
            and not (self.missing_beats or self._agreement.outvoted_beats)
        )

    @micropython.native
    def is_doubtful(self):
        """Whether this cell is not to steer: its own sensors or its neighbours are against it."""
        return self.missing_beats >= DOUBT_BEATS or self._agreement.outvoted_beats >= DOUBT_BEATS

    @micropython.native
    def announce(self, fields, ahead_ms):
        """Write pose and certainty into an estimate, so long after the SYNC of the belief.

        That is no pose where it is too long.
        """
        self.certainty = 0
        self._sent = None
        sure = self.belief.known and self.under and not self._follows
        if sure and ahead_ms <= _AHEAD_MAX_MS:
            sent = self._sent = self._pose
            certainty = self.belief.send(self.twist.registers, 1000 // ahead_ms, fields, sent)
            if not self.is_doubtful():
                self.certainty = certainty
        fields[wire.CERTAINTY] = self.certainty


@micropython.viper
def _sort(  # noqa: PLR0917 - viper takes words
    estimates: ptr32,
    estimate_beat: ptr32,
    speeds_beat: ptr32,
    beat: int,
    parcel: int,
    others: ptr8,
    out: ptr8,
) -> int:
    """The mask of the directions whose estimate of this parcel came in this beat.

    From bit 8 on that of the wheels whose speeds came in this beat and count, two a direction.
    Marks in `others` who is at another parcel.
    """
    never = int(NEVER)
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    state_at = int(wire.STATE)
    certainty_at = int(wire.CERTAINTY)
    promised = int(PROMISED)
    under = int(UNDER)
    suspected = 1 << int(WHEELS)
    own = int(OWN)
    masks = 0
    at = 0
    for direction in range(own + 1):
        other = 0
        if direction != own:
            came = estimate_beat[direction]
            state = estimates[at + state_at]
            if estimates[at + identity_at] != parcel:
                if came != never and state >= promised:
                    other = 1
            elif came == beat and state == under and estimates[at + certainty_at] > 0:
                masks |= 1 << direction
            others[direction] = other
            at += fields
        if speeds_beat[direction] == beat and not other | out[direction] & suspected:
            masks |= 3 << own + 2 * direction
    return masks
