"""`mdms doctor` on an array, in virtual time, in which everything is wrong, one thing a cell."""

import json
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import pytest
from tests.system.links.serving import serving
from tests.virtual_array import OtherHost, SimulatedArray, StandingArray, virtual_time

from mdms_cell.canopen.objects import find
from mdms_host.can_link.link import DeviceGoneError
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.commissioning.doctor.findings import KINDS, known_issues
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo, update
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import EXTENDED
from mdms_sim.nodes.python_bank import PythonBank

BUS = ("-i", "virtual")
NODE_IDS = (*range(1, 10), 9, cob.NODE_NONE, *range(12, 18), cob.HOST_NODE)
FAULTS = (
    "{kind='lift', parcel='box'}",
    "{kind='supply', cells=[1], supply_v=5.0}",
    "{kind='supply', cells=[2], supply_v=20.0}",
    "{kind='drift', cells=[3], drift_ppm=100000}",
    "{kind='sensor_stuck', cells=[4], sensors=[0]}",
    "{kind='motor_reversed', cells=[5], axes=[1]}",
    "{kind='wheel_jammed', cells=[6], axes=[2]}",
    "{kind='corruption', cells=[14], seen_by=[13], probability=0.15}",
)
#: The places of each kind of finding, without an array file and without a turn of a wheel.
#: A cell that was off the bus is in fault for that, too.
EXPECTED = {
    "bus-errors": [()],
    # Two that answer under one node id spoil each other's frames.
    "node-errors": [(9,), (14,)],
    "adapter": [()],
    "bus-off": [(14,)],
    "overrun": [(14,)],
    "not-sent": [(14,)],
    "double-id": [(9,)],
    "twin-serial": [(16, 17)],
    "host-id": [(127,)],
    "blank": [()],
    "stranger": [(61,)],
    "silent-node": [(60,), (62,)],
    "other-protocol": [(12,)],
    "versions": [(13,)],
    "drive-fault": [(15,), (15,)],
    "supply-low": [(1,)],
    "supply-uneven": [(2,)],
    "clock": [(3,)],
    "sensor": [(4,)],
    "heap": [(14,)],
    "flash": [(14,)],
    "rolled-back": [(17,)],
    "on-trial": [(17,)],
    "elsewhere": [(1,)],
    "neighbours": [(13,), (16,), (16,)],
    "suspected": [(8,)],
}
OF_WHEELS = {"opposed": [(5,)], "stands": [(6,)], "scale": [(7,)], "no-drive": [(8,)]}
OF_LIST = {"missing", "unlisted", "settings"}
ELSEWHERE = {"silence", "other-host", "gap"}
#: In `test_doctor_stop`.
OF_STOP = {"stop-welded", "stop-delay", "stop-silent", "stop-stays", "stop-restarts"}


class Bank(PythonBank):
    """Cells of which two have the same serial number."""

    def _board(self, cell):
        board = super()._board(cell)
        board.serial = 16 if cell == 16 else board.serial
        return board


class Strangers:
    """Three nodes, and frames of 29 bits.

    One sends heartbeats and answers nothing. One refuses all. One breaks each transfer off.
    """

    SILENT = 60
    ABORTS = MappingProxyType({61: sdo.NO_SUCH_OBJECT, 62: sdo.TIMED_OUT})

    def __init__(self, array, time):
        self._array = array
        self._time = time
        self._send = array.attach(self.on_frame)
        self.talk()

    def on_frame(self, frame, _now_s):
        node_id = frame.can_id - cob.SDO_REQUEST_BASE
        if node_id in self.ABORTS and frame.data[0] != sdo.ABORT:
            index, sub = int.from_bytes(frame.data[1:3], "little"), frame.data[3]
            refusal = sdo.abort(index, sub, self.ABORTS[node_id])
            self._send(Frame(cob.SDO_RESPONSE_BASE + node_id, refusal))

    def talk(self):
        self._send(nmt.heartbeat(self.SILENT, nmt.PRE_OPERATIONAL))
        self._send(Frame(EXTENDED | 0x12345678, b""))
        self._time.garbled += 1
        kernel = self._array.simulation.kernel
        kernel.at(kernel.now_ns + 100_000_000, 0, self.talk)


@pytest.fixture
def array():
    """The array in virtual time, with all its faults."""
    bank = Bank(NODE_IDS)
    simulated = SimulatedArray(bank, f"fault=[{', '.join(FAULTS)}]")
    with virtual_time(simulated) as time:
        time.sleep(0.5)
        spoil(bank)
        Strangers(simulated, time)
        yield bank


def spoil(bank):
    """Give cells faults that no fault of a scenario causes."""
    cells = dict(enumerate(bank._cells, 1))
    objects = {number: cell._objects for number, cell in cells.items()}
    objects[7].put(indices.RESOLUTION, 0, 2 * objects[7].number(indices.RESOLUTION))
    cells[7]._axes.load()
    objects[8].put(indices.CONTROL, 0, 1)
    objects[18].put(indices.SUSPECT, 0, 8)
    objects[12].put(indices.IDENTITY, 3, 0x00020000)
    version = find(indices.SOFTWARE_VERSION, 0).place
    objects[13].data[version : version + 1] = b"9"
    bank.set_bus_off(13, True)
    bank.set_bus_off(13, False)
    cells[14].not_sent = 7
    bank._boards[13].inbox = SimpleNamespace(lost=3)
    for sub in (1, 2):
        objects[3].tie(indices.MEMORY, sub, refused)  # as while its wheels are on: no finding
    objects[14].tie(indices.MEMORY, 1, lambda: 1000)
    objects[14].tie(indices.MEMORY, 2, lambda: 2000)
    objects[17].tie(indices.FLASH_STATUS, 1, lambda: update.status(update.ROLLED_BACK, False))
    objects[17].tie(indices.UPDATE, 8, lambda: 1)
    cells[15]._axes.fail(0x2310)
    bank.set_place(0, 12)
    cells[1].on_frame(cob.NMT, nmt.command(nmt.START, 1).data, cells[1].now_ms)
    for number, spot in ((13, (1, 1)), (16, (1, 1))):
        for sub, value in enumerate(spot, 1):
            objects[number].put(indices.PLACE, sub, value)
    objects[16].put(indices.NEIGHBOURS, 1, 13)


def refused():
    raise sdo.AbortError(sdo.WRONG_STATE)


def found(capsys):
    document = json.loads(capsys.readouterr().out)
    kinds = {}
    for finding in document["findings"]:
        kinds.setdefault(finding["kind"], []).append(tuple(finding["nodes"]))
    return kinds, document


def test_each_fault_is_found_at_its_cell_and_nothing_else(array, capsys):
    """Faults of wheels are found at those that are turned."""
    assert main(["doctor", "--json", "--turn", "--node", "5-8", *BUS]) == ExitCode.NODE_FAULT
    kinds, document = found(capsys)
    assert kinds == EXPECTED | OF_WHEELS
    (row,) = (each for each in document["findings"] if each["kind"] == "supply-low")
    assert row["text"] == "5.0 V, 10 V are needed"
    assert row["serious"]
    assert row["cause"] == KINDS["supply-low"].cause


def test_cells_and_settings_are_compared_with_a_file(array, tmp_path, capsys):
    array._cells[5]._objects.put(indices.GAIN, 0, 7_000)
    path = tmp_path / "array.toml"
    listed = [(1, 1), (2, 3), (77, 77), (6, 6)]
    path.write_text(
        "".join(f'[[cell]]\nserial = "{serial:08X}"\nnode = {node}\n' for serial, node in listed)
        + "settings.axis1.gain = 13.0\n"
    )
    assert main(["doctor", "--array", str(path), *BUS]) == ExitCode.NODE_FAULT
    printed = capsys.readouterr()
    assert "     node 77: 0000004D is to be node 77\n" in printed.out
    assert "     node 5: 00000005 is in no place\n" in printed.out
    assert "     node 2: 00000002 is to be node 3\n" in printed.out
    assert "     node 6: axis1.gain is 7 V s/m, the file has 13 V s/m\n" in printed.out
    assert "   cure:  Release the stop and reset its module; measure 24 V at the" in printed.out
    assert "wheels were not turned" in printed.err


def test_settings_that_a_run_has_left_are_no_finding(tmp_path, capsys):
    bank = PythonBank(range(1, 19))
    path = tmp_path / "array.toml"
    path.write_text(
        "".join(f'[[cell]]\nserial = "{node:08X}"\nnode = {node}\n' for node in range(1, 19))
    )
    with virtual_time(SimulatedArray(bank)):
        for cell in bank._cells:
            for gain in (indices.GAIN, indices.GAIN + indices.AXIS_OFFSET):
                cell._objects.put(gain, 0, 9_000)
        assert main(["doctor", "--array", str(path), *BUS]) == ExitCode.OK
        assert "18 cells: 0 serious findings" in capsys.readouterr().out
        bank._cells[4]._objects.put(indices.REVERSAL_TIME, 0, 1)
        assert main(["doctor", "--array", str(path), *BUS]) == ExitCode.NODE_FAULT


def test_a_wheel_that_cannot_be_turned_is_told_with_its_node_once(capsys):
    bank = PythonBank(range(1, 19))
    with virtual_time(SimulatedArray(bank, "fault=[{kind='lift', parcel='box'}]")):
        bank._cells[1]._axes.fail(0x2310)
        assert main(["doctor", "--turn", "--node", "2", *BUS]) == ExitCode.NODE_FAULT
    told = capsys.readouterr().out
    assert "\n     node 2, axis 1 is in fault, 0x2310" in told
    assert "node 2: node 2" not in told


@pytest.mark.parametrize("event", ["power off", "stop"])
def test_findings_are_not_lost_with_a_cell_that_dies_or_is_stopped_amid_a_turn(capsys, event):
    bank = PythonBank(range(1, 19))
    array = SimulatedArray(bank, "fault=[{kind='lift', parcel='box'}]")
    started = []

    def look(frame):
        if frame == nmt.command(nmt.START, 2) and 2 not in started:
            bank.power_off(1) if event == "power off" else OtherHost(array).stop()
        if frame.can_id == cob.NMT and frame.data[0] == nmt.START:
            started.append(frame.data[1])

    with virtual_time(array) as time:
        time.before_send = look
        arguments = ["doctor", "--json", "--turn", "--node", "1-3", *BUS]
        assert main(arguments) == ExitCode.NODE_FAULT
    kinds, _ = found(capsys)
    assert kinds.pop("no-drive") == [(2,)]
    assert kinds.pop("silent-node", None) == ([(2,)] if event == "power off" else None)
    assert (3 in started) == (event == "power off")


def test_a_cell_that_restarts_between_two_pushes_is_a_finding(capsys):
    bank = PythonBank(range(1, 19))
    pushes = []

    def look(frame):
        if frame == nmt.command(nmt.ENTER_PRE_OPERATIONAL, 2):
            pushes.append(frame)
            if len(pushes) == 1:
                bank.restart(1)

    with virtual_time(SimulatedArray(bank, "fault=[{kind='lift', parcel='box'}]")) as time:
        time.before_send = look
        arguments = ["doctor", "--json", "--turn", "--node", "2", *BUS]
        assert main(arguments) == ExitCode.NODE_FAULT
    assert len(pushes) > 1
    kinds, _ = found(capsys)
    assert kinds == {"no-drive": [(2,)]}


def test_wheels_that_were_turned_before_a_stop_are_not_said_to_stand(capsys):
    array = SimulatedArray(PythonBank(range(1, 19)), "fault=[{kind='lift', parcel='box'}]")
    other = OtherHost(array)
    with virtual_time(array) as time:
        time.before_send = lambda frame: frame == nmt.command(nmt.START, 2) and other.stop()
        assert main(["doctor", "--turn", "--node", "1-2", *BUS]) == ExitCode.NODE_FAULT
    assert "\nfurther wheels were not turned, so" in capsys.readouterr().err


def test_findings_are_not_lost_with_an_adapter_that_is_unplugged_amid_a_turn(capsys):
    jammed = "{kind='wheel_jammed', cells=[1], axes=[2]}"
    array = SimulatedArray(
        PythonBank(range(1, 19)), f"fault=[{{kind='lift', parcel='box'}}, {jammed}]"
    )

    def look(frame):
        if frame == nmt.command(nmt.START, 2):
            raise DeviceGoneError("the CAN device is gone")

    with virtual_time(array) as time:
        time.before_send = look
        assert main(["doctor", "--json", "--turn", *BUS]) == ExitCode.NO_DEVICE
    printed = capsys.readouterr()
    assert [each["kind"] for each in json.loads(printed.out)["findings"]] == ["stands"]
    assert "the CAN device is gone" in printed.err


def test_findings_are_not_lost_with_a_cell_that_hangs_while_its_settings_are_read(tmp_path, capsys):
    path = tmp_path / "array.toml"
    rows = [f'[[cell]]\nserial = "{node:08X}"\nnode = {node}\n' for node in (1, 2, 3)]
    path.write_text("".join(rows) + "settings.axis1.stall_time = 1.0\n")
    array = StandingArray(PythonBank((1, 2, 3)), 3)
    attach = array.attach

    def deaf(deliver):
        send = attach(deliver)
        stall = indices.STALL_TIME.to_bytes(2, "little")
        hung = []

        def lossy(frame):
            hung.extend([frame] * (frame.can_id == 0x601 and frame.data[1:3] == stall))
            if frame.can_id != 0x601 or not hung:
                send(frame)

        return lossy

    array.attach = deaf
    with virtual_time(array):
        assert main(["doctor", "--json", "--array", str(path), *BUS]) == ExitCode.NODE_FAULT
    kinds = found(capsys)[0]
    assert (kinds["silent-node"], kinds["settings"]) == ([(1,)], [(3,)])


def test_an_empty_bus_is_a_finding_and_so_is_another_host(capsys):
    nobody = StandingArray(None, 0)
    with virtual_time(nobody):
        assert main(["doctor", "--json", *BUS]) == ExitCode.NODE_FAULT
        assert found(capsys)[0] == {"silence": [()]}
        send = nobody.attach(lambda _frame, _now_s: None)
        nobody.hand = lambda: send(nmt.heartbeat(cob.HOST_NODE, nmt.OPERATIONAL))
        assert main(["doctor", "--json", *BUS]) == ExitCode.NODE_FAULT
        assert found(capsys)[0] == {"silence": [()], "other-host": [()]}


def test_a_healthy_array_has_no_findings_though_a_device_beside_it_sends_29_bits(capsys):
    array = SimulatedArray(PythonBank(range(1, 19)))
    send, kernel = array.attach(lambda *_frame: None), array.simulation.kernel
    for time_ms in range(0, 3_000, 50):
        kernel.at(time_ms * 1_000_000, 0, lambda: send(Frame(EXTENDED | 0x12345678, b"")))
    with virtual_time(array):
        assert main(["doctor", *BUS]) == ExitCode.OK
        told = capsys.readouterr()
        assert told.out == "18 cells: 0 serious findings, 0 warnings\n"
        assert "how many cells there are to be: unknown, so a cell that is gone may go" in told.err


def test_cells_behind_a_blown_fuse_make_the_healthy_ones_no_exception(capsys):
    dark = "fault=[{kind='supply', cells=[1, 2], supply_v=0.0}]"
    small = ("array.columns=2", "array.rows=2", "parcel=[]", "motion.field='inward'")
    with virtual_time(SimulatedArray(PythonBank(range(1, 5)), *small, dark)):
        assert main(["doctor", "--json", *BUS]) == ExitCode.NODE_FAULT
        assert found(capsys)[0] == {"supply-low": [(1,), (2,)]}


def test_a_dead_cell_is_missing_in_the_count_and_else_a_gap(capsys):
    dead = "fault=[{kind='off', cells=[7]}]"
    with virtual_time(SimulatedArray(PythonBank(range(1, 19)), dead)):
        assert main(["doctor", "--json", *BUS]) == ExitCode.OK
        assert found(capsys)[0] == {"gap": [(7,)]}
        assert main(["doctor", "--json", "--cells", "18", *BUS]) == ExitCode.NODE_FAULT
        assert found(capsys)[0] == {"missing": [(7,)]}


@pytest.mark.real_time
def test_a_served_array_is_examined_over_its_bus(tmp_path, capsys):
    channel = str(tmp_path / "bus.sock")
    fault = "fault=[{kind='supply', cells=[7], supply_v=5.0}]"
    with serving(PythonBank(range(1, 19)), channel, "array18", fault):
        assert main(["doctor", "--json", "-i", "mdms", "-c", channel]) == ExitCode.NODE_FAULT
    assert found(capsys)[0] == {"supply-low": [(7,)]}


def test_every_kind_of_finding_is_provoked_here():
    assert {*EXPECTED, *OF_WHEELS, *OF_LIST, *ELSEWHERE, *OF_STOP} == {*KINDS}


def test_each_pain_of_others_names_tests_that_exist():
    issues = known_issues()
    assert all(issue.tests for issue in issues)
    for test in (test for issue in issues for test in issue.tests):
        path, _, function = test.partition("::")
        assert f"def {function}(" in (Path(__file__).parents[3] / path).read_text(), test
