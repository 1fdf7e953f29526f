"""`mdms flash` onto boards with a ROMFS, with frozen firmware, and with too little memory."""

import json

import pytest
from tests.system.flashing.small_firmware import (
    KEPT,
    NEW,
    OLD,
    STALE,
    cut_off,
    files_of,
    firmware_on,
    flash,
    imported_from,
    traffic_of,
)
from tests.system.flashing.unix_board import ROM_SIZE, boards_in

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.flashing import board_survey
from mdms_host.flashing.board_link import BoardLink
from mdms_host.flashing.board_survey import identify
from mdms_host.flashing.firmware import START, rom_image
from mdms_host.flashing.flashing import COPIES_HEAP
from mdms_protocol.version import VERSION

pytestmark = pytest.mark.xdist_group("flash_ways")

OLD_ROM, NEW_ROM = OLD.in_rom(), NEW.in_rom()
STALE_FILE = {"mdms_gone.mpy": b"M\x06"}
SMALL_HEAP = COPIES_HEAP - 4096
OTHER = "9.9.9"


def command(board, *more):
    return main(["flash", "--board", "pybv11", "--port", board.port, *more])


# ROMFS


def test_real_firmware_goes_into_the_romfs_and_runs_from_it(plug_in, copies, capsys):
    board = plug_in({**OLD.files, **STALE, **KEPT}, rom=b"")
    assert command(board) == ExitCode.OK
    assert "1 file and a ROMFS image" in capsys.readouterr().out
    wanted = copies.in_rom()
    assert board.rom.startswith(wanted.rom)
    assert firmware_on(board) == {START: copies.files[START]}
    assert imported_from(board, "mdms_cell.cell") == "/rom/mdms_cell/cell.mpy"
    assert command(board) == ExitCode.OK
    assert f"has {VERSION} already" in capsys.readouterr().out


def test_running_cell_is_stopped_and_runs_the_new_image(plug_in):
    board = plug_in({**OLD_ROM.files, **KEPT}, rom=OLD_ROM.rom)
    board.wait_for("motors", "on old")
    plan = flash(board, NEW_ROM)
    assert plan.rom == NEW_ROM.rom
    assert plan.written == (START,)
    board.wait_for("motors", "on new")
    assert files_of(board)["settings0.bin"] == KEPT["settings0.bin"]
    assert flash(board, NEW_ROM).rom is None


@pytest.fixture(scope="module")
def traffic_bytes(tmp_path_factory):
    """How many bytes a board receives while its ROMFS is flashed."""
    with boards_in(tmp_path_factory.mktemp("boards")) as plug_in:
        files = {**OLD_ROM.files, **STALE_FILE}
        return traffic_of(plug_in(files, rom=OLD_ROM.rom), NEW_ROM)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.35, 0.5, 0.6, 0.7, 0.8, 0.97])
def test_power_may_fail_at_any_moment(plug_in, traffic_bytes, share):
    board = plug_in({**OLD_ROM.files, **STALE_FILE, **KEPT}, rom=OLD_ROM.rom)
    board.wait_for("motors", "on old")
    board.fuse_bytes = int(share * traffic_bytes)
    cut_off(board, NEW_ROM)
    (board.flash / "motors").unlink()
    left = firmware_on(board)
    if START in left:
        old = left == OLD_ROM.files | STALE_FILE and board.rom.startswith(OLD_ROM.rom)
        assert old or (left == NEW_ROM.files and board.rom.startswith(NEW_ROM.rom))
    board.fuse_bytes = None
    board.plug_in()
    flash(board, NEW_ROM)
    board.wait_for("motors", "on new")
    assert firmware_on(board) == NEW_ROM.files
    assert board.rom.startswith(NEW_ROM.rom)


@pytest.mark.parametrize("cut", [b"boards", b"cell.mpy", b"mdms_protocol"])
def test_image_that_was_cut_while_it_was_written_is_written_anew(plug_in, copies, cut):
    wanted = copies.in_rom().rom
    # Erased flash is all ones.
    board = plug_in({}, rom=wanted[: wanted.index(cut) + 3])
    assert command(board) == ExitCode.OK
    assert board.rom.startswith(wanted)


def test_romfs_with_anything_else_in_it_is_left_alone(plug_in, copies):
    rom = rom_image({"app.py": b"", "mdms_cell/__init__.py": b""})
    board = plug_in({}, rom=rom)
    assert command(board) == ExitCode.OK
    assert board.rom.startswith(rom)
    assert firmware_on(board) == copies.files


# Frozen


@pytest.fixture
def freeze(tmp_path, monkeypatch):
    """Lets boards have firmware of a version frozen in: a folder stands for built-in modules."""

    def freeze(version):
        folder = tmp_path / "frozen" / "mdms_protocol"
        folder.mkdir(parents=True)
        (folder / "version.py").write_text(f"VERSION = {version!r}\n")
        monkeypatch.setattr(board_survey, "FROZEN", str(folder.parent))

    return freeze


def test_a_module_in_the_file_system_does_not_pass_for_frozen(plug_in):
    board = plug_in(NEW.files)
    with BoardLink(board.port, MonotonicClock()) as link:
        assert identify(link).frozen is None
        # The port has modules of MicroPython's own frozen in.
        link.run(f"sys.path[:] = [{board_survey.FROZEN!r}]; import argparse")


def test_board_with_the_same_firmware_frozen_in_gets_main_alone(plug_in, freeze, capsys):
    freeze(VERSION)
    board = plug_in({**OLD.files, **STALE, **KEPT}, heap_bytes=SMALL_HEAP)
    assert command(board) == ExitCode.OK
    assert "1 file," in capsys.readouterr().out
    assert firmware_on(board).keys() == {START}
    assert files_of(board)["settings0.bin"] == KEPT["settings0.bin"]
    assert command(board, "--json") == ExitCode.OK
    (row,) = json.loads(capsys.readouterr().out)["boards"]
    assert (row["frozen"], row["written"]) == (VERSION, [])


def test_board_with_other_firmware_frozen_in_is_left_as_it_is(plug_in, freeze, capsys):
    freeze(OTHER)
    board = plug_in(OLD.files)
    assert command(board) == ExitCode.NODE_FAULT
    told = capsys.readouterr().err
    assert f"firmware {OTHER} is frozen into its MicroPython, and this mdms has {VERSION}" in told
    assert "firmware/FREEZING.md" in told
    board.wait_for("motors", "on old")
    assert {path: files_of(board)[path] for path in OLD.files} == OLD.files


# Memory


def test_copies_are_refused_where_they_do_not_fit_into_the_heap(plug_in, capsys):
    board = plug_in(OLD.files, heap_bytes=SMALL_HEAP)
    board.wait_for("motors", "on old")
    assert command(board) == ExitCode.FAILURE
    told = capsys.readouterr().err
    assert f"copied firmware takes {COPIES_HEAP // 1024} KB" in told
    assert "freeze the firmware into its MicroPython (firmware/FREEZING.md)" in told
    board.wait_for("motors", "on old")
    assert {path: files_of(board)[path] for path in OLD.files} == OLD.files


def test_romfs_takes_modules_that_the_heap_does_not(plug_in, copies):
    # The stand-in for the partition lies in the heap here.
    board = plug_in({}, rom=b"", heap_bytes=SMALL_HEAP + ROM_SIZE)
    with BoardLink(board.port, MonotonicClock()) as link:
        assert identify(link).heap < COPIES_HEAP
    assert command(board) == ExitCode.OK
    assert board.rom.startswith(copies.in_rom().rom)
