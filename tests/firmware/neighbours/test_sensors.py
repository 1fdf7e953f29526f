"""Edges that pass over sensors, beside parcels whose poses are known exactly."""

from math import cos, hypot, sin
from random import Random

import pytest
from tests.firmware.neighbours.some_place import SENSORS_UM, SHIFTS_UM, WHEELS_UM, SomePlace

from mdms_cell.perception.angle import ARM_UM
from mdms_cell.perception.footprint import Footprint
from mdms_cell.perception.heard import SEEN, Heard
from mdms_cell.perception.outline import RECTANGLE
from mdms_cell.perception.place import OWN
from mdms_cell.perception.suspicion import PRESENCE, Suspicion
from mdms_cell.perception.tracking import Tracking

LENGTH_UM, WIDTH_UM = 360_000, 300_000
SYNC_MS = 1_000


class Crossing:
    """The front edge of a moving and turning parcel, some milliseconds after it came to a sensor.

    `pose` is that of the parcel now [um, um, rad; from the cell's centre], `front_um` the point of
    its edge that has come to the sensor.
    """

    def __init__(self, random: Random) -> None:
        self.late_ms = random.randint(3, 15)
        self.direction, self.sensor = random.randrange(8), random.randrange(5)
        yaw, beside_um = random.uniform(-3.1, 3.1), random.uniform(-120_000, 120_000)
        speed_um_s, turn_rad_s = random.uniform(400_000, 600_000), random.uniform(-3.0, 3.0)
        heading = yaw + random.uniform(-0.5, 0.5)
        self.twist = (speed_um_s * cos(heading), speed_um_s * sin(heading), turn_rad_s)
        own_um, shift_um = SENSORS_UM[self.sensor], SHIFTS_UM[self.direction]
        place = [own + shift for own, shift in zip(own_um, shift_um, strict=True)]
        off_um = LENGTH_UM / 2
        at = (
            place[0] - off_um * cos(yaw) + beside_um * sin(yaw),
            place[1] - off_um * sin(yaw) - beside_um * cos(yaw),
            yaw,
        )
        late_s = self.late_ms * 1e-3
        self.pose = [begin + speed * late_s for begin, speed in zip(at, self.twist, strict=True)]
        now = self.pose[2]
        self.ahead = cos(now), sin(now)
        self.front_um = (
            self.pose[0] + off_um * cos(now) - beside_um * sin(now),
            self.pose[1] + off_um * sin(now) + beside_um * cos(now),
        )

    def believed(self, behind_um: float) -> list[float]:
        """The pose that a cell believes after the edge; before it the parcel was so far behind."""
        place = SomePlace(WHEELS_UM + SENSORS_UM, shifts_um=SHIFTS_UM)
        heard, suspicion = Heard(), Suspicion()
        tracking = Tracking(place, Footprint(place), heard, suspicion)
        belief = tracking.belief
        belief.set(RECTANGLE, LENGTH_UM, WIDTH_UM)
        x_um, y_um = (self.pose[axis] - behind_um * self.ahead[axis] for axis in range(2))
        belief.start(round(x_um), round(y_um), round(self.pose[2] * ARM_UM))
        for axis, scale in enumerate((1, 1, ARM_UM)):
            belief.twist.speeds[axis] = round(self.twist[axis] * scale)
        heard.edges = 1
        heard.edge_bytes[0] = self.direction << 4 | self.sensor << 1 | 1
        heard.edge_ms[0] = SYNC_MS + tracking.sensors.edge_late_ms - self.late_ms
        tracking.sensors.take_edges(SYNC_MS)
        return [belief.pose[0], belief.pose[1], belief.pose[2] / ARM_UM]


@pytest.mark.parametrize("seed", range(3))
def test_an_edge_moves_no_belief_that_is_right_however_the_parcel_has_moved_since(seed) -> None:
    random = Random(seed)
    for _ in range(200):
        crossing = Crossing(random)
        x_um, y_um, yaw = crossing.believed(0.0)
        assert hypot(x_um - crossing.pose[0], y_um - crossing.pose[1]) < 300
        assert abs(yaw - crossing.pose[2]) * ARM_UM < 300


@pytest.mark.parametrize("seed", range(3))
def test_an_edge_moves_a_belief_that_was_behind_to_where_the_edge_is_now(seed) -> None:
    random = Random(seed)
    for _ in range(200):
        crossing = Crossing(random)
        x_um, y_um, yaw = crossing.believed(8_000.0)
        front_x, front_y = crossing.front_um
        ahead_um = (front_x - x_um) * cos(yaw) + (front_y - y_um) * sin(yaw)
        assert abs(ahead_um - LENGTH_UM / 2) < 2_000


@pytest.mark.parametrize(
    ("bits", "x_um", "shows"),
    [(0, 0, False), (1, 0, False), (1, 215_000, True), (0, 215_000, False)],
)
def test_a_covered_sensor_shows_another_thing_30_mm_beside_the_parcel(bits, x_um, shows) -> None:
    """The parcel reaches 180 mm, so its edge is over the middle sensor, or 35 mm beside it."""
    place = SomePlace(WHEELS_UM + SENSORS_UM, shifts_um=SHIFTS_UM)
    heard = Heard()
    tracking = Tracking(place, Footprint(place), heard, Suspicion())
    tracking.belief.set(RECTANGLE, LENGTH_UM, WIDTH_UM)
    tracking.belief.start(x_um, 0, 0)
    heard.presence[OWN] = SEEN | bits
    assert tracking.sensors.show_another() == shows


def test_sensors_show_no_other_thing_where_no_parcel_is_believed_or_the_cell_doubts_them() -> None:
    place = SomePlace(WHEELS_UM + SENSORS_UM, shifts_um=SHIFTS_UM)
    heard, suspicion = Heard(), Suspicion()
    tracking = Tracking(place, Footprint(place), heard, suspicion)
    tracking.belief.set(RECTANGLE, LENGTH_UM, WIDTH_UM)
    heard.presence[OWN] = SEEN | 1
    assert not tracking.sensors.show_another()
    tracking.belief.start(215_000, 0, 0)
    suspicion.out[OWN] = 1 << PRESENCE
    assert not tracking.sensors.show_another()


@pytest.mark.parametrize(("bits", "missed"), [(0, 1), (2, 0)])
def test_a_parcel_that_lies_deep_over_no_sensor_is_missed_while_nothing_is_covered(
    bits, missed
) -> None:
    """Its edge is 5 mm beyond two sensors, so a free sensor alone does not contradict it."""
    place = SomePlace(WHEELS_UM + SENSORS_UM, shifts_um=SHIFTS_UM)
    heard = Heard()
    tracking = Tracking(place, Footprint(place), heard, Suspicion())
    tracking.belief.set(RECTANGLE, LENGTH_UM, WIDTH_UM)
    tracking.belief.start(LENGTH_UM // 2 + 35_000, 0, 0)
    heard.presence[OWN] = SEEN | bits
    tracking.sensors.check(SYNC_MS)
    assert tracking.missing_beats == missed
