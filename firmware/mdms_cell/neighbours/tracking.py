"""What a cell makes of what it and its neighbours have seen: where the parcel is, how it moves.

A cell under the parcel keeps a belief of its own: it rolls it on by the wheels of its
neighbourhood, corrects it where sensors see an edge, and agrees with the neighbours under the same
parcel. A cell beside the parcel follows those that are under it.
"""

try:
    import micropython
except ImportError:
    from mdms_cell.cpython import micropython

from array import array

from mdms_cell import ticks
from mdms_cell.neighbours.agreement import Agreement
from mdms_cell.neighbours.angle import wrapped
from mdms_cell.neighbours.belief import CONTRADICTION, EDGE, Belief
from mdms_cell.neighbours.heard import OWN
from mdms_cell.neighbours.outline import STEP_UM
from mdms_cell.neighbours.place import AXES, DIRECTIONS, SENSORS
from mdms_cell.neighbours.program import wire_yaw
from mdms_cell.neighbours.right_of_way import PROMISED, UNDER
from mdms_cell.neighbours.suspicion import POSE_BEATS, PRESENCE, WHEELS
from mdms_cell.neighbours.twist import TwistFit
from mdms_protocol.neighbours import frames as wire

_FEW_WHEELS = 5
#: A frame may be this late; the parcel has moved on meanwhile.
_LATENCY_MS = 3
#: A cell beside a parcel follows its neighbours for so long after the last of them.
_FOLLOW_BEATS = 5
#: An edge passes over a sensor no slower.
_PASSING_UM_S = 1_000
#: A sensor so far inside the outline has to be covered, one so far outside free [steps].
_CLEAR = 10_000 // STEP_UM
#: So many neighbours that have the parcel show that a cell's own sensors are wrong.
_WITNESSES = 2
#: A cell whose sensors miss the parcel for so long steers no more, and then has it no longer.
DOUBT_BEATS = 20
LOST_BEATS = 100


class Tracking:
    """The belief of one parcel; `identity` is 0 without one, `missing_beats` since it was seen.

    An edge is reported `edge_late_ms` after it has passed the sensor.
    """

    def __init__(self, place, footprint, heard, suspicion):
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self._agreement = Agreement(place, heard, suspicion)
        # By direction: whose speeds count, who is at another parcel; mask of who is at this one.
        self._use = bytearray(DIRECTIONS + 1)
        self._others = bytearray(DIRECTIONS + 1)
        self._peers = 0
        self.edge_late_ms = 1
        self._distances = array("i", [0] * SENSORS)
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
        self.under = (
            self.shaped and self.belief.known and self._footprint.covered(self.outline, OWN)
        )

    def update(self, beat, step_ms, sync_ms):
        """Bring the belief to the last SYNC, `step_ms` after that of the last update."""
        if self.identity and self.shaped:
            before = self.twist.vx, self.twist.vy, self.twist.turn
            self._sort(beat)
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
                self._check_sensors()
            self._look()
        self._drop_edges(sync_ms)

    @micropython.native
    def _sort(self, beat):
        """Find out what each neighbour is at: the same parcel, another, or none."""
        heard, use, peers = self._heard, self._use, 0
        for direction in range(DIRECTIONS):
            at = direction * wire.ESTIMATE_FIELDS
            identity = heard.estimates[at + wire.IDENTITY]
            same = identity == self.identity
            state = heard.estimates[at + wire.STATE]
            others = heard.estimate_beat[direction] >= 0 and state >= PROMISED and not same
            self._others[direction] = others
            turning = heard.speeds_beat[direction] == beat
            use[direction] = turning and not (others or self._suspicion.has(direction, WHEELS))
            sure = heard.estimates[at + wire.CERTAINTY] > 0
            if same and sure and state == UNDER and heard.estimate_beat[direction] == beat:
                peers |= 1 << direction
        use[OWN] = heard.speeds_beat[OWN] == beat and not self._suspicion.has(OWN, WHEELS)
        self._peers = peers

    def _fit(self):
        """Find the twist by the wheels under the parcel, as believed at the SYNC before."""
        if self.belief.known:
            heard, wheels = self._heard, self._footprint.wheels
            self.twist.fit(self.outline, wheels, heard.speeds, AXES, self._use)
        else:
            self.twist.reset()

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
        heard, footprint, twist = self._heard, self._footprint, self.twist
        speed = abs(twist.vx) + abs(twist.vy) + abs(twist.turn)
        late = speed * _LATENCY_MS // 62_500
        for number in range(heard.edges):
            ago_ms = ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms
            if ago_ms <= 0:
                continue
            direction = heard.edge_direction[number]
            if self._others[direction] or self._suspicion.has(direction, PRESENCE):
                continue
            point = AXES + heard.edge_sensor[number]
            # The parcel has moved on since: so has, with it, the place where its edge was seen.
            x = footprint.shift_x[direction] + footprint.x[point]
            y = footprint.shift_y[direction] + footprint.y[point]
            turned = twist.turn * ago_ms // 128_000
            x, y = (
                x + twist.vx * ago_ms // 16_000 - (y - self.belief.y // STEP_UM) * turned // 1000,
                y + twist.vy * ago_ms // 16_000 + (x - self.belief.x // STEP_UM) * turned // 1000,
            )
            if self._passes(x, y, heard.edge_covered[number]):
                self.belief.correct(x, y, EDGE + late * late)

    def _passes(self, x, y, covered):
        """Whether the parcel's edge passes over a point in the sense in which its sensor changed.

        An edge at rest, or against the motion, comes from the sensor, not from the parcel.
        """
        outline, twist = self.outline, self.twist
        outline.edge(x, y)
        outwards = outline.normal_x * twist.vx + outline.normal_y * twist.vy >> 10
        outwards += outline.lever * twist.turn >> 10
        return outwards > _PASSING_UM_S if covered else outwards < -_PASSING_UM_S

    def _drop_edges(self, sync_ms):
        """Keep the edges that came after the last SYNC for the next update."""
        heard = self._heard
        kept = 0
        for number in range(heard.edges):
            if ticks.diff(sync_ms, heard.edge_ms[number]) + self.edge_late_ms <= 0:
                heard.edge_direction[kept] = heard.edge_direction[number]
                heard.edge_sensor[kept] = heard.edge_sensor[number]
                heard.edge_covered[kept] = heard.edge_covered[number]
                heard.edge_ms[kept] = heard.edge_ms[number]
                kept += 1
        heard.edges = kept

    def _check_sensors(self):
        """Correct by sensors that contradict: the cell's own and, in turns, a neighbour's."""
        self._turn = (self._turn + 1) % (DIRECTIONS + 1)
        missing = self._compare(OWN, not self._turn & 3)
        if self._turn != OWN and self._footprint.present >> self._turn & 1:
            self._compare(self._turn, True)
        if self.witnessed and self._suspicion.has(OWN, PRESENCE):
            missing = False
        self.missing_beats = min(self.missing_beats + 1, LOST_BEATS) if missing else 0

    @property
    def witnessed(self):
        """Whether neighbours have the parcel where this cell believes it."""
        return self._agreement.near >= _WITNESSES

    @micropython.native
    def _compare(self, direction, correcting):
        """Compare a cell's sensors with the belief; returns whether all deep under it are free."""
        heard, footprint = self._heard, self._footprint
        if not heard.seen[direction] or self._others[direction]:
            return False
        bits = heard.presence[direction]
        distances = self._distances
        shift_x, shift_y = footprint.shift_x[direction], footprint.shift_y[direction]
        deep = free = far = covered = 0
        for sensor in range(SENSORS):
            x = shift_x + footprint.x[AXES + sensor]
            y = shift_y + footprint.y[AXES + sensor]
            distance = distances[sensor] = self.outline.distance(x, y)
            if distance < -_CLEAR:
                deep += 1
                free += 1 - (bits >> sensor & 1)
            elif distance > _CLEAR:
                far += 1
                covered += bits >> sensor & 1
        missing = deep > 0 and free == deep
        if correcting:
            if (deep or far) and (direction != OWN or self._turn == OWN):
                self._judge_sensors(direction, missing or covered > 0)
            if self._suspicion.trusts(direction):
                self._pull(direction, bits)
        return missing

    def _judge_sensors(self, direction, contradict):
        """A cell's sensors do or do not contradict by far what others than that cell believe, too.

        Where several do at once, the belief is wrong, and no sensor.
        """
        judges = self.witnessed if direction == OWN else self.sure
        if judges and not (contradict and self._suspicion.crowd()):
            self._suspicion.judge(direction, PRESENCE, contradict)

    def _pull(self, direction, bits):
        """Correct the belief by sensors that are on the wrong side of its edge."""
        footprint = self._footprint
        for sensor in range(SENSORS):
            if (self._distances[sensor] < 0) != bool(bits >> sensor & 1):
                x = footprint.shift_x[direction] + footprint.x[AXES + sensor]
                y = footprint.shift_y[direction] + footprint.y[AXES + sensor]
                self.belief.correct(x, y, CONTRADICTION, False)

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

    @property
    def over(self):
        """Whether the parcel lies over the cell's square; not only over its wheels and sensors."""
        return self.under or (
            self.shaped and self.belief.known and self._footprint.reached(self.outline)
        )

    @property
    def sure(self):
        """Whether this cell has a belief of its own that nothing is against."""
        return (
            self._sent is not None
            and self.under
            and not (self.missing_beats or self._agreement.outvoted_beats)
        )

    @property
    def doubtful(self):
        """Whether this cell is not to steer: its own sensors or its neighbours are against it."""
        return max(self.missing_beats, self._agreement.outvoted_beats) >= DOUBT_BEATS

    def announce(self, fields, step_ms):
        """Write pose and certainty into an estimate, as they will be at the next SYNC."""
        belief, twist = self.belief, self.twist
        self.certainty = 0
        self._sent = None
        if belief.known and self.under and not self._follows:
            x = (belief.x + _rounded(twist.vx, 1000 // step_ms) + wire.STEP_UM // 2) // wire.STEP_UM
            y = (belief.y + _rounded(twist.vy, 1000 // step_ms) + wire.STEP_UM // 2) // wire.STEP_UM
            yaw = wire_yaw(belief.turn + _rounded(twist.turn, 1000 // step_ms))
            fields[wire.X], fields[wire.Y], fields[wire.YAW] = x, y, yaw
            self.certainty = 0 if self.doubtful else _certainty(belief.variance)
            exact = (
                belief.x + _rounded(twist.vx, 1000 // step_ms),
                belief.y + _rounded(twist.vy, 1000 // step_ms),
                wrapped(belief.turn + _rounded(twist.turn, 1000 // step_ms)),
            )
            self._sent = exact
        fields[wire.CERTAINTY] = self.certainty


def _rounded(number, divisor):
    return (number + divisor // 2) // divisor


def _certainty(variance):
    """As it is sent: each step halves the variance."""
    certainty = 17
    while variance and certainty > 1:
        variance >>= 1
        certainty -= 1
    return min(certainty, 15)
