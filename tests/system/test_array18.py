"""The whole system: goal, frames, firmware, motors, friction, parcel, encoders and back."""

import math

import numpy as np
import pytest

import mdms_array as mdms
from mdms_array.host import coordinator_of
from mdms_model.run.record import Contact
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import Simulation, open_bank

#: Everything has come to rest by then.
SHORT_S = 5.0


def array18(*overrides):
    return load_scenario("array18", list(overrides))


@pytest.fixture(scope="module")
def demo():
    return mdms.simulate(array18(f"run.duration_s={SHORT_S}"))


def test_box_is_carried_and_turned_to_its_goal(demo):
    x_m, y_m, yaw_rad = demo.record.pose[-1, 0]
    assert math.hypot(x_m - 0.10, y_m) < 0.010
    assert abs(math.degrees(yaw_rad) - 30) < 3
    assert np.abs(demo.record.twist[-1, 0]).max() < 1e-3
    assert demo.status == "reached"


def test_coordinator_knows_where_the_box_is_from_the_bus_alone(demo):
    estimate, pose = demo.record.estimate[:, 0], demo.record.pose[:, 0]
    known = ~np.isnan(estimate[:, 0])
    assert known.mean() > 0.9
    away_m = np.hypot(*(estimate - pose)[known, :2].T)
    assert away_m.max() < 0.010
    assert np.degrees(np.abs((estimate - pose)[known, 2])).max() < 3


def test_wheels_stay_within_friction_and_supply(demo):
    record, cell = demo.record, array18().cell
    assert (np.abs(record.force_n) <= cell.friction * record.normal_n + 1e-9).all()
    assert np.abs(record.voltage_v).max() <= cell.supply_v
    carried = record.contact != Contact.NONE
    assert (record.normal_n[~carried] == 0).all()
    assert np.isclose(record.normal_n.sum(axis=1), 2.0 * 9.81)[1:].all()


def test_bus_carries_setpoints_and_states_at_100_hz_with_room_to_spare(demo):
    assert 0.3 < demo.bus.load < 0.55
    assert demo.bus.frames > 3_500 * (SHORT_S - 0.5)
    assert demo.bus.errors == 0


class Muted:
    """A bank in which one cell stops to send, as if its cable were cut, after so many ticks."""

    def __init__(self, bank, cell, ticks):
        self._bank, self._cell, self._ticks = bank, cell, ticks

    def __getattr__(self, name):
        return getattr(self._bank, name)

    def tick(self, *inputs):
        self._ticks -= 1
        return self._bank.tick(*inputs)

    def collect(self, cell):
        return self._heard(cell, self._bank.collect(cell))

    def collect_all(self):
        return [(cell, self._heard(cell, frames)) for cell, frames in self._bank.collect_all()]

    def _heard(self, cell, frames):
        return [] if cell == self._cell and self._ticks < 0 else frames


def test_cell_that_falls_silent_stops_the_array_and_is_named():
    scenario = array18("run.pauses=0")
    coordinator = coordinator_of(scenario)
    bank = Muted(open_bank("cpython", 18), cell=6, ticks=1500)
    simulation = Simulation(scenario, bank, [coordinator])
    simulation.run_until(1.4)
    assert np.abs(simulation.world.twist[0]).max() > 0.05
    simulation.run_until(2.8)
    assert coordinator.stopped
    assert "cell 7" in coordinator.fault
    assert "silent" in coordinator.fault
    assert np.abs(simulation.world.twist[0]).max() < 1e-3


@pytest.mark.parametrize(
    ("field", "overrides", "moves"),
    [
        ("uniform", (), lambda x, y, yaw: x > 0.02 and abs(y) < 0.01 and abs(yaw) < 0.1),
        ("rotate", (), lambda x, y, yaw: abs(yaw) > 0.05),
        (
            "twist",
            ("motion.velocity_m_s.0=0.02", "motion.yaw_rate_rad_s=0.1"),
            lambda x, y, yaw: x > 0.01 and yaw > 0.05,
        ),
        ("inward", ("parcel.0.x_m=-0.1",), lambda x, y, yaw: x > 0.03),
    ],
)
def test_field_moves_the_box_its_own_way(field, overrides, moves):
    """Displacement (x, y, yaw) within two seconds."""
    start = 0.0 if field != "inward" else -0.1
    scenario = array18(
        f"motion.field={field}",
        "motion.speed_m_s=0.05",
        f"parcel.0.x_m={start}",
        "run.duration_s=2.5",
        *overrides,
    )
    pose = mdms.simulate(scenario).record.pose[:, 0]
    assert moves(*(pose[-1] - pose[0]))


@pytest.mark.parametrize(
    ("shape", "size_m", "goal_yaw"),
    [
        ("shape=disc", (0.30, 0.30), ""),
        (
            "corners_m=[[0.18, -0.15], [0.18, 0.05], [0.05, 0.15], [-0.18, 0.12], [-0.15, -0.15]]",
            (0.36, 0.30),
            ", yaw_rad = 0.4",
        ),
    ],
)
def test_discs_and_polygons_arrive(shape, size_m, goal_yaw):
    kind = "disc" if shape == "shape=disc" else "polygon"
    run = mdms.simulate(
        array18(
            f"run.duration_s={SHORT_S}",
            f"parcel.0.shape={kind}",
            f"parcel.0.{shape}",
            f"parcel.0.length_m={size_m[0]}",
            f"parcel.0.width_m={size_m[1]}",
            f"parcel.0.goal={{ x_m = 0.10, y_m = 0.01{goal_yaw} }}",
        )
    )
    x_m, y_m, yaw_rad = run.record.pose[-1, 0]
    assert run.status == "reached"
    assert math.hypot(x_m - 0.10, y_m - 0.01) < 0.005
    if goal_yaw:
        assert abs(yaw_rad - 0.4) < 0.02
