"""`mdms commission` that ends in the middle, at any stage, and the result of the next run."""

import json

import pytest
from tests.host.cli.commission.on_the_table import GRID, NONE, ORDER, answered, serials

from mdms_host.cli import main
from mdms_host.cli.exits import INTERRUPTED, ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.array_file import read_array
from mdms_host.commissioning.network import Commissioning
from mdms_protocol import indices
from mdms_protocol.codecs import cob, lss, nmt, sdo


def lss_frame(command):
    return lambda frame: frame.can_id == cob.LSS_REQUEST and frame.data[0] == command


def sdo_frame(kind, index, sub=0):
    place = index.to_bytes(2, "little") + bytes((sub,))
    first = range(cob.SDO_REQUEST_BASE + 1, cob.SDO_REQUEST_BASE + cob.NODE_MAX)

    def is_it(frame):
        same = frame.data[:1] and frame.data[0] & sdo.SPECIFIER == kind
        return frame.can_id in first and bool(same) and frame.data[1:4] == place

    return is_it


SELECT = lss_frame(lss.SWITCH_SERIAL)
GIVE_ID = lss_frame(lss.CONFIGURE_NODE_ID)
STORE_ID = lss_frame(lss.STORE)
LEAVE = lss_frame(lss.SWITCH_GLOBAL)
WRITE_ROW = sdo_frame(sdo.DOWNLOAD, indices.PLACE, 2)
STORE = sdo_frame(sdo.DOWNLOAD, indices.STORE, 1)
READ_BACK = sdo_frame(sdo.UPLOAD, indices.SIGNATURE)
READ_GAIN = sdo_frame(sdo.UPLOAD, indices.GAIN)


def restart(frame):
    return frame.can_id == cob.NMT and frame.data[0] == nmt.RESET_NODE


#: Frames by their meaning, in their order; frames before the last are cut there.
STAGES = {
    "in the search": [lss_frame(lss.FAST_SCAN)] * 20,
    "in the roll call": [lss_frame(lss.IDENTIFY_SERIAL_HIGH)],
    "before a search takes an id back": [GIVE_ID],
    "before an id is given": [SELECT, GIVE_ID],
    "between write of an id and store": [GIVE_ID, STORE_ID],
    "between store of an id and boot": [GIVE_ID, STORE_ID, LEAVE],
    "between the first id and the second": [GIVE_ID, STORE_ID, LEAVE, GIVE_ID],
    "amid the settings of a cell": [WRITE_ROW],
    "between settings and store": [WRITE_ROW, STORE],
    "between store and restart": [STORE, restart],
    "between restart and read back": [STORE, restart, READ_BACK],
    "between a cell and the next": [STORE, restart, READ_BACK, WRITE_ROW],
    "between the last cell and the file": [STORE, STORE, STORE, READ_GAIN],
}


#: Stages at which a command that is interrupted still has to tidy up.
TIDIED = [*STAGES][:7]


class Cut:
    """Ends the host's program before it sends a certain frame, as Ctrl-C or as `kill -9` does."""

    def __init__(self, cells, frames, *, killed=False):
        self.fired = False
        self._cells = cells
        self._frames = list(frames)
        self._killed = killed
        cells.before_send = self._look

    def _look(self, frame):
        if not self.fired and self._frames[0](frame):
            self._frames.pop(0)
            if not self._frames:
                self.fired = True
                self._cells.mute = self._killed
                raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("stage", "killed"),
    [*((stage, True) for stage in STAGES), *((stage, False) for stage in TIDIED)],
)
@pytest.mark.parametrize("cells", [(NONE,) * 3], indirect=True)
def test_broken_off_at_any_stage_it_ends_well_the_next_time(
    commission, listed, cells, stage, killed
):
    cut = Cut(cells, STAGES[stage], killed=killed)
    assert commission("--list", listed, *GRID, "--yes") == INTERRUPTED
    assert cut.fired
    cells.mute = False
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
    switched_off_and_on(cells)
    with Commissioning(None, MonotonicClock()) as bus:
        assert serials(bus) == list(ORDER)
        assert [bus.read(node_id, indices.PLACE, 1) for node_id in range(1, 4)] == [1, 2, 3]


def switched_off_and_on(cells):
    for cell in range(3):
        cells.array.bank.power_off(cell)
        cells.array.bank.restart(cell)
    cells.sleep(0.3)


@pytest.mark.parametrize("cells", [(NONE,) * 3], indirect=True)
def test_a_node_id_that_a_killed_command_has_not_stored_is_given_again(cells, capsys):
    Cut(cells, [GIVE_ID, STORE_ID], killed=True)
    assign = ["configure", "assign", "-i", "virtual"]
    assert main(assign) == INTERRUPTED
    cells.mute = False
    assert doctor_finds(capsys) == ["blank"]
    assert main(assign) == ExitCode.OK
    switched_off_and_on(cells)
    with Commissioning(None, MonotonicClock()) as bus:
        assert serials(bus) == [1, 2, 3]


def doctor_finds(capsys):
    capsys.readouterr()
    main(["doctor", "--json", "-i", "virtual"])
    findings = json.loads(capsys.readouterr().out)["findings"]
    return [each["kind"] for each in findings if each["serious"]]


def test_a_cell_that_was_to_lose_its_node_id_is_taken_for_no_second_cell(
    commission, listed, bus, cells, capsys
):
    cut = Cut(cells, [GIVE_ID, restart], killed=True)
    assert commission("--list", listed, *GRID, "--yes") == INTERRUPTED
    assert cut.fired
    cells.mute = False
    assert main(["configure", "assign", "-i", "virtual"]) == ExitCode.OK
    assert "no cell needs a node id" in capsys.readouterr().out
    assert doctor_finds(capsys) == []
    for node_id in (1, 2, 3):
        bus.restart(node_id)
    assert serials(bus) == [1, 2, 3]


@pytest.mark.parametrize("last", [[], [restart]], ids=["selected", "without an id"])
def test_the_doctor_leaves_each_cell_its_node_id(commission, listed, cells, capsys, last):
    cut = Cut(cells, [SELECT, GIVE_ID, *last], killed=True)
    assert commission("--list", listed, *GRID, "--yes") == INTERRUPTED
    assert cut.fired
    cells.mute = False
    assert doctor_finds(capsys) == []
    with Commissioning(None, MonotonicClock()) as bus:
        for node_id in (1, 2, 3):
            bus.restart(node_id)
        assert serials(bus) == [1, 2, 3]


@pytest.mark.parametrize("again", ["commission", "assign"])
def test_a_cell_that_was_to_lose_its_node_id_gets_its_own_the_next_time(
    commission, listed, cells, tmp_path, again
):
    Cut(cells, [GIVE_ID, restart], killed=True)
    assert commission("--list", listed, *GRID, "--yes") == INTERRUPTED
    cells.mute = False
    if again == "commission":
        assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
    else:
        rows = (f'[[cell]]\nserial = "{one:08X}"\nnode = {n}\n' for n, one in enumerate(ORDER, 1))
        file = tmp_path / "ids.toml"
        file.write_text("".join(rows))
        assigned = main(["configure", "assign", "--from", str(file), "-i", "virtual"])
        assert assigned == ExitCode.OK
    with Commissioning(None, MonotonicClock()) as bus:
        for node_id in (1, 2, 3):
            bus.restart(node_id)
        assert serials(bus) == list(ORDER)


def test_an_answer_that_was_cut_in_two_is_asked_again(commission, cells, tmp_path, monkeypatch):
    path = tmp_path / "row.txt"
    path.write_text("1 2 3")
    assert commission("--list", path, *GRID, "--yes") == ExitCode.OK
    # The row becomes a column: serial 2 is to go from (2, 1) to (1, 2), and is cut at (1, 1).
    column = ("--columns", "1", "--rows", "3")
    cut = Cut(cells, [STORE, WRITE_ROW])
    answered(monkeypatch, "3", "2")
    assert commission(*column, "--again") == INTERRUPTED
    assert cut.fired
    answered(monkeypatch, "2", "1", "", "y", "n")
    assert commission(*column) == ExitCode.OK
    file = read_array(tmp_path / "array.toml")
    assert {cell.serial: cell.number for cell in file.cells} == {1: 3, 2: 2, 3: 1}


def test_a_cell_that_restarts_before_it_has_stored_is_named_and_the_next_run_mends_it(
    commission, listed, cells, capsys
):
    def look(frame):
        if STORE(frame):
            cells.before_send = lambda _frame: None
            cells.array.bank.restart(ORDER[0] - 1)
            cells.sleep(0.2)

    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
    assert main(["configure", "restore-defaults", "--yes", "-i", "virtual"]) == ExitCode.OK
    cells.before_send = look
    capsys.readouterr()
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.NODE_FAULT
    assert "00000002: node 1 restarted meanwhile" in capsys.readouterr().err
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
    with Commissioning(None, MonotonicClock()) as bus:
        assert [bus.read(node_id, indices.PLACE, 1) for node_id in range(1, 4)] == [1, 2, 3]


def test_a_cell_that_dies_in_the_middle_is_named_and_the_next_run_mends_it(  # noqa: PLR0917
    commission, listed, bus, cells, tmp_path, monkeypatch, capsys
):
    from mdms_host.commissioning import commissioner

    usual = commissioner.write_settings

    def dies(commissioning, cell):
        if cell.node_id == 3:
            cells.array.bank.power_off(0)
        return usual(commissioning, cell)

    monkeypatch.setattr(commissioner, "write_settings", dies)
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.NODE_FAULT
    message = capsys.readouterr().err
    assert "00000001: node 3" in message
    assert "2 of 3 cells are done, and no file was written" in message
    assert not (tmp_path / "array.toml").exists()
    monkeypatch.undo()
    cells.array.bank.restart(0)
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
    assert serials(bus) == list(ORDER)
