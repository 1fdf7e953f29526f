"""Parcels on cells whose host falls silent: the distance until rest, by the cells' reaction."""

from contextlib import closing
from dataclasses import replace

import pytest

from mdms_model.motor import drive_of
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

CELLS = range(1, 19)
HOST = 127
GAIN_VS_PER_M = 13.0
#: Friction where the wheels along the way carry half of the weight: mu g / 2.
BRAKING_M_S2 = 0.3 * 9.81 / 2
UP_S = 0.2
SYNC_S = 0.01


class Driver:
    """Enables all cells and drives them along x, until it is silent, or its heartbeat is."""

    def __init__(self, reference_m_s, settings=()):
        self.wake_s = 0.1
        self.setpoints = self.heartbeat = True
        self._target_um_s = round(reference_m_s * 1e6)
        watched = sdo.write_request(0x1016, 1, (HOST << 16 | 75).to_bytes(4, "little"))
        words = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
        self._steps = [
            *(self._all(cob.SDO_REQUEST_BASE, each) for each in (*settings, watched)),
            [nmt.command(nmt.START)],
            *(self._all(cob.RPDO_BASES[1], pdo.CONTROLWORD.encode((word, word))) for word in words),
        ]

    def _all(self, base, data):
        return [Frame(base + node, data) for node in CELLS]

    def on_frame(self, frame, now_s):
        pass

    def poll(self, now_s):
        self.wake_s = now_s + SYNC_S
        if self._steps:
            return self._steps.pop(0)
        frames = [nmt.heartbeat(HOST, nmt.OPERATIONAL)] if self.heartbeat else []
        if self.setpoints:
            targets = pdo.TARGET_VELOCITY.encode((self._target_um_s, 0))
            frames += [*self._all(cob.RPDO_BASES[0], targets), Frame(cob.SYNC, b"")]
        return frames


class Stop:
    """A box of some mass at some speed, and its way from the moment at which the cells react."""

    def __init__(self, mass_kg, speed_m_s, *settings, lost="setpoints"):
        overrides = [f"parcel.0.mass_kg={mass_kg}", "parcel.0.x_m=-0.18"]
        scenario = load_scenario("array18", [*overrides, f"cell.gain_vs_per_m={GAIN_VS_PER_M}"])
        scenario = replace(scenario, fault=())
        driver = Driver(speed_m_s / drive_of(scenario.cell).droop, settings)
        self.codes = set()
        self._states = {}
        self._time_s = UP_S
        with closing(PythonBank(CELLS)) as bank:
            self._simulation = Simulation(scenario, bank, [driver], recording=None)
            self._simulation.bus.observe(self._on_frame)
            self._until(lambda x_m, v_m_s: v_m_s > 0.97 * speed_m_s)
            setattr(driver, lost, False)
            self._until(lambda x_m, v_m_s: self.codes)
            start_m, self.speed_m_s = self._motion()
            start_s = self._time_s
            self._until(lambda x_m, v_m_s: v_m_s < 0.001)
            self.way_m = self._motion()[0] - start_m
            self.duration_s = self._time_s - start_s
            self._simulation.run_until(self._time_s + 0.5)
            self.states = set(self._states.values())

    def _on_frame(self, frame, now_ns):
        if cob.EMCY_BASE < frame.can_id < cob.TIME:
            self.codes.add(frame.data[0] | frame.data[1] << 8)
        elif frame.can_id - cob.TPDO_BASES[1] in CELLS:
            self._states[frame.can_id] = cia402.state(pdo.STATUS.decode(frame.data)[0])

    def _motion(self):
        world = self._simulation.world
        return float(world.pose[0, 0]), float(world.twist[0, 0])

    def _until(self, reached):
        while not reached(*self._motion()):
            self._time_s += 0.001
            assert self._time_s < 6.0
            self._simulation.run_until(self._time_s)

    @property
    def friction_m(self):
        """The way that friction needs."""
        return self.speed_m_s**2 / (2 * BRAKING_M_S2)


def write(index, number, size):
    """A setting of both axes."""
    data = number.to_bytes(size, "little")
    return [sdo.write_request(each, 0, data) for each in (index, index + 0x800)]


@pytest.mark.parametrize(
    ("mass_kg", "speed_m_s"), [(2, 0.1), (2, 0.2), (2, 0.4), (10, 0.1), (10, 0.2), (10, 0.4)]
)
def test_parcel_stops_nearly_as_soon_as_friction_allows_when_setpoints_end(mass_kg, speed_m_s):
    stop = Stop(mass_kg, speed_m_s)
    assert stop.codes == {0x8250}
    assert stop.way_m < 1.3 * stop.friction_m
    assert stop.states == {cia402.FAULT}


@pytest.mark.parametrize("mass_kg", [2, 10])
def test_parcel_stops_as_soon_when_the_heartbeat_ends_and_setpoints_go_on(mass_kg):
    stop = Stop(mass_kg, 0.2, lost="heartbeat")
    assert 0x8130 in stop.codes
    assert stop.way_m < 1.3 * stop.friction_m


def test_light_parcel_slides_far_on_wheels_that_are_cut_at_once():
    stop = Stop(2, 0.2, *write(0x605E, 0, 2))
    assert stop.codes == {0x8250}
    assert stop.way_m > 1.9 * stop.friction_m
