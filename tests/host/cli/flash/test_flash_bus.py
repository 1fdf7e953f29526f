"""`mdms flash --bus` and the key of `mdms commission`, on firmware cells in virtual time."""

import errno
import json
import os
from contextlib import contextmanager

import pytest
from tests.virtual_array import StandingArray, virtual_time

from mdms_host.cli import main
from mdms_host.cli.exits import INTERRUPTED, ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.network import Commissioning
from mdms_host.flashing.bundles import key_id, make_key, read_key, sign
from mdms_host.flashing.cell_update import CellUpdate
from mdms_host.flashing.updater import Updater
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo, update
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.version import VERSION
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.nodes.virtual_board import VirtualBoard

PACKED = b"\x00\x20\x00\x00" + bytes([number * 13 & 0xFF for number in range(2000)])
OTHER = b"\x00\x10\x00\x00" + bytes([number * 17 & 0xFF for number in range(1500)])


@pytest.fixture
def cells():
    """Three cells whose wheels stand, in virtual time."""
    with virtual_time(StandingArray(PythonBank((1, 2, 3)), 3)) as ready:
        yield ready


@pytest.fixture
def firmware(monkeypatch):
    """Sets the compiled firmware for the cells; the running code of cells stays the same."""

    def use(packed):
        monkeypatch.setattr("mdms_host.flashing.bundles.packed_firmware", lambda bytecode: packed)

    use(PACKED)
    return use


@pytest.fixture
def flash(cells, tmp_path, firmware, capsys):
    """Runs the verb in a folder with an array's key; exit code, JSON, and messages."""
    make_key(tmp_path / "array.key")

    def run(*arguments, key=tmp_path / "array.key"):
        bus = ("-i", "virtual", "--json", "--key", str(key))
        code = main(["flash", "--bus", *map(str, arguments), *bus])
        printed = capsys.readouterr()
        return code, json.loads(printed.out or "{}"), printed.err

    return run


@pytest.fixture
def commissioned(tmp_path, flash, capsys):
    """Runs `mdms commission` with the array's key."""
    listed = tmp_path / "list.txt"
    listed.write_text("00000001\n00000002\n00000003\n")

    def run(key=tmp_path / "array.key"):
        arguments = ["--list", listed, "--columns", 3, "--rows", 1, "--yes", "--force"]
        arguments += ["--out", tmp_path / "array.toml", "--key", key]
        code = main(["commission", *map(str, arguments), "-i", "virtual"])
        printed = capsys.readouterr()
        return code, printed.out + printed.err

    return run


def test_cells_get_the_key_and_then_firmware(commissioned, flash, firmware, tmp_path, capsys):
    code, printed = commissioned()
    assert code == ExitCode.OK
    assert printed.count("has the update key") == 3
    code, told, _ = flash("--save", tmp_path / "first.mdmb")
    assert code == ExitCode.OK
    assert [(row["node"], row["updated"], row["problem"]) for row in told["cells"]] == [
        (node, True, None) for node in (1, 2, 3)
    ]
    assert told["frames"] > 3 * len(PACKED) / 7
    assert told["restarted"] == 0
    # The same again is nothing to do, and a used bundle is refused.
    code, told, _ = flash()
    assert (code, told["frames"]) == (ExitCode.OK, 0)
    firmware(OTHER)
    assert flash()[0] == ExitCode.OK
    code, told, said = flash("--bundle", tmp_path / "first.mdmb")
    assert code == ExitCode.NODE_FAULT
    assert "has been used before" in said
    assert not any(row["updated"] for row in told["cells"])
    # Signed anew it may come back, though it were older.
    code, told, _ = flash("--bundle", tmp_path / "first.mdmb", "--allow-older")
    assert (code, told["cells"][0]["updated"]) == (ExitCode.OK, True)
    code, told, _ = flash("--list")
    assert {row["counter"] for row in told["cells"]} == {3}


def test_only_a_table_that_is_commissioned_gets_a_new_key(commissioned, tmp_path):
    new = tmp_path / "new.key"
    listed = tmp_path / "list.txt"
    right = listed.read_text()
    for wrong in ("no number\n", right.replace("3", "4")):
        listed.write_text(wrong)
        assert commissioned(key=new)[0] == ExitCode.USAGE
        assert not new.exists()
    listed.write_text(right)
    code, printed = commissioned(key=new)
    assert code == ExitCode.OK
    assert f"{new} is the array's new key" in printed
    assert printed.count(f"has the update key {key_id(read_key(new)).hex()}") == 3


def test_a_cell_that_was_left_on_trial_does_not_count_as_done(commissioned, flash, cells):
    commissioned()

    def end_before_a_confirmation(frame):
        wanted = sdo.write_request(indices.PROGRAM_CONTROL, 1, bytes((update.CONFIRM,)))
        if frame.can_id == cob.SDO_REQUEST_BASE + 2 and frame.data == wanted:
            raise KeyboardInterrupt

    cells.before_send = end_before_a_confirmation
    assert flash("--node", 2)[0] == INTERRUPTED
    cells.before_send = lambda _frame: None
    code, told, _ = flash("--list")
    assert [row["on_trial"] for row in told["cells"]] == [False, True, False]
    # It would be back at the firmware before within a minute.
    code, told, said = flash()
    assert code == ExitCode.NODE_FAULT
    assert "node 2: other firmware is on trial; it ends within a minute" in said
    assert [row["updated"] for row in told["cells"]] == [True, False, True]
    cells.sleep(61)
    code, told, _ = flash()
    assert (code, told["cells"][1]["updated"]) == (ExitCode.OK, True)
    assert {row["on_trial"] for row in flash("--list")[1]["cells"]} == {False}


@pytest.mark.parametrize("command", ["scan", "doctor", "configure show", "flash --bus --list"])
def test_no_other_verb_breaks_an_update_off(commissioned, cells, capsys, tmp_path, command):
    assert commissioned()[0] == ExitCode.OK
    packed = PACKED + bytes(20_000)
    bundle = sign(packed, read_key(tmp_path / "array.key"), 1, VirtualBoard.bytecode)
    updater = Updater([CellUpdate(node_id, bundle) for node_id in (1, 2, 3)], 1_000_000)
    send = cells.array.attach(updater.on_frame)

    def go_on():
        if not updater.over and updater.wake_s <= cells.now_s():
            for frame in updater.poll(cells.now_s()):
                send(frame)

    cells.array.hand = go_on
    cells.sleep(0.1)
    assert main([*command.split(), "-i", "virtual"]) == ExitCode.NODE_FAULT
    assert "firmware comes into cells over the bus" in capsys.readouterr().err
    cells.wait(60, lambda: updater.over)
    assert [(each.finished, each.restarts) for each in updater.updates] == [(True, 0)] * 3


def test_a_cell_of_the_array_file_that_is_not_there_is_named(commissioned, flash, tmp_path):
    assert commissioned()[0] == ExitCode.OK
    file = tmp_path / "array.toml"
    text = file.read_text().replace("columns = 3", "columns = 4")
    last = text[text.rindex("[[cell]]") :]
    file.write_text(f"{text}\n{last.replace('= 3', '= 4').replace('00000003', '00000004')}")
    code, told, said = flash("--array", file)
    assert code == ExitCode.NODE_FAULT
    assert [row["updated"] for row in told["cells"]] == [True, True, True]
    assert [row["node_ids"] for row in told["missing"]] == [[4]]
    assert "node 4" in said
    # Of the cells that are named, none is missing.
    assert flash("--array", file, "--node", "1")[0] == ExitCode.OK


def test_a_cell_that_gives_no_answer_keeps_no_other_from_its_firmware(commissioned, flash, cells):
    assert commissioned()[0] == ExitCode.OK
    attach = cells.array.attach

    def deaf(deliver):
        send = attach(deliver)
        return lambda frame: frame.can_id == cob.SDO_REQUEST_BASE + 2 or send(frame)

    cells.array.attach = deaf
    code, told, said = flash()
    assert code == ExitCode.NODE_FAULT
    assert [row["updated"] for row in told["cells"]] == [True, False, True]
    assert "mdms: node 2: 0x1008:0 Manufacturer device name: No SDO response" in said


def test_cells_without_the_key_or_with_another_refuse(commissioned, flash, tmp_path):
    code, _, said = flash()
    assert code == ExitCode.NODE_FAULT
    assert "node 1: it has no update key" in said
    assert commissioned()[0] == ExitCode.OK
    other = tmp_path / "other.key"
    make_key(other)
    code, _, said = flash(key=other)
    assert code == ExitCode.NODE_FAULT
    assert "another array's key" in said
    code, printed = commissioned(key=other)
    assert code == ExitCode.NODE_FAULT
    assert "mpremote fs rm :update.key" in printed


def test_key_that_is_not_there_is_made_by_commissioning_alone(commissioned, flash, tmp_path):
    code, _, said = flash(key=tmp_path / "new.key")
    assert (code, "new.key: there is no such key file" in said) == (ExitCode.USAGE, True)
    code, printed = commissioned(key=tmp_path / "new.key")
    assert code == ExitCode.OK
    assert "out of version control" in printed
    assert len(read_key(tmp_path / "new.key")) == update.KEY_SIZE
    assert flash(key=tmp_path / "new.key")[0] == ExitCode.OK


def test_board_without_room_is_refused_by_name(flash, monkeypatch):
    monkeypatch.setattr(VirtualBoard, "number", update.PYBV11)
    monkeypatch.setattr(VirtualBoard, "slots_room", lambda self: 0)
    with Commissioning(None, MonotonicClock()) as bus:
        for node in (1, 2, 3):
            bus.write(node, 0x1F51, 1, update.RESET)
    code, told, said = flash()
    assert code == ExitCode.NODE_FAULT
    assert "PYBv1.1 has no room for a second firmware beside the first; USB it is" in said
    assert told["frames"] == 0


def test_cells_that_may_drive_are_left_alone(flash):
    with Commissioning(None, MonotonicClock()) as bus:
        bus.command(nmt.START, 2)
    # Nor is another updated meanwhile, for that takes all of the bus.
    for which in ((), ("--node", 1)):
        code, _, said = flash(*which)
        assert code == ExitCode.NODE_FAULT
        assert "node 2 is operational; turn it off first: mdms stop" in said
    assert flash("--list")[0] == ExitCode.OK


def test_run_or_update_that_begins_while_firmware_is_compiled_is_left_alone(
    commissioned, flash, cells, monkeypatch
):
    assert commissioned()[0] == ExitCode.OK
    send = cells.array.attach(lambda _frame, _now_s: None)

    def compile_until(frame):
        def compiled(_bytecode):
            send(frame)
            cells.sleep(1.0)
            return PACKED

        monkeypatch.setattr("mdms_host.flashing.bundles.packed_firmware", compiled)

    block = bytes((sdo.BLOCK_DOWNLOAD_RESPONSE | sdo.BLOCK_ACKNOWLEDGE, 63, 63, *bytes(5)))
    for begun, words in (
        (Frame(cob.SDO_RESPONSE_BASE + 3, block), "firmware comes into cells over the bus"),
        (nmt.command(nmt.START, nmt.ALL_NODES), "turn them off first: mdms stop"),
    ):
        compile_until(begun)
        code, _, said = flash("--node", 2)
        assert (code, words in said) == (ExitCode.NODE_FAULT, True)
    assert [row["counter"] for row in flash("--list")[1]["cells"]] == [0] * 3


def test_file_that_is_no_bundle_or_not_whole_is_refused(flash, tmp_path):
    path = tmp_path / "bundle.mdmb"
    path.write_bytes(b"#!/bin/sh\n")
    code, _, said = flash("--bundle", path)
    assert (code, "not a bundle" in said) == (ExitCode.USAGE, True)
    whole = sign(PACKED, bytes(32), 1, VirtualBoard.bytecode).data
    path.write_bytes(whole[:-1])
    code, _, said = flash("--bundle", path)
    assert (code, "not whole" in said) == (ExitCode.USAGE, True)


def test_each_bar_is_seen_to_go_to_its_end(commissioned, flash, monkeypatch):
    shares = {}

    @contextmanager
    def bars(names):
        shares.update(dict.fromkeys(names, 0.0))
        yield lambda name, share: shares.update({name: max(share, shares[name])})

    monkeypatch.setattr("mdms_host.cli.cells.flash_bus.bars", bars)
    commissioned()
    assert flash()[0] == ExitCode.OK
    assert shares == {"node 1": 1.0, "node 2": 1.0, "node 3": 1.0}


def test_bundle_is_saved_over_no_other_file_and_whole_or_not_at_all(
    flash, firmware, tmp_path, monkeypatch
):
    other = tmp_path / "array.toml"
    other.write_text("[array]\n")
    code, told, said = flash("--save", other)
    assert (code, told) == (ExitCode.USAGE, {})
    assert "array.toml: is there already, and was not written by this verb" in said
    assert other.read_text() == "[array]\n"
    path = tmp_path / "bundle.mdmb"
    assert flash("--dry-run", "--save", path)[0] == ExitCode.OK
    before = path.read_bytes()
    firmware(OTHER)

    def full(self, data):
        with self.open("wb") as file:
            file.write(data[:100])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.write_bytes", full)
        code, _, said = flash("--dry-run", "--save", path)
    assert (code, "bundle.mdmb: cannot be written: No space left" in said) == (
        ExitCode.FAILURE,
        True,
    )
    assert path.read_bytes() == before
    assert flash("--dry-run", "--save", path)[0] == ExitCode.OK
    assert path.read_bytes() != before


def test_dry_run_sends_nothing(flash):
    code, told, _ = flash("--dry-run")
    assert (code, told["frames"]) == (ExitCode.OK, 0)
    assert {row["wanted"] for row in told["cells"]} == {VERSION}


def test_options_of_the_bus_go_with_it(capsys):
    assert main(["flash", "--key", "array.key"]) == ExitCode.USAGE
    assert "--key goes with --bus" in capsys.readouterr().err
