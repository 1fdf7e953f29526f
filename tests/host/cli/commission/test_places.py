"""Where cells are, as a person or a plate says it to `mdms commission`."""

import io
import itertools
import tomllib

import numpy as np
import pytest
from tests.host.cli.commission.on_the_table import GRID, ORDER, ORDER_6, answered, blank, serials
from tests.virtual_array import OtherHost

from mdms_host.cli.cells.plate import check_corner
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.layout import Layout
from mdms_protocol import indices
from mdms_protocol.codecs import nmt

#: Blank cells get ids from the top for as long as they are being placed.
TOP = 126


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
    answers = ["3", "zebra", "1,1", "", "", "", "n", "y"]
    monkeypatch.setattr("sys.stdin", Terminal("".join(f"{each}\n" for each in answers)))
    assert commission(*GRID) == ExitCode.FAILURE
    said = capsys.readouterr().err
    assert "nothing was written" in said
    assert "Cell 2 of 3, 00000002, blinks." in said
    assert "00000001 is at place 3, column 3 and row 1: 1 of 3" in said
    assert "answer y or n" in said, "Enter alone has ended it"
    monkeypatch.setattr("sys.stdin", Terminal("y\nn\n"))
    assert commission(*GRID) == ExitCode.OK
    assert lit[:4] == [[1], [2], [2], [3]]
    assert serials(bus) == list(ORDER)


def test_answers_before_an_interruption_are_not_asked_again(commission, bus, monkeypatch, capsys):
    answered(monkeypatch, "3", "q")
    assert commission(*GRID) == ExitCode.FAILURE
    assert "1 cell has its place; the same command goes on" in capsys.readouterr().err
    answered(monkeypatch, "3", "1", "2", "", "y", "n")
    assert commission(*GRID) == ExitCode.OK
    errors = capsys.readouterr().err
    assert "1 cell has its place already" in errors
    assert "00000001 has that place" in errors
    assert serials(bus) == list(ORDER)


def test_answers_are_undone_one_after_the_other(commission, bus, monkeypatch, capsys):
    # The first is wrong, and is noticed after the second; then the last.
    answered(monkeypatch, "u", "1", "2", "u", "u", "3", "1", "", "u", "2", "", "y", "n")
    assert commission(*GRID) == ExitCode.OK
    said = capsys.readouterr().err
    assert "there is no answer to undo" in said
    assert said.count("has no place any more") == 3
    assert serials(bus) == list(ORDER)


def test_place_that_was_undone_is_not_kept(commission, bus, monkeypatch):
    answered(monkeypatch, "3", "u", "q")
    assert commission(*GRID) == ExitCode.FAILURE
    assert [bus.read(node_id, indices.PLACE, 1) for node_id in (1, 2, 3)] == [0, 0, 0]


def moved_plate(bus, cells):
    """A hand that moves a plate over a table of two rows while somebody watches."""
    layout = Layout(3, 2)
    place_of = {serial: place for place, serial in enumerate(ORDER_6)}
    # A hand over a table: along both rows and between them, again until it is over.
    x_m, y_m = layout.cell_positions_m.max(axis=0)
    row = np.linspace(-x_m - 0.05, x_m + 0.05, 800)
    rows = ((-y_m, row), (0.0, row[::-1]), (y_m, row))
    way = [(x, y) for y, along in rows for x in along]
    hand = itertools.cycle([*way, *way[::-1]])

    def move():
        # A watcher that has not begun to watch sees an empty table.
        if bus.states.get(TOP) == nmt.OPERATIONAL:
            away = np.abs(layout.sensor_positions_m - next(hand))
            bits = (away < 0.075).all(axis=2) @ (1 << np.arange(5))
            for serial in ORDER_6:
                cells.array.presence[serial - 1] = bits[place_of[serial]]

    return move


@blank
def test_a_plate_that_is_moved_over_the_table_places_all(commission, bus, cells, tmp_path, capsys):
    cells.array.hand = moved_plate(bus, cells)
    done = commission("--plate", "--corner", "00000004", "--yes", "--limit", "30")
    assert done == ExitCode.OK, capsys.readouterr().err
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


@blank
@pytest.mark.parametrize("event", ["restart", "stop", "run"])
def test_a_cell_that_restarts_is_seen_and_a_stop_is_heeded_amid_a_plate(
    commission, bus, cells, capsys, event
):
    move, other, moves = moved_plate(bus, cells), OtherHost(cells.array), itertools.count()

    def hand():
        move()
        if bus.states.get(TOP) == nmt.OPERATIONAL and next(moves) == 500:
            cells.array.bank.restart(2) if event == "restart" else other.stop()
            if event == "run":
                other.start()

    cells.array.hand = hand
    done = commission("--plate", "--yes", "--limit", "60")
    told = capsys.readouterr().err
    assert done == (ExitCode.OK if event == "restart" else ExitCode.NODE_FAULT), told
    assert ("another host has sent" in told) == (event != "restart")
    states = {cell.state for cell in cells.array.bank._cells}
    assert states == {nmt.OPERATIONAL if event == "run" else nmt.PRE_OPERATIONAL}


def test_a_plate_that_nobody_moves_ends_with_time(commission, cells, capsys):
    assert commission("--plate", "--yes", "--limit", "0.5") == ExitCode.TIME_LIMIT
    assert "0 of 3 cells were seen in time" in capsys.readouterr().err
    assert all(board.blinking for board in cells.array.bank._boards)


def test_a_table_that_is_not_empty_is_no_place_to_begin(commission, cells, capsys):
    cells.array.presence[2] = 0b00010
    cells.sleep(0.05)
    assert commission("--plate", "--yes") == ExitCode.FAILURE
    assert "node 3 sees something already" in capsys.readouterr().err


def tell(cells, *codes):
    """Jumpers at the places of cells, by their numbers from 1."""
    for cell, code in enumerate(codes):
        cells.array.bank.set_place(cell, code)


def codes_of(order):
    """The code of the place of each cell, by serial number."""
    return [order.index(serial) + 1 for serial in sorted(order)]


@blank
def test_place_codes_place_blank_cells_and_ask_nobody(commission, bus, cells, tmp_path):
    tell(cells, *codes_of(ORDER_6))
    assert commission("--codes", "--columns", "3", "--rows", "2", "--yes") == ExitCode.OK
    assert serials(bus, 6) == list(ORDER_6)
    assert [bus.read(6, indices.PLACE, sub) for sub in (1, 2)] == [3, 2]
    document = tomllib.loads((tmp_path / "array.toml").read_text())
    assert (document["array"]["columns"], document["array"]["rows"]) == (3, 2)
    for node_id in range(1, 7):
        bus.command(nmt.START, node_id)
    cells.sleep(0.05)
    assert [cell.state for cell in cells.array.bank._cells] == [nmt.OPERATIONAL] * 6
    assert not cells.array.bank.awake.any()


def test_place_codes_mend_a_table_whose_cells_were_exchanged(commission, bus, cells):
    tell(cells, *codes_of(ORDER))
    for _ in range(2):
        assert commission("--codes", *GRID, "--yes", "--force") == ExitCode.OK
        assert serials(bus) == list(ORDER)


def test_a_table_that_is_not_to_be_touched_keeps_its_node_ids(commission, bus, cells, monkeypatch):
    tell(cells, *codes_of(ORDER))
    answered(monkeypatch, "n")
    assert commission("--codes", *GRID) == ExitCode.FAILURE
    answered(monkeypatch, "y", "n")
    assert commission("--codes", *GRID) == ExitCode.FAILURE
    for node_id in (1, 2, 3):
        bus.restart(node_id)
    assert serials(bus) == [1, 2, 3]


@pytest.mark.parametrize(
    ("codes", "message"),
    [
        ((0, 0, 0), "no place code at 00000001, 00000002, 00000003: wire the jumpers"),
        ((2, 0, 1), "no place code at 00000002: wire the jumpers of its place"),
        ((2, 3, 2), "the numbers 1 to 3, each once, but 00000001 has 2, 00000003 has 2: look at"),
        ((2, 3, 255), "but 00000003 has 255: look at the jumpers of these places (255: one is"),
    ],
)
def test_codes_that_are_missing_or_wrong_are_named(commission, cells, capsys, codes, message):
    tell(cells, *codes)
    assert commission("--codes", *GRID, "--yes") == ExitCode.NODE_FAULT
    assert message in capsys.readouterr().err
    cells.sleep(0.05)
    states = [(cell.node_id, cell.state) for cell in cells.array.bank._cells]
    assert states == [(node_id, nmt.PRE_OPERATIONAL) for node_id in (1, 2, 3)]


def test_a_plate_is_refused_on_a_table_with_codes(commission, cells, capsys):
    tell(cells, *codes_of(ORDER))
    assert commission("--plate", "--yes", "--limit", "5") == ExitCode.FAILURE
    assert "the table has place codes" in capsys.readouterr().err
