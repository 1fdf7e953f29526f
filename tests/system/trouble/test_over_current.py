"""A wheel that cannot move its parcel: its motor draws too much; the cell cuts it off and tells."""

from contextlib import closing
from typing import NamedTuple

import numpy as np
import pytest
from tests.micropython_builds import skipping_without_micropython

from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES
from mdms_sim.simulation import Simulation, open_bank

CELL = 8  # from 0; in the middle of the parcel
NODE = CELL + 1
TARGET_UM_S = 2_000_000
BRINGS_UP = (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION)
START_S = 0.3
ASK_S = 0.38
END_S = 0.6
RATED_MA = ENTRIES[0x6075, 0].default
LIMIT_MA = RATED_MA * ENTRIES[0x6073, 0].default // 1000
LIMIT_MS = ENTRIES[0x2006, 0].default
OVER_CURRENT = 0x2310
#: A wheel that stands under so much voltage would be a stall before it draws too much for long.
WITHOUT_STALL = Frame(cob.SDO_REQUEST_BASE + NODE, sdo.write_request(0x2004, 0, bytes(4)))
ASK = Frame(cob.SDO_REQUEST_BASE + NODE, b"\x40\x78\x60\x00\0\0\0\0")


class Host:
    """Brings one cell up, streams targets to its first axis, and asks once for its current."""

    def __init__(self):
        self.wake_s = START_S
        self.emergencies = []
        self.statuswords = []
        self.current_per_mille = None
        self._words = list(BRINGS_UP)
        self._asked = False

    def on_frame(self, frame, now_s):
        if frame.can_id == cob.EMCY_BASE + NODE:
            self.emergencies.append((int.from_bytes(frame.data[:2], "little"), frame.data[2]))
        elif frame.can_id == cob.TPDO_BASES[1] + NODE:
            self.statuswords.append(pdo.STATUS.decode(frame.data)[:2])
        elif frame.can_id == cob.SDO_RESPONSE_BASE + NODE and self._asked:
            assert frame.data[0] & sdo.SPECIFIER == sdo.UPLOAD_RESPONSE
            self.current_per_mille = int.from_bytes(frame.data[4:6], "little", signed=True)

    def poll(self, now_s):
        self.wake_s = now_s + 0.010
        if now_s < START_S + 0.001:
            yield Frame(cob.NMT, bytes((nmt.START, NODE)))
            yield WITHOUT_STALL
        if self._words:
            word = self._words.pop(0)
            yield Frame(cob.RPDO_BASES[1] + NODE, pdo.CONTROLWORD.encode((word, word)))
        yield Frame(cob.RPDO_BASES[0] + NODE, pdo.TARGET_VELOCITY.encode((TARGET_UM_S, 0)))
        yield Frame(cob.SYNC, b"")
        if now_s >= ASK_S and not self._asked:
            self._asked = True
            yield ASK


class Listened:
    """A bank of cells, with the currents told to the cell and its voltages at every tick."""

    def __init__(self, bank):
        self._bank = bank
        self.currents_ma = []
        self.voltages_uv = []

    def __getattr__(self, name):
        return getattr(self._bank, name)

    def tick(self, counts, currents_ma, presence):
        voltages_uv = self._bank.tick(counts, currents_ma, presence)
        self.currents_ma.append(currents_ma[CELL].tolist())
        self.voltages_uv.append(voltages_uv[CELL].tolist())
        return voltages_uv


class Run(NamedTuple):
    host: Host
    current_ma: np.ndarray
    voltage_uv: np.ndarray


def run(nodes, bridge_limit_a):
    """Two hundred kilograms that grip the wheels."""
    overrides = ("parcel.0.mass_kg=200", "cell.friction=2.0", "run.duration_s=0.6")
    scenario = load_scenario("array18", [*overrides, f"cell.current_limit_a={bridge_limit_a}"])
    host = Host()
    with skipping_without_micropython():
        bank = open_bank(nodes, 18)
    with closing(bank):
        listened = Listened(bank)
        Simulation(scenario, listened, [host]).run_until(END_S)
    return Run(host, np.array(listened.currents_ma), np.array(listened.voltages_uv))


@pytest.fixture(scope="module", params=["cpython", "micropython"])
def overloaded(request):
    """The bridge lets through more than the drive allows its motor."""
    return run(request.param, 6.0)


def test_voltage_is_zero_as_soon_as_the_current_was_too_large_for_too_long(overloaded):
    over = np.flatnonzero(overloaded.current_ma[:, 0] > LIMIT_MA)
    cut = over[0] + LIMIT_MS - 1
    assert (np.diff(over[:LIMIT_MS]) == 1).all()
    assert (overloaded.voltage_uv[over[0] : cut, 0] > 0).all()
    assert (overloaded.voltage_uv[cut:, 0] == 0).all()


def test_fault_is_told_once_and_the_axis_is_in_its_state(overloaded):
    codes = [code for code, _ in overloaded.host.emergencies]
    assert codes == [OVER_CURRENT]
    generic_and_current = 0x03
    assert overloaded.host.emergencies[0][1] == generic_and_current
    first, second = overloaded.host.statuswords[-1]
    assert first & 0x4F == cia402.FAULT
    assert second & 0x6F == cia402.OPERATION_ENABLED


def test_current_read_by_sdo_is_that_of_the_motor(overloaded):
    told_ma = overloaded.host.current_per_mille * RATED_MA / 1000
    tick = round(ASK_S * 1000)
    nearby = overloaded.current_ma[tick : tick + 3, 0]
    assert told_ma > LIMIT_MA
    assert np.abs(nearby - told_ma).min() <= RATED_MA / 1000


def test_bridge_that_limits_the_current_to_its_bound_keeps_the_drive_on():
    held = run("cpython", 3.0)
    assert held.current_ma[:, 0].max() == LIMIT_MA
    assert held.host.emergencies == []
    assert held.voltage_uv[-1, 0] > 0
