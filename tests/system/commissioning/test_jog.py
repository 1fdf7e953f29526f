"""A wheel that is jogged, on the virtual array in virtual time, and the verbs on a served one."""

import json
import signal
import subprocess
import time
from contextlib import closing

import can
import numpy as np
import pytest
from tests.conftest import MDMS
from tests.system.links.serving import serving
from tests.virtual_array import SimulatedArray, virtual_time

from mdms_host.cli import main
from mdms_host.cli.cells.jog import KEY_S, ByKeys
from mdms_host.cli.exits import ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.jog import SPEED_MAX_M_S, Jog
from mdms_host.commissioning.network import Commissioning
from mdms_host.commissioning.wheel_turn import Direction, nudge
from mdms_model.scenario.file import load_scenario
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.sdo import NO_SUCH_OBJECT, AbortError
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation, simulate

#: The wheel of the jog: nothing lies on cell 5.
CELL, AXIS = 5, 2
PATIENCE_S = 60
#: Settings that no command that turns wheels may change.
LEFT_ALONE = (indices.SIGNATURE, indices.VOLTAGE_LIMIT, indices.GAIN)


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


def test_wheel_stops_by_itself_when_the_host_dies_and_one_that_comes_back_leaves_it_off():
    jog = Jog(CELL, AXIS, 0.1, 10.0)
    fault = "fault=[{kind='host', start_s=0.4, duration_s=0.3}]"
    time_s, speed_m_s = speeds(jog, fault, duration_s=1.2)
    assert wheel(speed_m_s)[time_s == 0.39] > 0.05
    assert np.abs(wheel(speed_m_s)[time_s > 0.55]).max() < 5e-3
    assert jog.over
    assert "went off: axis 1 switch on disabled, axis 2 fault" in jog.failure


def test_a_faster_jog_is_refused():
    with pytest.raises(ValueError, match=r"0\.3 m/s is more than 0\.2 m/s"):
        Jog(CELL, AXIS, -1.5 * SPEED_MAX_M_S, 1.0)


class Typed:
    """A clock and keys, set by the test."""

    is_real = False

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


class Stopper:
    """Another host: sends a command at a time, and keeps the frames after it."""

    def __init__(self, at_s, frame):
        self.wake_s = at_s
        self.later = []
        self._frame = frame

    def on_frame(self, frame, _now_s):
        if self.wake_s == np.inf:
            self.later.append(frame)

    def poll(self, _now_s):
        self.wake_s = np.inf
        return [self._frame]


STARTING_S, TURNING_S = 0.11, 0.5


@pytest.mark.parametrize(
    ("command", "node_id", "at_s"),
    [
        (nmt.STOP, nmt.ALL_NODES, STARTING_S),
        (nmt.ENTER_PRE_OPERATIONAL, CELL, STARTING_S),
        (nmt.RESET_NODE, nmt.ALL_NODES, TURNING_S),
        (nmt.RESET_COMMUNICATION, CELL, TURNING_S),
    ],
)
def test_a_stop_by_another_host_ends_the_jog_for_good(command, node_id, at_s):
    jog, stopper = Jog(CELL, AXIS, 0.1, 10.0), Stopper(at_s, nmt.command(command, node_id))
    scenario = load_scenario("array18", ["run.duration_s=1.2"])
    record = simulate(scenario, [jog, stopper]).record
    assert jog.over
    assert jog.stopped
    assert "another host has sent" in jog.failure
    assert not [frame for frame in stopper.later if frame == nmt.command(nmt.START, CELL)]
    later = record.time_s > at_s + 0.3
    assert np.abs(wheel(record.speed_m_s)[later]).max() < 5e-3


def without_supply(start_s, cells=None, duration_s=9.0):
    """An emergency stop, or cells whose fuses blow."""
    whose = "" if cells is None else f", cells={cells}"
    fault = f"kind='supply', start_s={start_s}, duration_s={duration_s}, supply_v=0.0{whose}"
    return f"fault=[{{{fault}}}]"


def stuck(bank, cell):
    """The cell measures 24 V, whatever its supply is."""
    measure = bank.set_supply

    def measured(index, supply_uv):
        if index != cell - 1:
            measure(index, supply_uv)

    bank.set_supply = measured


def test_an_emergency_stop_ends_the_jog_of_a_cell_that_does_not_measure_it():
    jog = Jog(CELL, AXIS, 0.1, 10.0)
    scenario = load_scenario("array18", ["run.duration_s=1.2", without_supply(0.5)])
    with closing(PythonBank(range(1, 19))) as bank:
        stuck(bank, CELL)
        simulation = Simulation(scenario, bank, [jog])
        simulation.run_until(1.2)
    assert jog.over
    assert jog.stopped
    assert "an emergency stop: 0x3220" in jog.failure


@pytest.mark.parametrize("pressed", [True, False])
def test_no_wheel_is_turned_while_an_emergency_stop_is_pressed(pressed, capsys):
    bank = PythonBank(range(1, 19))
    stuck(bank, CELL)
    # One cell alone has a fuse that has blown: that is no emergency stop.
    fault = without_supply(0.0) if pressed else without_supply(0.0, [CELL + 1])
    with virtual_time(SimulatedArray(bank, fault)) as time:
        time.sleep(0.5)
        assert main(JOG) == (ExitCode.NODE_FAULT if pressed else ExitCode.OK)
        told = capsys.readouterr().err
        assert ("an emergency stop: 0x3220" in told) == pressed
        assert ("at node 1-4, 6-18" in told) == pressed


@pytest.mark.parametrize("kind", ["supply", "off"])
def test_no_wheel_is_turned_once_an_emergency_stop_was_pressed_and_let_go_of(kind, capsys):
    """It cuts the motors' supply, or the cells' own too, while the jog still asks for settings."""
    fault = f"fault=[{{kind='{kind}', start_s=0.4, duration_s=0.2}}]"
    with virtual_time(SimulatedArray(PythonBank(range(1, 19)), fault)) as time:
        sent = []
        time.before_send = sent.append
        assert main(JOG) == ExitCode.NODE_FAULT
    assert "an emergency stop: 0x3220" in capsys.readouterr().err
    assert not [frame for frame in sent if frame.can_id == pdo.TARGET_VELOCITY.can_id(CELL)]


@pytest.mark.parametrize("more", [[], ["--reset"]])
def test_a_cell_whose_fuse_had_blown_before_says_so(more, capsys):
    with virtual_time(
        SimulatedArray(PythonBank(range(1, 19)), without_supply(0.0, [CELL]))
    ) as time:
        time.sleep(0.5)
        assert main([*JOG, *more]) == ExitCode.NODE_FAULT
    assert "; 0x3220: supply below the undervoltage limit\n" in capsys.readouterr().err


def test_a_cell_that_has_gone_is_waited_for_once():
    fault = f"fault=[{{kind='off', cells=[{CELL + 1}], start_s=0.5}}]"
    with (
        virtual_time(SimulatedArray(PythonBank(range(1, 19)), fault)) as time,
        Commissioning(None, MonotonicClock()) as commissioning,
    ):
        time.sleep(1.0)
        assert commissioning.foreign_stops.heard == [*range(1, 19)]
        for waits in (True, False):
            before_ns = time.array.now_ns
            assert nudge(commissioning, CELL, AXIS) is Direction.AGREES
            assert (time.array.now_ns - before_ns > 1_000_000_000) == waits
        assert CELL + 1 not in commissioning.foreign_stops.heard


def test_a_stop_for_another_cell_ends_nothing():
    jog, stopper = Jog(CELL, AXIS, 0.1, 0.5), Stopper(0.3, nmt.command(nmt.STOP, CELL + 1))
    simulate(load_scenario("array18", ["run.duration_s=1.2"]), [jog, stopper])
    assert jog.over
    assert jog.failure is None


def test_a_cell_that_restarts_ends_the_jog_for_good():
    jog, watch = Jog(CELL, AXIS, 0.1, 10.0), Stopper(0.5, nmt.command(nmt.START, CELL + 1))
    overrides = [
        "run.duration_s=1.5",
        f"fault=[{{kind='off', cells=[{CELL}], start_s=0.5, duration_s=0.05}}]",
    ]
    simulate(load_scenario("array18", overrides), [jog, watch])
    assert jog.over
    assert jog.stopped
    assert not [frame for frame in watch.later if frame == nmt.command(nmt.START, CELL)]


@pytest.fixture
def array():
    """18 cells in virtual time."""
    with virtual_time(SimulatedArray(PythonBank(range(1, 19)))) as time:
        yield time


JOG = ["jog", "--node", str(CELL), "--axis", "1", "-0.05", "--seconds", "0.2", "-i", "virtual"]


def test_verbs_blink_and_turn_the_cells_that_they_name(array, capsys):
    blink = ["identify", "--node", "3", "7-8", "--seconds", "30", "-i", "virtual"]
    assert main(blink) == ExitCode.OK
    assert capsys.readouterr().out == "node 3, 7-8: both LEDs blink together for 30 s\n"
    assert array.array.simulation.blinking == [3, 7, 8]
    by_the_book = ["--node", "5", "--axis", "1", "0.05", "--seconds", "1"]
    assert main(["jog", *by_the_book, "-i", "virtual"]) == ExitCode.OK
    assert capsys.readouterr().out.startswith("node 5, axis 1: 4")
    assert main(JOG) == ExitCode.OK
    assert capsys.readouterr().out.startswith("node 5, axis 1: -8.")
    assert main([*JOG, "--json"]) == ExitCode.OK
    assert json.loads(capsys.readouterr().out)["distance_m"] == pytest.approx(-0.009, abs=0.002)
    assert main(["jog", "--node", "5", "--axis", "1", "--keys", "-i", "virtual"]) == ExitCode.USAGE
    assert main(["identify", "--node", "44", "-i", "virtual"]) == ExitCode.NO_DEVICE
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mdms_host.commissioning.network.Commissioning.other_host", True)
        assert main(JOG) == ExitCode.NODE_FAULT
    assert "another host" in capsys.readouterr().err


def test_axis_in_fault_is_turned_only_once_the_fault_is_to_be_reset(array, capsys):
    array.array.bank._cells[CELL - 1]._axes.fail(0x2310)
    sent = []
    array.before_send = sent.append
    assert main(JOG) == ExitCode.NODE_FAULT
    assert capsys.readouterr().err == (
        "mdms: node 5, axis 1 is in fault, 0x2310: over-current, or the bridge has shut off; "
        "remove the cause, then: mdms jog --node 5 --axis 1 --reset\n"
    )
    assert not [frame for frame in sent if frame.can_id == cob.NMT]
    assert main([*JOG, "--reset"]) == ExitCode.OK


def test_motor_that_runs_away_does_so_slowly_and_ends_the_jog_with_its_reason(capsys):
    fault = f"fault=[{{kind='motor_reversed', cells=[{CELL}], axes=[1]}}]"
    with virtual_time(SimulatedArray(PythonBank(range(1, 19)), fault)) as time:
        speeds_m_s = time.array.simulation.world.scene.state.wheels["speed_m_s"]
        fastest_m_s = []
        time.before_send = lambda _frame: fastest_m_s.append(np.abs(speeds_m_s).max())
        assert main(JOG) == ExitCode.NODE_FAULT
        assert "0x7302" in capsys.readouterr().err
        # 2.4 V; at 24 V it is faster within the same 80 ms.
        assert 0.3 < max(fastest_m_s) < 0.8
        time.sleep(3.0)
        assert speeds_m_s.max() < 5e-3


def test_a_wheel_that_stands_is_said_to_and_is_no_success(capsys):
    fault = f"fault=[{{kind='wheel_jammed', cells=[{CELL}], axes=[1]}}]"
    with virtual_time(SimulatedArray(PythonBank(range(1, 19)), fault)):
        assert main(JOG) == ExitCode.NODE_FAULT
        told = capsys.readouterr()
        assert told.out.startswith("node 5, axis 1: 0.0 mm") or "-0.0 mm" in told.out
        assert "axis 1: the encoder does not move; is the wheel free" in told.err


@pytest.mark.parametrize(
    ("fault", "code", "told"),
    [
        ("encoder_stuck", ExitCode.NODE_FAULT, "the encoder does not move"),
        ("off", ExitCode.NO_DEVICE, "nobody knows whether it is off; cut the motors' power"),
    ],
)
def test_a_wheel_that_nobody_measures_turns_for_three_tenths_of_a_second(fault, code, told, capsys):
    axes = ", axes=[1]" if fault == "encoder_stuck" else ""
    faults = f"fault=[{{kind='{fault}', cells=[{CELL}]{axes}, start_s=1.0}}]"
    with virtual_time(SimulatedArray(PythonBank(range(1, 19)), faults)) as time:
        setpoints_ns = []

        def look(frame):
            if frame.can_id == pdo.TARGET_VELOCITY.can_id(CELL):
                setpoints_ns.append(time.array.now_ns)

        time.before_send = look
        fast = ["jog", "--node", str(CELL), "--axis", "1", "0.2", "--seconds", "3"]
        assert main([*fast, "-i", "virtual"]) == code
        assert told in capsys.readouterr().err
        assert setpoints_ns[0] < 1.0e9 < setpoints_ns[-1] < 1.4e9
        time.sleep(0.5)
        speeds_m_s = time.array.simulation.world.scene.state.wheels["speed_m_s"]
        assert np.abs(speeds_m_s).max() < 0.1


def test_cell_without_a_trial_limit_is_not_turned(array, capsys):
    objects = array.array.bank._cells[CELL - 1]._objects

    def refuse(_limit_mv):
        raise AbortError(NO_SUCH_OBJECT)

    objects.tie(indices.TRIAL_VOLTAGE_LIMIT, 0, write=refuse)
    sent = []
    array.before_send = sent.append
    assert main(JOG) == ExitCode.NODE_FAULT
    assert "its voltage cannot be limited" in capsys.readouterr().err
    assert not [frame for frame in sent if frame.can_id == pdo.TARGET_VELOCITY.can_id(CELL)]


def test_fault_on_the_way_ends_the_jog_with_its_reason(array, capsys):
    def fail(frame):
        if frame.can_id == pdo.TARGET_VELOCITY.can_id(CELL) and array.now_s() > 0.9:
            array.array.bank._cells[CELL - 1].fail(0x2310)

    array.before_send = fail
    assert main([*JOG, "--reset"]) == ExitCode.NODE_FAULT
    message = capsys.readouterr().err
    assert "went off: axis 1 fault" in message
    assert "0x2310" in message


@pytest.mark.real_time
def test_killed_amid_a_nudge_a_command_leaves_all_settings_as_they_were(tmp_path):
    """A process that is killed, on a served bus: nothing of it gets to mend anything."""
    channel = str(tmp_path / "bus.sock")
    array_file = tmp_path / "array.toml"
    cells = [f'[[cell]]\nserial = "{node:08X}"\nnode = {node}\n' for node in range(1, 19)]
    array_file.write_text("".join(cells))
    way = ("-i", "mdms", "-c", channel)
    with (
        serving(PythonBank(range(1, 19)), channel) as simulation,
        can.Bus(channel, interface="mdms") as watch,
        Commissioning(can.Bus(channel, interface="mdms"), MonotonicClock()) as commissioning,
    ):
        assert commissioning.find() == list(range(1, 19))
        before = [commissioning.read(1, index) for index in LEFT_ALONE]
        command = [str(MDMS), "commission", "--from", str(array_file), "--nudge", "--yes", *way]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        setpoint = pdo.TARGET_VELOCITY.can_id(1)
        while (message := watch.recv(60)) is not None and message.arbitration_id != setpoint:
            pass
        process.kill()
        assert process.wait() == -signal.SIGKILL
        assert message is not None
        speeds_m_s = simulation.world.scene.state.wheels["speed_m_s"]
        end_s = time.monotonic() + PATIENCE_S
        while (
            commissioning.read(1, indices.TRIAL_VOLTAGE_LIMIT)
            or np.abs(speeds_m_s[:2]).max() > 5e-3
        ):
            assert time.monotonic() < end_s
            time.sleep(0.02)
        assert [commissioning.read(1, index) for index in LEFT_ALONE] == before
