"""`mdms commission` on a bus of firmware cells, whatever state it finds them in."""

import io
import itertools
import json
import tomllib

import numpy as np
import pytest
from tests.virtual_array import StandingArray, virtual_time

from mdms_host.cli import main
from mdms_host.cli.commission.plate import check_corner
from mdms_host.cli.exits import INTERRUPTED, CommandError, Exit
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.array_file import read_array
from mdms_host.commissioning.array_writing import array_document
from mdms_host.commissioning.network import Commissioning, SilentError
from mdms_host.layout import Layout
from mdms_protocol import cob, indices, lss, nmt, sdo
from mdms_sim.nodes.python_bank import PythonBank

NONE = cob.NODE_NONE
GRID = ("--columns", "3", "--rows", "1")
#: Serial numbers of the bank's cells are 1 to 3, as their node ids; so they stand, along x first.
ORDER = (2, 3, 1)
#: In the table of two rows.
ORDER_6 = (4, 2, 6, 1, 3, 5)

#: Blank cells get ids from the top for as long as they are being placed.
TOP = 126

blank = pytest.mark.parametrize("cells", [(NONE,) * 6], indirect=True)


@pytest.fixture
def cells(request):
    """Cells whose wheels stand, in virtual time; blank ones, or three."""
    node_ids = getattr(request, "param", (1, 2, 3))
    with virtual_time(StandingArray(PythonBank(node_ids), len(node_ids))) as ready:
        yield ready


@pytest.fixture
def commission(cells, tmp_path):
    """Runs the verb; the array file goes to `array.toml` in the test's folder."""

    def run(*arguments, out=True):
        files = ("--out", tmp_path / "array.toml") if out else ()
        return main(["commission", *map(str, (*arguments, *files)), "-i", "virtual"])

    return run


@pytest.fixture
def listed(tmp_path):
    path = tmp_path / "list.txt"
    path.write_text("".join(f"{serial:08X}\n" for serial in ORDER))
    return path


@pytest.fixture
def bus(cells):
    """The cells by another master."""
    with Commissioning(None, MonotonicClock()) as ready:
        yield ready


def neighbours(bus, node_id):
    return [bus.read(node_id, indices.NEIGHBOURS, sub) for sub in range(1, 9)]


def serials(bus, cells=3):
    return [bus.read(node_id, indices.IDENTITY, 4) for node_id in range(1, cells + 1)]


@blank
def test_blank_cells_get_ids_places_and_neighbours_and_keep_them(
    commission, bus, cells, tmp_path, capsys
):
    path = tmp_path / "list.txt"
    path.write_text("".join(f"{serial:08X}\n" for serial in ORDER_6))
    assert commission("--list", path, "--columns", "3", "--rows", "2", "--yes") == Exit.OK
    printed = capsys.readouterr()
    assert printed.out.endswith(
        f"6 cells are commissioned and verified; array file: {tmp_path}/array.toml\n"
    )
    assert "wheels were not nudged" in printed.err
    assert not cells.array.bank.awake.any()
    for node_id in range(1, 7):
        bus.restart(node_id)
    assert serials(bus, 6) == list(ORDER_6)
    assert neighbours(bus, 1) == [2, 5, 4, 0, 0, 0, 0, 0]
    assert [bus.read(6, indices.PLACE, sub) for sub in (1, 2)] == [3, 2]
    file = read_array(tmp_path / "array.toml")
    assert (file.table.columns, file.table.rows) == (3, 2)
    assert [(cell.serial, cell.number) for cell in file.cells] == [
        (serial, number) for number, serial in enumerate(ORDER_6, 1)
    ]


def test_the_file_makes_the_same_array_again_and_asks_nothing(
    commission, listed, bus, tmp_path, capsys
):
    assert commission("--list", listed, *GRID, "--yes") == Exit.OK
    text = (tmp_path / "array.toml").read_text()
    bus.write(3, indices.GAIN, 0, 12_000)
    bus.store(3)
    bus.lss.select(bus_address(bus, 2))
    bus.lss.set_node_id(NONE)
    bus.lss.store()
    bus.lss.leave()
    bus.command(nmt.RESET_NODE, 2)
    with pytest.raises(SilentError):
        bus.read(2, indices.GAIN)
    capsys.readouterr()
    assert commission("--from", tmp_path / "array.toml", "--yes", out=False) == Exit.OK
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "00000003: blank -> node 2"
    assert "00000001: node 3, 1 settings, stored" in lines
    assert serials(bus) == list(ORDER)
    assert bus.read(3, indices.GAIN) == 13_000
    assert commission("--from", tmp_path / "array.toml", "--yes") == Exit.OK
    assert (tmp_path / "array.toml").read_text() == text
    assert array_document(read_array(tmp_path / "array.toml")) == text


def bus_address(bus, node_id):
    from mdms_host.commissioning.node_ids import address_of

    return address_of(bus.identity(node_id))


def answered(monkeypatch, *answers):
    """A terminal at which somebody types these lines."""
    terminal = io.StringIO("".join(f"{answer}\n" for answer in answers))
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)


def test_each_cell_blinks_and_a_key_says_where_it_is(commission, bus, cells, monkeypatch, capsys):
    lit = []
    told = cells.array.bank._boards

    class Terminal(io.StringIO):
        def isatty(self):
            return True

        def readline(self, *_):
            lit.append([cell + 1 for cell, board in enumerate(told) if board.blinking])
            return super().readline()

    # Serial 1 is the third place, and so on; an answer that is none is asked for again.
    answers = ["3", "zebra", "1,1", "", "n", "y"]
    monkeypatch.setattr("sys.stdin", Terminal("".join(f"{each}\n" for each in answers)))
    assert commission(*GRID) == Exit.FAILURE
    assert "nothing was written" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", Terminal("y\nn\n"))
    assert commission(*GRID) == Exit.OK
    assert lit[:4] == [[1], [2], [2], [3]]
    assert serials(bus) == list(ORDER)


def test_what_was_answered_before_an_interruption_is_not_asked_again(
    commission, bus, monkeypatch, capsys
):
    answered(monkeypatch, "3", "q")
    assert commission(*GRID) == Exit.FAILURE
    assert "1 cells have their places; the same command goes on" in capsys.readouterr().err
    answered(monkeypatch, "3", "1", "2", "y", "n")
    assert commission(*GRID) == Exit.OK
    errors = capsys.readouterr().err
    assert "1 cells have their places already" in errors
    assert "00000001 has that place" in errors
    assert serials(bus) == list(ORDER)


@blank
def test_a_plate_that_is_moved_over_the_table_places_all(commission, bus, cells, tmp_path, capsys):
    layout = Layout(3, 2)
    place_of = {serial: place for place, serial in enumerate(ORDER_6)}
    # A hand over a table: along both rows and between them, again until it is over.
    x_m, y_m = layout.cell_positions_m.max(axis=0)
    row = np.linspace(-x_m - 0.05, x_m + 0.05, 800)
    rows = ((-y_m, row), (0.0, row[::-1]), (y_m, row))
    way = [(x, y) for y, along in rows for x in along]
    hand = itertools.cycle([*way, *way[::-1]])

    def move():
        # Who has not begun to watch sees an empty table.
        if bus.states.get(TOP) == nmt.OPERATIONAL:
            away = np.abs(layout.sensor_positions_m - next(hand))
            bits = (away < 0.075).all(axis=2) @ (1 << np.arange(5))
            for serial in ORDER_6:
                cells.array.presence[serial - 1] = bits[place_of[serial]]

    cells.array.hand = move
    done = commission("--plate", "--corner", "00000004", "--yes", "--limit", "30")
    assert done == Exit.OK, capsys.readouterr().err
    assert serials(bus, 6) == list(ORDER_6)
    document = tomllib.loads((tmp_path / "array.toml").read_text())
    assert (document["array"]["columns"], document["array"]["rows"]) == (3, 2)


def test_a_corner_that_lies_elsewhere_shows_that_cells_are_mounted_turned():
    spots = {10: (1, 1), 11: (2, 1)}
    check_corner(None, spots, (2, 1))
    check_corner(10, spots, (2, 1))
    with pytest.raises(CommandError, match="lies at column 2, row 1 of 2 x 1: cells are mounted"):
        check_corner(11, spots, (2, 1))
    with pytest.raises(CommandError, match="0000000C is not on the bus"):
        check_corner(12, spots, (2, 1))


def test_a_plate_that_nobody_moves_ends_with_time(commission, cells, capsys):
    assert commission("--plate", "--yes", "--limit", "0.5") == Exit.TIME_LIMIT
    assert "0 of 3 cells were seen in time" in capsys.readouterr().err
    assert all(board.blinking for board in cells.array.bank._boards)


def test_a_table_that_is_not_empty_is_no_place_to_begin(commission, cells, capsys):
    cells.array.presence[2] = 0b00010
    cells.sleep(0.05)
    assert commission("--plate", "--yes") == Exit.FAILURE
    assert "node 3 sees something already" in capsys.readouterr().err


def test_fewer_and_more_cells_than_places_change_nothing(commission, listed, bus, capsys):
    assert commission("--columns", "4", "--rows", "2", "--list", listed, "--yes") == 5
    assert "3 cells answer, and the table has 8 places" in capsys.readouterr().err
    assert commission("--columns", "2", "--rows", "1", "--list", listed, "--yes") == 5
    assert "3 cells answer, and the table has 2 places only" in capsys.readouterr().err
    assert serials(bus) == [1, 2, 3]


def test_a_file_of_other_cells_names_both_sides(commission, bus, tmp_path, capsys):
    path = tmp_path / "other.toml"
    path.write_text('[[cell]]\nserial = "00000001"\nnode=1\n[[cell]]\nserial = "0A"\nnode=2\n')
    assert commission("--from", path, "--yes", out=False) == Exit.NODE_FAULT
    message = capsys.readouterr().err
    assert "not on the bus: 0000000A" in message
    assert "not listed: 00000002, 00000003" in message
    assert serials(bus) == [1, 2, 3]


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
    assert commission("--list", listed, *GRID, "--yes") == Exit.NODE_FAULT
    message = capsys.readouterr().err
    assert "00000001: node 3" in message
    assert "2 of 3 cells are done, and no file was written" in message
    assert not (tmp_path / "array.toml").exists()
    monkeypatch.undo()
    cells.array.bank.restart(0)
    assert commission("--list", listed, *GRID, "--yes") == Exit.OK
    assert serials(bus) == list(ORDER)


def lss_frame(command):
    return lambda frame: frame.can_id == cob.LSS_REQUEST and frame.data[0] == command


def sdo_frame(kind, index, sub=0):
    place = index.to_bytes(2, "little") + bytes((sub,))
    first = range(cob.SDO_REQUEST_BASE + 1, cob.SDO_REQUEST_BASE + cob.NODE_MAX)

    def is_it(frame):
        same = frame.data[:1] and frame.data[0] & sdo.SPECIFIER == kind
        return frame.can_id in first and bool(same) and frame.data[1:4] == place

    return is_it


GIVE_ID = lss_frame(lss.CONFIGURE_NODE_ID)
STORE_ID = lss_frame(lss.STORE)
LEAVE = lss_frame(lss.SWITCH_GLOBAL)
WRITE_ROW = sdo_frame(sdo.DOWNLOAD, indices.PLACE, 2)
STORE = sdo_frame(sdo.DOWNLOAD, indices.STORE, 1)
READ_BACK = sdo_frame(sdo.UPLOAD, indices.SIGNATURE)
READ_GAIN = sdo_frame(sdo.UPLOAD, indices.GAIN)


def restart(frame):
    return frame.can_id == cob.NMT and frame.data[0] == nmt.RESET_NODE


#: Frames by what they mean, in their order; what comes before the last is cut there.
STAGES = {
    "in the search": [lss_frame(lss.FAST_SCAN)] * 20,
    "in the roll call": [lss_frame(lss.IDENTIFY_SERIAL_HIGH)],
    "before an id is given": [GIVE_ID],
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


@pytest.mark.parametrize("killed", [False, True], ids=["interrupted", "killed"])
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("cells", [(NONE,) * 3], indirect=True)
def test_broken_off_at_any_stage_it_ends_well_the_next_time(
    commission, listed, cells, stage, killed
):
    cut = Cut(cells, STAGES[stage], killed=killed)
    assert commission("--list", listed, *GRID, "--yes") == INTERRUPTED
    assert cut.fired
    cells.mute = False
    assert commission("--list", listed, *GRID, "--yes") == Exit.OK
    with Commissioning(None, MonotonicClock()) as bus:
        for node_id in range(1, 4):
            bus.restart(node_id)
        assert serials(bus) == list(ORDER)
        assert [bus.read(node_id, indices.PLACE, 1) for node_id in range(1, 4)] == [1, 2, 3]


def test_an_answer_that_was_cut_in_two_is_asked_again(commission, cells, tmp_path, monkeypatch):
    path = tmp_path / "row.txt"
    path.write_text("1 2 3")
    assert commission("--list", path, *GRID, "--yes") == Exit.OK
    # The row becomes a column: serial 2 is to go from (2, 1) to (1, 2), and is cut at (1, 1).
    column = ("--columns", "1", "--rows", "3")
    cut = Cut(cells, [STORE, WRITE_ROW])
    answered(monkeypatch, "3", "2")
    assert commission(*column, "--again") == INTERRUPTED
    assert cut.fired
    answered(monkeypatch, "2", "1", "y", "n")
    assert commission(*column) == Exit.OK
    file = read_array(tmp_path / "array.toml")
    assert {cell.serial: cell.number for cell in file.cells} == {1: 3, 2: 2, 3: 1}


def test_two_cells_that_answer_under_one_node_id_both_get_their_own(
    commission, listed, bus, cells, capsys
):
    assert commission("--list", listed, *GRID, "--yes") == Exit.OK
    # On this bus cells do not receive what others send, so that none gives way.
    bus.lss.select(bus_address(bus, 3))
    bus.lss.set_node_id(2)
    bus.lss.store()
    bus.lss.leave()
    cells.array.bank.restart(0)
    cells.sleep(0.2)
    assert bus.find() == [1, 2]
    capsys.readouterr()
    assert commission("--list", listed, *GRID, "--yes") == Exit.OK
    printed = capsys.readouterr()
    assert " has node id 2, as another cell has" in printed.err
    assert "00000001: node 2 -> node 3" in printed.out
    assert serials(bus) == list(ORDER)


def test_a_serial_number_that_is_there_twice_is_refused(
    commission, listed, cells, monkeypatch, capsys
):
    bank = cells.array.bank
    usual = bank._board

    def of_the_same_lot(cell):
        board = usual(cell)
        board.serial = 1
        return board

    monkeypatch.setattr(bank, "_board", of_the_same_lot)
    bank.restart(1)
    cells.sleep(0.2)
    assert commission("--list", listed, *GRID, "--yes") == Exit.NODE_FAULT
    assert "have the same serial number 00000001" in capsys.readouterr().err


def test_cells_that_a_run_has_are_left_alone(commission, cells, listed, bus, capsys):
    assert commission("--list", listed, *GRID, "--yes") == Exit.OK
    bus.command(nmt.START, 3)
    cells.sleep(0.2)
    assert commission("--list", listed, *GRID, "--yes") == Exit.NODE_FAULT
    assert "node 3 is operational; turn it off first: mdms stop" in capsys.readouterr().err


def test_without_a_terminal_somebody_has_to_say_how(commission, listed, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert commission(*GRID) == Exit.USAGE
    assert commission("--list", listed) == Exit.USAGE
    assert "--columns and --rows" in capsys.readouterr().err
    assert commission("--list", listed, *GRID) == Exit.USAGE
    assert "say --yes" in capsys.readouterr().err


def test_the_result_as_json(commission, listed, tmp_path, capsys):
    assert commission("--list", listed, *GRID, "--yes", "--json") == Exit.OK
    document = json.loads(capsys.readouterr().out)
    assert document["file"] == str(tmp_path / "array.toml")
    assert [cell["node"] for cell in document["cells"]] == [1, 2, 3]
    assert all(cell["stored"] for cell in document["cells"])
