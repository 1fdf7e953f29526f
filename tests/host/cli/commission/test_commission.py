"""`mdms commission` on a bus of firmware cells, whatever state it finds them in."""

import io
import json
from types import SimpleNamespace

import pytest
from tests.host.cli.commission.on_the_table import GRID, NONE, ORDER, ORDER_6, blank, serials
from tests.virtual_array import OtherHost

from mdms_host.cli.exits import ExitCode
from mdms_host.commissioning.array_file import array_document, read_array
from mdms_host.commissioning.network import SilentError
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt


def neighbours(bus, node_id):
    return [bus.read(node_id, indices.NEIGHBOURS, sub) for sub in range(1, 9)]


@blank
def test_blank_cells_get_ids_places_and_neighbours_and_keep_them(
    commission, bus, cells, tmp_path, capsys
):
    path = tmp_path / "list.txt"
    path.write_text("".join(f"{serial:08X}\n" for serial in ORDER_6))
    assert commission("--list", path, "--columns", "3", "--rows", "2", "--yes") == ExitCode.OK
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


def test_a_memory_that_fails_is_no_board_without_one(  # noqa: PLR0917
    commission, cells, bus, tmp_path, monkeypatch, capsys
):
    path = tmp_path / "list.txt"
    path.write_text("1 2 3")
    first, second, _ = cells.array.bank._cells
    monkeypatch.setattr(first._store, "_memory", None)
    flash = second._store._memory

    def fail(_bank, _offset, _data):
        raise OSError("flash failed")

    with monkeypatch.context() as patch:
        patch.setattr(flash, "write", fail)
        assert commission("--list", path, *GRID, "--yes") == ExitCode.NODE_FAULT
    printed = capsys.readouterr()
    assert "node 1, 5 settings, not stored: its board has no memory" in printed.out
    assert "00000002: node 2, 0x1010:1" in printed.err
    assert "hardware error" in printed.err
    assert "2 of 3 cells are done, and no file was written" in printed.err
    assert not (tmp_path / "array.toml").exists()
    assert commission("--list", path, *GRID, "--yes") == ExitCode.OK
    bus.restart(2)
    assert [bus.read(2, indices.PLACE, sub) for sub in (1, 2)] == [2, 1]


def test_settings_that_a_restart_does_not_keep_are_no_success(
    commission, cells, tmp_path, monkeypatch, capsys
):
    path = tmp_path / "list.txt"
    path.write_text("1 2 3")
    store = cells.array.bank._cells[1]._store
    monkeypatch.setattr(store, "restore", lambda _objects, _flags: [])
    assert commission("--list", path, *GRID, "--yes") == ExitCode.NODE_FAULT
    assert "00000002: node 2 has other settings after a restart" in capsys.readouterr().err


def test_the_file_makes_the_same_array_again_and_asks_nothing(
    commission, listed, bus, tmp_path, capsys
):
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
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
    assert commission("--from", tmp_path / "array.toml", "--yes", out=False) == ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "00000003: blank -> node 2"
    assert "00000001: node 3, 1 setting, stored" in lines
    assert serials(bus) == list(ORDER)
    assert bus.read(3, indices.GAIN) == 13_000
    assert commission("--from", tmp_path / "array.toml", "--yes") == ExitCode.OK
    assert (tmp_path / "array.toml").read_text() == text
    assert array_document(read_array(tmp_path / "array.toml")) == text


def bus_address(bus, node_id):
    from mdms_host.commissioning.node_ids import address_of

    return address_of(bus.identity(node_id))


def test_fewer_and_more_cells_than_places_change_nothing(commission, listed, bus, capsys):
    assert commission("--columns", "4", "--rows", "2", "--list", listed, "--yes") == 5
    assert "3 cells answer, and the table has 8 places" in capsys.readouterr().err
    assert commission("--columns", "2", "--rows", "1", "--list", listed, "--yes") == 5
    assert "3 cells answer, and the table has 2 places only" in capsys.readouterr().err
    assert serials(bus) == [1, 2, 3]


def test_a_file_that_cannot_be_made_is_told_before_anything_is_written(
    commission, listed, bus, tmp_path, capsys
):
    out = tmp_path / "none" / "array.toml"
    assert commission("--list", listed, *GRID, "--yes", "--out", out, out=False) == ExitCode.USAGE
    assert f"{out}: cannot be written: No such file or directory" in capsys.readouterr().err
    assert serials(bus) == [1, 2, 3]


def test_a_file_of_other_cells_names_both_sides(commission, bus, tmp_path, capsys):
    path = tmp_path / "other.toml"
    path.write_text('[[cell]]\nserial = "00000001"\nnode=1\n[[cell]]\nserial = "0A"\nnode=2\n')
    assert commission("--from", path, "--yes", out=False) == ExitCode.NODE_FAULT
    message = capsys.readouterr().err
    assert "not on the bus: 0000000A" in message
    assert "not listed: 00000002, 00000003" in message
    assert serials(bus) == [1, 2, 3]


def test_two_cells_that_answer_under_one_node_id_both_get_their_own(
    commission, listed, bus, cells, capsys
):
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
    # On this bus cells do not receive what others send, so that none gives way.
    bus.lss.select(bus_address(bus, 3))
    bus.lss.set_node_id(2)
    bus.lss.store()
    bus.lss.leave()
    cells.array.bank.restart(0)
    cells.sleep(0.2)
    assert bus.find() == [1, 2]
    capsys.readouterr()
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
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
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.NODE_FAULT
    assert "have the same serial number 00000001" in capsys.readouterr().err


def test_cells_that_a_run_has_are_left_alone(commission, cells, listed, bus, capsys):
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.OK
    bus.command(nmt.START, 3)
    cells.sleep(0.2)
    assert commission("--list", listed, *GRID, "--yes") == ExitCode.NODE_FAULT
    assert "node 3 is operational; turn it off first: mdms stop" in capsys.readouterr().err


@pytest.mark.parametrize("answered", [4, 5], ids=["before the ids", "before the settings"])
def test_a_run_that_began_while_a_person_was_asked_is_left_alone(
    commission, cells, monkeypatch, capsys, answered
):
    answers = ["", "", "", "", "y", "n"]
    commands = []

    def answer() -> str:
        if len(answers) == 6 - answered:
            OtherHost(cells.array).run()
            cells.sleep(0.2)
            cells.before_send = lambda frame: commands.extend([frame] * (frame.can_id == cob.NMT))
        return answers.pop(0) + "\n"

    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True, readline=answer))
    assert commission(*GRID) == ExitCode.NODE_FAULT
    assert "another host runs the array" in capsys.readouterr().err
    assert commands == []


def test_without_a_terminal_somebody_has_to_say_how(commission, listed, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    assert commission(*GRID) == ExitCode.USAGE
    assert commission("--list", listed) == ExitCode.USAGE
    assert "--columns and --rows" in capsys.readouterr().err
    assert commission("--list", listed, *GRID) == ExitCode.USAGE
    assert "say --yes" in capsys.readouterr().err


def test_the_result_as_json(commission, listed, tmp_path, capsys):
    assert commission("--list", listed, *GRID, "--yes", "--json") == ExitCode.OK
    document = json.loads(capsys.readouterr().out)
    assert document["file"] == str(tmp_path / "array.toml")
    assert [cell["node"] for cell in document["cells"]] == [1, 2, 3]
    assert all(cell["stored"] for cell in document["cells"])
