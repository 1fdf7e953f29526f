"""A wheel that is jogged, on the virtual array in virtual time, and the verbs on a served one."""

import numpy as np
import pytest
from tests.system.serving import serving

from mdms_host.cli import main
from mdms_host.cli.commission.jog import KEY_S, ByKeys
from mdms_host.cli.exits import Exit
from mdms_host.commissioning.wheels.jog import SPEED_MAX_M_S, Jog
from mdms_model.scenario.file import load_scenario
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import simulate

#: The wheel of the jog: nothing lies on cell 5.
CELL, AXIS = 5, 2


def speeds(jog, *overrides, duration_s=1.0):
    """Times and speeds of all wheels, shape (T, W)."""
    scenario = load_scenario("array18", [f"run.duration_s={duration_s}", *overrides])
    record = simulate(scenario, [jog]).record
    return record.time_s, record.speed_m_s


def wheel(values):
    return values[:, 2 * (CELL - 1) + AXIS - 1]


def test_one_wheel_turns_for_its_time_and_all_others_stand():
    jog = Jog(CELL, AXIS, 0.05, 0.4)
    time_s, speed_m_s = speeds(jog)
    assert jog.over
    assert jog.failure is None
    turning = wheel(speed_m_s) > 0.03
    assert 0.35 < turning.sum() * 0.01 < 0.5
    assert np.abs(wheel(speed_m_s)[time_s > 0.8]).max() < 1e-3
    others = np.delete(speed_m_s, 2 * (CELL - 1) + AXIS - 1, axis=1)
    assert np.abs(others).max() < 1e-3


def test_wheel_stops_by_itself_when_the_host_dies():
    time_s, speed_m_s = speeds(
        Jog(CELL, AXIS, 0.1, 10.0), "fault=[{kind='host', start_s=0.4}]", duration_s=1.0
    )
    assert wheel(speed_m_s)[time_s == 0.39] > 0.05
    assert np.abs(wheel(speed_m_s)[time_s > 0.55]).max() < 5e-3


def test_a_host_that_comes_back_leaves_the_wheel_off_and_reports_why():
    jog = Jog(CELL, AXIS, 0.1, 10.0)
    fault = "fault=[{kind='host', start_s=0.4, duration_s=0.3}]"
    time_s, speed_m_s = speeds(jog, fault, duration_s=1.2)
    assert np.abs(wheel(speed_m_s)[time_s > 0.55]).max() < 5e-3
    assert jog.over
    assert "went off: axis 1 switch on disabled, axis 2 fault" in jog.failure


def test_a_motor_that_runs_away_ends_the_jog_with_the_cells_reason():
    jog = Jog(CELL, AXIS, 0.05, 1.0)
    fault = f"fault=[{{kind='motor_reversed', cells=[{CELL}]}}]"
    time_s, speed_m_s = speeds(jog, fault, duration_s=1.5)
    assert "0x7302" in jog.failure
    assert np.abs(wheel(speed_m_s)[time_s > 1.2]).max() < 5e-3


def test_a_faster_jog_is_refused():
    with pytest.raises(ValueError, match=r"0\.3 m/s is more than 0\.2 m/s"):
        Jog(CELL, AXIS, -1.5 * SPEED_MAX_M_S, 1.0)


class Typed:
    """A clock and keys, set by the test."""

    def __init__(self):
        self.time_s, self.keys = 0.0, ""

    def now_s(self):
        return self.time_s

    def sleep(self, seconds):
        self.time_s += seconds

    def pressed(self):
        keys, self.keys = self.keys, ""
        return keys


class Steered:
    def __init__(self):
        self.speed_m_s, self.ended = None, False

    def steer(self, speed_m_s):
        self.speed_m_s = speed_m_s

    def end(self):
        self.ended = True


def test_wheel_turns_while_a_key_is_held_and_stops_when_it_is_let_go():
    typed, steered = Typed(), Steered()
    by_keys = ByKeys(steered, 0.05, typed, typed.pressed)
    by_keys.look()
    assert steered.speed_m_s == 0.0
    for _ in range(4):
        typed.keys = "+"
        by_keys.look()
        assert steered.speed_m_s == 0.05
        typed.sleep(KEY_S - 0.1)
        by_keys.look()
        assert steered.speed_m_s == 0.05
    typed.sleep(0.11)
    by_keys.look()
    assert steered.speed_m_s == 0.0
    for key, speed_m_s in (("-", -0.05), ("x", 0.0)):
        typed.keys = key
        by_keys.look()
        assert steered.speed_m_s == speed_m_s
    typed.keys = "q"
    by_keys.look()
    assert steered.ended


@pytest.fixture
def array(tmp_path):
    """18 served cells: their simulation, and the options that name their bus."""
    channel = str(tmp_path / "bus.sock")
    with serving(PythonBank(range(1, 19)), channel) as simulation:
        yield simulation, ("-i", "mdms", "-c", channel)


def test_verbs_blink_and_turn_what_they_name(array, capsys):
    simulation, bus = array
    assert main(["identify", "--node", "3", "7-8", "--seconds", "30", *bus]) == Exit.OK
    assert capsys.readouterr().out == "node 3, 7-8: both LEDs blink together for 30 s\n"
    assert simulation.blinking == [3, 7, 8]
    # A busy machine may miss the 50 ms that a cell waits by default.
    slack = ["configure", "set", "setpoint_timeout=0.5", "--node", str(CELL), *bus]
    assert main(slack) == Exit.OK
    capsys.readouterr()
    jog = ["jog", "--node", str(CELL), "--axis", "1", "-0.05", "--seconds", "0.2", *bus]
    assert main(jog) == Exit.OK
    line = capsys.readouterr().out
    assert line.startswith("node 5, axis 1: -")
    assert line.endswith("off again\n")
    assert main(["jog", "--node", "5", "--axis", "1", "--keys", *bus]) == Exit.USAGE
    assert main(["identify", "--node", "44", *bus]) == Exit.NO_DEVICE
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdms_host.commissioning.network.Commissioning.other_host", True)
        assert main(jog) == Exit.NODE_FAULT
    assert "another host" in capsys.readouterr().err
