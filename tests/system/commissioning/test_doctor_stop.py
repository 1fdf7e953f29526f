"""`mdms doctor --stop` on an array in virtual time, with a stand-in for the person."""

import json
import os
import pty
import subprocess
from contextlib import contextmanager

import pytest
from tests.conftest import MDMS
from tests.virtual_array import Pump, SimulatedArray, virtual_time

from mdms_host.cli import main
from mdms_host.cli.cells import doctor
from mdms_host.cli.cells.asking import AtTerminal, pressed_keys
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_model.scenario.fault import Fault
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank

CELLS = range(1, 7)
#: A table for them, with nothing on it.
SMALL = (
    "array.columns=3",
    "array.rows=2",
    "parcel.0.x_m=0",
    "parcel.0.y_m=0",
    "parcel.0.goal.x_m=0.01",
    "parcel.0.goal.y_m=0",
    "fault=[{kind='lift', parcel='box'}]",
)
STOP = ["doctor", "--stop", "-i", "virtual"]
NS_PER_S = 1_000_000_000
#: Before a hand is at the button, and from there to Enter.
REACHES_S, ENTERS_S = 0.3, 0.4
#: The part of 24 V that cells measure while their bridges are pulled low.
PULLED_V = 6.5


class Table(SimulatedArray):
    """An array with an emergency stop, which by default all cells have, and one form of it."""

    def __init__(self):
        super().__init__(PythonBank(CELLS), *SMALL)
        self.keys = ""
        self.asked = []
        #: By cell: which have a stop that works, and how long after the press.
        self.stopped = {0.0: (*CELLS,)}
        self.form, self.delayed = "short", True
        self.on_press = self.on_release = lambda: None
        self._faults = []

    def after(self, seconds, do):
        kernel = self.simulation.kernel
        kernel.at(kernel.now_ns + round(seconds * NS_PER_S), 0, do)

    def press(self):
        for late_s, cells in self.stopped.items():
            if self.form == "short":
                self.after(late_s, lambda cells=cells: self._cut(cells, 0.0))
            else:
                self.after(late_s, lambda cells=cells: self._cut(cells, PULLED_V))
                if self.delayed:
                    self.after(late_s + 1.0, lambda cells=cells: self._cut(cells, 0.0))
        self.on_press()

    def release(self):
        for ongoing in self._faults:
            self.simulation.faults.end(ongoing)
        self.on_release()

    def _cut(self, cells, supply_v):
        if cells:
            fault = Fault("supply", cells=cells, supply_v=supply_v, brake=True)
            self._faults.append(self.simulation.faults.begin(fault))


class Person(AtTerminal):
    """Presses and releases as asked, after a while."""

    table = None

    def ask(self, text):
        super().ask(text)
        self.table.asked.append(text)
        if "press" in text:
            self.table.after(REACHES_S, self.table.press)
            self.table.after(REACHES_S + ENTERS_S, self._enter)
        else:
            self.table.after(REACHES_S, self.table.release)

    def _enter(self):
        self.table.keys += "\n"


class Nobody(AtTerminal):
    """Does not do the requested action."""


@pytest.fixture
def table(monkeypatch):
    array = Table()

    @contextmanager
    def keys(_without):
        def pressed():
            taken, array.keys = array.keys, ""
            return taken

        yield pressed

    monkeypatch.setattr(Person, "table", array)
    monkeypatch.setattr(doctor, "AtTerminal", Person)
    monkeypatch.setattr(doctor, "pressed_keys", keys)
    with virtual_time(array):
        yield array


def found(capsys):
    """The findings: kind, nodes and text."""
    document = json.loads(capsys.readouterr().out)
    rows = [(each["kind"], tuple(each["nodes"]), each["text"]) for each in document["findings"]]
    return rows, document


def test_a_good_stop_is_pressed_and_released_and_nothing_is_found(table, capsys):
    Pump(table)
    assert main(STOP) == ExitCode.OK
    printed = capsys.readouterr()
    assert printed.out.startswith("6 cells: the last lost its supply 0.")
    assert printed.out.endswith("s after the first, and all stayed off after the release\n")
    assert table.asked == [
        "press the emergency stop, then Enter",
        "release the emergency stop, and reset its module",
    ]


def test_a_relay_that_is_welded_is_named_and_the_release_is_not_asked_for(table, capsys):
    table.stopped = {0.0: tuple(cell for cell in CELLS if cell != 5)}
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    rows, document = found(capsys)
    assert rows == [("stop-welded", (5,), "24.0 V, though the supply of other cells has fallen")]
    assert sorted(map(int, document["fell_s"])) == [cell for cell in CELLS if cell != 5]
    assert len(table.asked) == 1


def test_a_relay_that_opens_too_late_is_as_bad_as_one_that_is_welded(table, capsys):
    table.stopped = {0.0: tuple(CELLS)[:-1], 0.8: (6,)}
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    assert [row[:2] for row in found(capsys)[0]] == [("stop-welded", (6,))]


def test_a_stop_that_no_cell_feels_is_welded_for_all(table, capsys):
    table.stopped = {}
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    assert found(capsys)[0] == [
        ("stop-welded", tuple(CELLS), "no cell has lost its supply; they measure 24.0 V")
    ]


CATEGORY_1 = (
    '[array]\ncolumns = 3\nrows = 2\n[stop]\nform = "category_1"\nmass_kg = 2\nspeed_m_s = 0.4\n'
    + "".join(f'[[cell]]\nserial = "{cell:08X}"\nnode = {cell}\n' for cell in CELLS)
)


@pytest.fixture
def category_1(table, tmp_path):
    """The options of a table whose bridges are pulled low, and lose their supply a second later."""
    table.form = "category_1"
    path = tmp_path / "array.toml"
    path.write_text(CATEGORY_1)
    return [*STOP, "--array", str(path)]


def test_a_stop_of_category_1_pulls_all_bridges_low_and_cuts_their_supply(category_1, capsys):
    assert main([*category_1, "--json"]) == ExitCode.OK
    rows, document = found(capsys)
    assert not rows
    assert document["form"] == "category_1"


def test_a_time_relay_that_is_welded_is_found(table, category_1, capsys):
    table.delayed = False
    assert main([*category_1, "--json"]) == ExitCode.FAILURE
    wanted = ("stop-delay", tuple(CELLS), "6.5 V 1.6 s after the stop was pressed")
    assert found(capsys)[0] == [wanted]


def test_a_cell_whose_bridges_are_not_pulled_low_is_named(table, category_1, capsys):
    """It loses its supply with the others, a second too late."""
    table.stopped = {0.0: tuple(CELLS)[1:]}
    table.on_press = lambda: table.after(1.0, lambda: table._cut((1,), 0.0))
    assert main([*category_1, "--json"]) == ExitCode.FAILURE
    text = "its supply fell 1.0 s after the first cell's; 0.5 s are allowed"
    assert found(capsys)[0] == [("stop-welded", (1,), text)]


def test_no_press_is_a_time_limit(table, capsys, monkeypatch):
    monkeypatch.setattr(doctor, "AtTerminal", Nobody)
    assert main([*STOP, "--limit", "5"]) == ExitCode.TIME_LIMIT
    assert "mdms: nobody has pressed the emergency stop for 5 s\n" in capsys.readouterr().err


def test_no_release_is_a_time_limit_too(table, capsys):
    table.release = lambda: None
    assert main([*STOP, "--limit", "5"]) == ExitCode.TIME_LIMIT
    assert "mdms: nobody has released the emergency stop for 5 s\n" in capsys.readouterr().err


def test_a_cell_whose_relay_does_not_close_again_is_named(table, capsys):
    ends = table.release

    def release():
        ends()
        table._cut((4,), 0.0)

    table.release = release
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    rows, _ = found(capsys)
    assert rows == [("stop-stays", (4,), "0.0 V 2 s after other cells had theirs back")]


def test_a_stop_that_is_pressed_again_while_wheels_are_watched_proves_nothing(table, capsys):
    table.on_release = lambda: table.after(1.0, lambda: table._cut((2,), 0.0))
    assert main(STOP) == ExitCode.FAILURE
    assert "mdms: node 2 has lost its supply again; release" in capsys.readouterr().err


class OtherHost:
    """A host that enables and drives cell 6 from the release on."""

    def __init__(self, table, axes):
        self._send = table.attach(lambda _frame, _now_s: None)
        self._table = table
        self._words = [cia402.FAULT_RESET, cia402.SHUTDOWN, cia402.SWITCH_ON]
        self._words.append(cia402.ENABLE_OPERATION)
        self._axes = axes

    def drive(self):
        self._send(nmt.command(nmt.START, 6))
        if self._words:
            word = self._words.pop(0)
            self._send(Frame(cob.RPDO_BASES[1] + 6, pdo.CONTROLWORD.encode((word, word))))
        self._send(Frame(cob.RPDO_BASES[0] + 6, pdo.TARGET_VELOCITY.encode(self._axes)))
        self._send(Frame(cob.SYNC, b""))
        self._table.after(0.01, self.drive)


def test_a_wheel_that_is_driven_after_the_release_is_named(table, capsys):
    table.on_release = OtherHost(table, (100_000, 0)).drive
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    rows, _ = found(capsys)
    assert rows == [("stop-restarts", (6,), "axis 1 is in 'operation enabled'")]


def test_a_wheel_that_turns_though_its_cell_says_it_is_off_is_named(table, capsys):
    """A bridge that is damaged: here it is the encoder that runs on."""

    def turn():
        table.simulation.world.scene.state.wheels["travel_m"][2] += 0.001
        table.after(0.1, turn)

    table.on_release = turn
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    rows, _ = found(capsys)
    assert [row[:2] for row in rows] == [("stop-restarts", (2,))]
    assert rows[0][2].startswith("axis 1 has moved by ")


def test_a_cell_that_loses_its_controllers_supply_is_named(table, capsys):
    def lose():
        table._faults.append(table.simulation.faults.begin(Fault("off", cells=(5,))))

    table.on_press = lose
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    assert [row[:2] for row in found(capsys)[0]] == [("stop-silent", (5,))]


@pytest.mark.parametrize("late_s", [0.0, 1.0])
def test_a_cell_that_falls_silent_at_the_release_or_after_it_is_named(table, capsys, late_s):
    def lose():
        table.simulation.faults.begin(Fault("off", cells=(5,)))

    table.on_release = lambda: table.after(late_s, lose)
    assert main([*STOP, "--json"]) == ExitCode.FAILURE
    assert [row[:2] for row in found(capsys)[0]] == [("stop-silent", (5,))]


def test_a_cell_in_a_fault_of_its_own_is_no_candidate(table, capsys):
    table.bank._cells[2]._axes.fail(0x2310)
    assert main(STOP) == ExitCode.NODE_FAULT
    assert "mdms: node 3, axis 1 is in fault, 0x2310: " in capsys.readouterr().err
    assert not table.asked


def test_a_stop_that_is_pressed_already_is_to_be_released_first(table, capsys):
    table._cut((3, 4), 0.0)
    assert main(STOP) == ExitCode.FAILURE
    assert "mdms: node 3 measures 0.0 V already, 10.0 V are needed; release" in (
        capsys.readouterr().err
    )
    assert not table.asked


def test_without_a_terminal_nobody_can_be_asked():
    ran = subprocess.run(
        [MDMS, *STOP], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert ran.returncode == ExitCode.USAGE
    assert ran.stderr == (
        "mdms: mdms doctor --stop needs a person at a terminal, who presses the emergency stop\n"
    )


def test_q_at_a_terminal_breaks_the_test_off():
    """Keys come from a terminal as they do for a person."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdin", terminal)
        with pressed_keys("no terminal") as pressed:
            person = AtTerminal(pressed)
            os.write(ours, b"\n")
            person.ask("press")
            assert not person.answered()
            os.write(ours, b"\n")
            assert person.answered()
            assert not person.answered()
            os.write(ours, b"q")
            with pytest.raises(CommandError, match="broken off"):
                person.answered()
    os.close(ours)


def test_a_terminal_that_is_gone_ends_all_as_q_does():
    ours, theirs = pty.openpty()
    with os.fdopen(theirs) as terminal, pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdin", terminal)
        with pressed_keys("no terminal") as pressed:
            os.close(ours)
            assert pressed() == "q"
