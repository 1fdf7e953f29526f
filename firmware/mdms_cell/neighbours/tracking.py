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

from mdms_cell import ticks
from mdms_cell.neighbours.agreement import Agreement
from mdms_cell.neighbours.belief import CONTRADICTION, EDGE, Belief
from mdms_cell.neighbours.geometry.angle import wrapped
from mdms_cell.neighbours.geometry.outline import LEVER, NORMAL_X, NORMAL_Y, STEP_UM, X, Y
from mdms_cell.neighbours.geometry.place import AXES, DIRECTIONS, SENSORS
from mdms_cell.neighbours.heard import NEVER, OWN
from mdms_cell.neighbours.program import wire_yaw
from mdms_cell.neighbours.right_of_way import PROMISED, UNDER
from mdms_cell.neighbours.suspicion import POSE_BEATS, PRESENCE, WHEELS
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
        # By direction who is at another parcel; masks of who is at this one, and of their wheels.
        self._others = bytearray(DIRECTIONS + 1)
        self._peers = 0
        self._turning = 0
        self.edge_late_ms = 1
        self.belief = Belief()
        self.outline = self.belief.outline
        self.twist = TwistFit()
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

    def update(self, step_ms, sync_ms):
        """Bring the belief to the last SYNC, `step_ms` after that of the last update."""
        if self.identity and self.shaped:
            before = self.twist.vx, self.twist.vy, self.twist.turn
            self._sort()
            self._fit()
            # A few wheels, all on one side, do not show how a parcel turns.
            self._follows = not self.under or self.twist.wheels < _FEW_WHEELS
            self._agreement.gather(self._peers)
            if not (self._follows or self._is_outvoted()) or not self._follow():
                self._move(before, step_ms)
                if self._sent is not None:
                    self._agreement.agree(self.belief, self._sent, self.certainty)
            if self.under:
                self._correct(sync_ms)
                self._check_sensors(sync_ms)
            self._look()
        self._drop_edges(sync_ms)

    def _sort(self):
        """Find out what each neighbour is at: the same parcel, another, or none."""
        heard, out = self._heard, self._suspicion.out
        self._peers = _peers(
            heard.estimates, heard.estimate_beat, heard.beat, self.identity, self._others
        )
        self._turning = _turning(heard.speeds_beat, heard.beat, self._others, out)

    def _fit(self):
        """Find the twist by the wheels under the parcel, as believed at the SYNC before."""
        if self.belief.known:
            outline, footprint = self.outline, self._footprint
            mask = self._turning & footprint.wheels_under(outline)
            x, y = outline.registers[X], outline.registers[Y]
            self.twist.fit(x, y, footprint.wheels, self._heard.speeds, mask)
        else:
            self.twist.reset()

    def wheels_against(self, wheels):
        """What those wheels of a mask show that lie under the parcel; see `TwistFit.against`."""
        centre, footprint = self.outline.registers, self._footprint
        speeds = self._heard.speeds
        return self.twist.against(centre[X], centre[Y], footprint.wheels, speeds, wheels)

    def _move(self, before, step_ms):
        """Roll on by the wheels, half by the twist before."""
        vx, vy, turn = before
        twist = self.twist
        half_ms = 2000 // step_ms
        self.belief.roll(
            _rounded(vx + twist.vx, half_ms),
            _rounded(vy + twist.vy, half_ms),
            _rounded(turn + twist.turn, half_ms),
        )

    def _correct(self, sync_ms):
        """Take in the edges that sensors have seen until the last SYNC."""
        heard, twist = self._heard, self.twist
        speed = abs(twist.vx) + abs(twist.vy) + abs(twist.turn)
        late = speed * _LATENCY_MS // 62_500
        for number in range(heard.edges):
            ago_ms = ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms
            if ago_ms <= 0:
                continue
            direction = heard.edge_direction[number]
            if self._others[direction] or self._suspicion.has(direction, PRESENCE):
                continue
            x, y = self._edge_at(number, ago_ms)
            if self._passes(x, y, heard.edge_covered[number]) and not self._is_late(number, ago_ms):
                self.belief.correct(x, y, EDGE + late * late)

    def _edge_at(self, number, ago_ms):
        """Where that edge is now: it has moved on with the parcel since a sensor saw it."""
        heard, footprint, twist = self._heard, self._footprint, self.twist
        direction = heard.edge_direction[number]
        point = AXES + heard.edge_sensor[number]
        x = footprint.shift_x[direction] + footprint.x[point]
        y = footprint.shift_y[direction] + footprint.y[point]
        turned = twist.turn * ago_ms // 128_000
        return (
            x + twist.vx * ago_ms // 16_000 - (y - self.belief.y // STEP_UM) * turned // 1000,
            y + twist.vy * ago_ms // 16_000 + (x - self.belief.x // STEP_UM) * turned // 1000,
        )

    def _is_late(self, number, ago_ms):
        """Whether that edge may be older: others of its frame are elsewhere, so one was lost."""
        heard = self._heard
        direction, time_ms = heard.edge_direction[number], heard.edge_ms[number]
        if direction == OWN:
            return False
        off = self.outline.edge(*self._edge_at(number, ago_ms))
        for other in range(heard.edges):
            if heard.edge_direction[other] == direction and heard.edge_ms[other] == time_ms:
                between = off - self.outline.edge(*self._edge_at(other, ago_ms))
                if not -_TOGETHER <= between <= _TOGETHER:
                    return True
        return False

    def _passes(self, x, y, covered):
        """Whether the parcel's edge passes over a point in the sense in which its sensor changed.

        An edge at rest, or against the motion, comes from the sensor, not from the parcel.
        """
        twist, edge = self.twist, self.outline.registers
        self.outline.edge(x, y)
        outwards = edge[NORMAL_X] * twist.vx + edge[NORMAL_Y] * twist.vy >> 10
        outwards += edge[LEVER] * twist.turn >> 10
        return outwards > _PASSING_UM_S if covered else outwards < -_PASSING_UM_S

    def _drop_edges(self, sync_ms):
        """Keep the edges that came after the last SYNC for the next update."""
        heard = self._heard
        if not heard.edges:
            return
        kept = 0
        for number in range(heard.edges):
            if ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms <= 0:
                heard.edge_direction[kept] = heard.edge_direction[number]
                heard.edge_sensor[kept] = heard.edge_sensor[number]
                heard.edge_covered[kept] = heard.edge_covered[number]
                heard.edge_ms[kept] = heard.edge_ms[number]
                kept += 1
        heard.edges = kept

    def _check_sensors(self, sync_ms):
        """Correct by sensors that contradict: the cell's own and, in turns, a neighbour's."""
        self._turn = (self._turn + 1) % (DIRECTIONS + 1)
        missing = self._compare(OWN, not self._turn & 3, sync_ms)
        if self._turn != OWN and self._footprint.present >> self._turn & 1:
            self._compare(self._turn, True, sync_ms)
        if self.is_witnessed() and self._suspicion.has(OWN, PRESENCE):
            missing = False
        missing = missing or not self._is_anything_there()
        self.missing_beats = min(self.missing_beats + 1, LOST_BEATS) if missing else 0

    def _is_anything_there(self):
        """Whether a sensor is covered, here or of a neighbour; of this parcel, as far as is known.

        A cell whose own sensors the parcel does not cover cannot see by them that it is gone.
        """
        presence, others = self._heard.presence, self._others
        if presence[OWN]:
            return True
        for direction in range(DIRECTIONS):
            if presence[direction] and not others[direction] and self._suspicion.trusts(direction):
                return True
        return False

    def is_witnessed(self):
        """Whether neighbours have the parcel where this cell believes it."""
        return self._agreement.near >= _WITNESSES

    def _compare(self, direction, correcting, sync_ms):
        """Compare a cell's sensors with the belief; returns whether all deep under it are free."""
        heard, footprint = self._heard, self._footprint
        if not heard.is_current(direction, sync_ms) or self._others[direction]:
            return False
        bits = heard.presence[direction]
        masks = footprint.by_depth(self.outline, direction, _CLEAR)
        deep = masks >> AXES & _SENSORS
        missing = deep and not deep & bits
        if correcting:
            far = _SENSORS & ~(masks >> 20 + AXES)
            if (deep or far) and (direction != OWN or self._turn == OWN):
                self._judge_sensors(direction, missing or bits & far)
            wrong = (masks >> 10 + AXES ^ bits) & _SENSORS
            if wrong and self._suspicion.trusts(direction):
                self._pull(direction, wrong, heard.age_ms(direction, sync_ms))
        return missing

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
        footprint, twist = self._footprint, self.twist
        speed = abs(twist.vx) + abs(twist.vy) + abs(twist.turn)
        late = min(speed * age_ms // 62_500, _MOST_LATE)
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

    def _is_outvoted(self):
        """Whether this cell is to take what the others believe for its own."""
        agreement = self._agreement
        if self._sent is None:
            return False
        agreement.judge(self._sent)
        return agreement.outvoted_beats >= POSE_BEATS

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

    def is_sure(self):
        """Whether this cell has a belief of its own that nothing is against."""
        return (
            self._sent is not None
            and self.under
            and not (self.missing_beats or self._agreement.outvoted_beats)
        )

    def is_doubtful(self):
        """Whether this cell is not to steer: its own sensors or its neighbours are against it."""
        return max(self.missing_beats, self._agreement.outvoted_beats) >= DOUBT_BEATS

    def announce(self, fields, ahead_ms):
        """Write pose and certainty into an estimate, so long after the SYNC of the belief.

        That is no pose where it is too long.
        """
        belief, twist = self.belief, self.twist
        self.certainty = 0
        self._sent = None
        sure = belief.known and self.under and not self._follows
        if sure and ahead_ms <= _AHEAD_MAX_MS:
            per_s = 1000 // ahead_ms
            x = belief.x + _rounded(twist.vx, per_s)
            y = belief.y + _rounded(twist.vy, per_s)
            turn = belief.turn + _rounded(twist.turn, per_s)
            fields[wire.X] = (x + wire.STEP_UM // 2) // wire.STEP_UM
            fields[wire.Y] = (y + wire.STEP_UM // 2) // wire.STEP_UM
            fields[wire.YAW] = wire_yaw(turn)
            self.certainty = 0 if self.is_doubtful() else belief.certainty()
            self._sent = x, y, wrapped(turn)
        fields[wire.CERTAINTY] = self.certainty


@micropython.viper
def _peers(estimates: ptr32, estimate_beat: ptr32, beat: int, parcel: int, others: ptr8) -> int:
    """The mask of those whose estimate of this parcel came in this beat.

    Marks in `others` who is at another parcel.
    """
    never = int(NEVER)
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    state_at = int(wire.STATE)
    certainty_at = int(wire.CERTAINTY)
    promised = int(PROMISED)
    under = int(UNDER)
    mask = 0
    at = 0
    for direction in range(int(DIRECTIONS)):
        came = estimate_beat[direction]
        state = estimates[at + state_at]
        others[direction] = 0
        if estimates[at + identity_at] != parcel:
            if came != never and state >= promised:
                others[direction] = 1
        elif came == beat and state == under and estimates[at + certainty_at] > 0:
            mask |= 1 << direction
        at += fields
    return mask


@micropython.viper
def _turning(speeds_beat: ptr32, beat: int, others: ptr8, out: ptr8) -> int:
    """The mask of the wheels whose speeds came in this beat and count, two a direction."""
    suspected = 1 << int(WHEELS)
    mask = 0
    for direction in range(int(DIRECTIONS) + 1):
        left_out = others[direction] | out[direction] & suspected
        if speeds_beat[direction] == beat and not left_out:
            mask |= 3 << 2 * direction
    return mask


def _rounded(number, divisor):
    return (number + divisor // 2) // divisor
