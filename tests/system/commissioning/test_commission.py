"""`mdms commission --nudge` on a small array with real wheels and a real bus, in virtual time."""

import io

import numpy as np
import pytest
from tests.virtual_array import OtherHost, SimulatedArray, virtual_time

from mdms_host.cli import main
from mdms_host.cli.exits import INTERRUPTED, ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.array_file import read_array
from mdms_host.commissioning.network import Commissioning
from mdms_protocol import indices, pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_sim.nodes.python_bank import PythonBank

#: Two cells by two, with nothing on them: the box is lifted off before anybody comes.
TABLE = (
    *("array.columns=2", "array.rows=2", "parcel.0.x_m=0.0", "parcel.0.y_m=0.0"),
    *("parcel.0.length_m=0.2", "parcel.0.width_m=0.2", "motion.field='inward'"),
)
LIFTED = "{kind='lift', parcel='box'}"
GRID = ("--columns", "2", "--rows", "2")
#: Longer than a cell brakes, whatever its wheel does.
BRAKED_S = 4.0


class Array:
    """Four cells with these node ids and faults, and verbs on them."""

    def __init__(self, time, folder):
        self.time = time
        self.simulation = time.array.simulation
        self._folder = folder
        (folder / "list.txt").write_text("1 2 3 4")

    def commission(self, *arguments):
        listed = ("--list", self._folder / "list.txt", *GRID, "--yes")
        out = ("--out", self._folder / "a.toml", "-i", "virtual")
        return main(["commission", *map(str, (*listed, *arguments, *out))])

    def travels_m(self):
        return self.simulation.world.scene.state.wheels["travel_m"].copy()

    def volts(self):
        return np.abs(self.time.array.bank._voltages_uv).max() * 1e-6


@pytest.fixture
def serve(tmp_path):
    """Makes the array; faults are those of a scenario."""
    contexts = []

    def made(node_ids=(1, 2, 3, 4), *faults):
        bank = PythonBank(node_ids)
        array = SimulatedArray(bank, *TABLE, f"fault=[{', '.join((LIFTED, *faults))}]")
        contexts.append(virtual_time(array))
        return Array(contexts[-1].__enter__(), tmp_path)

    yield made
    for context in reversed(contexts):
        context.__exit__(None, None, None)


def test_wheels_that_are_wired_wrongly_are_named_and_the_others_go_on(serve, tmp_path, capsys):
    array = serve(
        (1, 2, 3, 4),
        "{kind='motor_reversed', cells=[2], axes=[2]}",
        "{kind='wheel_jammed', cells=[3], axes=[1]}",
        "{kind='encoder_stuck', cells=[4], axes=[1]}",
    )
    before_m = array.travels_m()
    assert array.commission("--nudge") == ExitCode.NODE_FAULT
    healthy = [0, 1, 2, 5, 7]
    assert abs(array.travels_m() - before_m)[healthy].max() < 0.02
    message = capsys.readouterr().err
    assert "00000002: node 2, axis 2: the encoder counts against the motor" in message
    assert "00000003: node 3, axis 1: the encoder does not move" in message
    assert "00000004: node 4, axis 1: the encoder does not move" in message
    assert "1 of 4 cells are done, and no file was written" in message
    assert not (tmp_path / "a.toml").exists()


def test_a_cell_that_lost_the_fight_for_its_node_id_gets_its_own(serve, tmp_path, capsys):
    array = serve((1, 2, 2, 4))
    assert array.commission("--nudge") == ExitCode.OK
    assert " has node id 2, as another cell has; it gets its own" in capsys.readouterr().err
    file = read_array(tmp_path / "a.toml")
    assert [(cell.serial, cell.node_id) for cell in file.cells] == [(1, 1), (2, 2), (3, 3), (4, 4)]


def test_wheel_that_pushes_the_wrong_way_is_set_right_and_stays_so(
    serve, tmp_path, monkeypatch, capsys
):
    array = serve()
    # Places, consent to write and to turn, then each axis of each row: that of node 2 went the
    # wrong way, as a second look shows. Node 7 is of no row.
    seen = ["r", "7", "2", "", "", ""]
    answers = "".join(f"{each}\n" for each in ("1", "2", "3", "4", "", "y", "y", *seen))
    terminal = io.StringIO(answers)
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    out = tmp_path / "asked.toml"
    assert main(["commission", *GRID, "--out", str(out), "-i", "virtual"]) == ExitCode.OK
    said = capsys.readouterr().err
    assert said.count("did the top of each wheel move") == 6
    assert "'7' names other nodes than 1-2" in said
    assert "node 2, axis 1: turned the other way round" in said
    cell = read_array(out).cells[1]
    assert [(each.name, number) for each, number in cell.values.items()] == [
        ("axis1.polarity", 0x40)
    ]
    with Commissioning(None, MonotonicClock()) as bus:
        bus.restart(2)
        assert [bus.read(2, index) for index in (0x607E, 0x687E)] == [0x40, 0]
    before_m = array.travels_m()
    again = ["commission", "--from", str(out), "--yes", "--nudge", "-i", "virtual"]
    assert main(again) == ExitCode.OK
    assert (array.travels_m() - before_m)[2] < -0.0005
    assert (array.travels_m() - before_m)[3] > 0.0005


def limits_voltage(frame):
    place = indices.TRIAL_VOLTAGE_LIMIT.to_bytes(2, "little")
    return frame.can_id == cob.SDO_REQUEST_BASE + 3 and frame.data[1:3] == place


def enables(frame):
    words = pdo.CONTROLWORD.decode(frame.data)
    return frame.can_id == pdo.CONTROLWORD.can_id(3) and cia402.ENABLE_OPERATION in words


def starts(frame):
    return frame.can_id == cob.NMT and frame.data[0] == nmt.START


def turns(frame):
    return frame.can_id == pdo.TARGET_VELOCITY.can_id(3)


#: The frame before which node 3's nudge is cut, and its count by then.
STAGES = {
    "starting": (starts, 5),
    "limiting the voltage": (limits_voltage, 1),
    "enabling": (enables, 1),
    "the first setpoint": (turns, 1),
    "amid the push": (turns, 3),
    "the second push": (limits_voltage, 2),
}


class Cut:
    """Does something before the host sends a certain frame; `sent` are all since then."""

    def __init__(self, array, stage, action):
        self.fired = False
        self.sent = []
        self._is_it, self._left = STAGES[stage]
        self._action = action
        array.time.before_send = self._look

    def _look(self, frame):
        self._left -= self._is_it(frame)
        if self._left == 0 and not self.fired:
            self.fired = True
            self._action()
        if self.fired:
            self.sent.append(frame)


@pytest.mark.parametrize(
    ("stage", "killed"), [*((stage, True) for stage in STAGES), ("amid the push", False)]
)
def test_nudge_that_is_broken_off_leaves_wheels_off_and_no_setting_changed(serve, stage, killed):
    # A motor that runs away needs no second push.
    kind = "wheel_jammed" if stage == "the second push" else "motor_reversed"
    array = serve((1, 2, 3, 4), f"{{kind='{kind}', cells=[3], axes=[1]}}")
    with Commissioning(None, MonotonicClock()) as bus:
        before = [bus.read(3, indices.SIGNATURE), bus.read(3, indices.VOLTAGE_LIMIT)]

        def end():
            array.time.mute = killed
            raise KeyboardInterrupt

        cut = Cut(array, stage, end)
        assert array.commission("--nudge") == INTERRUPTED
        assert cut.fired
        array.time.mute = False
        array.time.sleep(BRAKED_S)
        assert array.volts() == 0.0
        after = [bus.read(3, indices.SIGNATURE), bus.read(3, indices.VOLTAGE_LIMIT)]
        assert after == before
        bus.command(nmt.ENTER_PRE_OPERATIONAL, 3)
        array.time.sleep(0.2)
        assert bus.read(3, indices.TRIAL_VOLTAGE_LIMIT) == 0


@pytest.mark.parametrize("stage", STAGES)
def test_nudge_that_another_host_stops_ends_for_all_cells(serve, stage, capsys):
    array = serve((1, 2, 3, 4), "{kind='wheel_jammed', cells=[3], axes=[1]}")
    other = OtherHost(array.time.array)
    cut = Cut(array, stage, other.stop)
    assert array.commission("--nudge") == ExitCode.NODE_FAULT
    assert cut.fired
    message = capsys.readouterr().err
    assert "was stopped: another host has sent 'enter pre-operational'" in message
    # Frames on their way cross the other's command; after it nothing starts or enables.
    later = cut.sent[1:]
    assert not [frame for frame in later if starts(frame) or enables(frame)]
    array.time.sleep(0.2)
    assert array.volts() == 0.0


def test_a_stop_between_two_pushes_ends_the_nudge_too(serve, capsys):
    array = serve((1, 2, 3, 4), "{kind='wheel_jammed', cells=[3], axes=[1]}")
    other = OtherHost(array.time.array)
    sent = []

    def look(frame):
        place = (indices.POSITION).to_bytes(2, "little")
        measures = frame.can_id == cob.SDO_REQUEST_BASE + 3 and frame.data[1:3] == place
        if measures and not sent:
            other.stop()
        if measures or sent:
            sent.append(frame)

    array.time.before_send = look
    assert array.commission("--nudge") == ExitCode.NODE_FAULT
    assert "was stopped: another host" in capsys.readouterr().err
    assert sent
    assert not [frame for frame in sent if starts(frame)]


def test_cell_in_fault_is_not_nudged_and_the_message_has_the_cure(serve, capsys):
    array = serve()
    array.time.array.bank._cells[2]._axes.fail(0x2310)
    assert array.commission("--nudge") == ExitCode.NODE_FAULT
    message = capsys.readouterr().err
    assert "00000003: node 3, axis 1 is in fault, 0x2310: over-current" in message
    assert "remove the cause, then: mdms jog --node 3 --axis 1 --reset" in message
    assert "3 of 4 cells are done" in message


def test_stop_that_the_host_did_not_hear_is_not_undone_by_a_push_that_is_made_again(serve, capsys):
    array = serve()
    cut = Cut(array, "amid the push", lambda: array.time.sleep(0.6))

    def look(frame):
        cut._look(frame)
        again = cut.fired and frame.data[1:3] == indices.POSITION.to_bytes(2, "little")
        if again and frame.can_id == cob.SDO_REQUEST_BASE + 3:
            array.time.array.bank.deliver(2, nmt.command(nmt.ENTER_PRE_OPERATIONAL))

    array.time.before_send = look
    assert array.commission("--nudge") == ExitCode.NODE_FAULT
    assert "0x9000: stopped by another program" in capsys.readouterr().err


def test_fault_of_a_command_that_was_killed_is_reset_by_the_next(serve):
    array = serve()

    def end():
        array.time.mute = True
        raise KeyboardInterrupt

    Cut(array, "amid the push", end)
    assert array.commission("--nudge") == INTERRUPTED
    array.time.mute = False
    array.time.sleep(BRAKED_S)
    with Commissioning(None, MonotonicClock()) as bus:
        assert bus.read(3, indices.ERROR_CODE) == 0x8250
        bus.command(nmt.ENTER_PRE_OPERATIONAL)
        array.time.sleep(0.2)
        assert bus.read(3, indices.ERROR_CODE) == 0x9000
    assert array.commission("--nudge") == ExitCode.OK
