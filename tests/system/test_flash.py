"""`mdms flash` onto boards made of real MicroPython, whose power may fail at any moment."""

import json
import time

import pytest
from tests.system.unix_board import boards_in

from mdms_host.cli import main
from mdms_host.cli.exits import Exit
from mdms_host.clock import MonotonicClock
from mdms_host.flashing.board_link import WATCHDOG_MS, BoardError, BoardLink, NoBoardError
from mdms_host.flashing.board_survey import Firmware, identify, survey
from mdms_host.flashing.flashing import carry_out, plan_flash
from mdms_image import build_image

pytestmark = pytest.mark.real_time

#: A cell at work, as far as its host can tell: fed watchdog, motors that go off with it.
CELL = b"""
import machine, time
from mdms_cell import VERSION

def tell(name, text, mode="w"):
    with open(name, mode) as file:
        file.write(text)

dog = machine.WDT(timeout=1000)
tell("motors", "on " + VERSION)
try:
    while True:
        dog.feed()
        time.sleep_ms(5)
except BaseException as error:
    tell("crash.log", repr(error) + "\\n", "a")
    raise
finally:
    tell("motors", "off")
"""


@pytest.fixture
def plug_in(tmp_path):
    with boards_in(tmp_path) as plug_in:
        yield plug_in


@pytest.fixture(scope="module")
def plug_in_for_module(tmp_path_factory):
    with boards_in(tmp_path_factory.mktemp("boards")) as plug_in:
        yield plug_in


def version(text):
    """A small firmware that tells its version."""
    module = b"from mdms_cell.version import VERSION\n"
    files = {
        "main.py": CELL,
        "mdms_cell/__init__.py": module,
        "mdms_cell/version.py": f"VERSION = {text!r}\n".encode(),
        "boards/table.bin": text.encode() * 2000,
    }
    return Firmware(files, text)


OLD, NEW = version("old"), version("new")
KEPT = {"settings0.bin": b"\x00\x01", "boot.py": b"", "crash.log": b"before\n"}
STALE = {
    "mdms_cell/version.mpy": b"M\x06",
    "binascii.mpy": b"M\x06",
    "mdms_protocol/x.py": b"1",
    "mdms_gone.mpy": b"M\x06",
}


def flash(board, firmware, force=False):
    """Flash, restart, and return the plan that was carried out."""
    with BoardLink(board.port, MonotonicClock()) as link:
        identify(link)
        found = survey(link, firmware.files)
        plan = plan_flash(found, firmware, force=force)
        if plan.written:
            carry_out(link, firmware, plan, found, lambda _share: None)
        assert survey(link, firmware.files).has(firmware)
        link.restart()
    return plan


def files_of(board):
    return {
        str(path.relative_to(board.flash)): path.read_bytes()
        for path in board.flash.rglob("*")
        if path.is_file()
    }


def test_running_cell_is_stopped_flashed_and_runs_the_new_firmware(plug_in):
    board = plug_in({**OLD.files, **STALE, **KEPT})
    board.wait_for("motors", "on old")
    plan = flash(board, NEW)
    assert set(plan.stale) == set(STALE)
    assert plan.written == ("mdms_cell/version.py", "boards/table.bin", "main.py")
    board.wait_for("motors", "on new")
    left = files_of(board)
    assert left.keys() == NEW.files.keys() | KEPT.keys() | {"motors"}
    assert left["settings0.bin"] == KEPT["settings0.bin"]
    assert left["crash.log"].startswith(b"before\nKeyboardInterrupt")


def test_watchdog_of_the_cell_is_held_while_its_files_are_written(plug_in):
    board = plug_in(OLD.files)
    board.wait_for("motors", "on old")
    with BoardLink(board.port, MonotonicClock()) as link:
        board.wait_for("motors", "off")
        time.sleep(1.5)
        assert link.ask("1 + 1") == 2
    assert board.timeouts_ms == [1000, WATCHDOG_MS, WATCHDOG_MS]
    assert board.resets == 0


def test_same_firmware_is_not_written_again_unless_forced(plug_in):
    board = plug_in(NEW.files)
    board.wait_for("motors", "on new")
    assert flash(board, NEW).written == ()
    board.wait_for("motors", "on new")
    assert set(flash(board, NEW, force=True).written) == set(NEW.files)


@pytest.fixture(scope="module")
def traffic_bytes(plug_in_for_module):
    """How many bytes a board receives while it is flashed."""
    board = plug_in_for_module({**OLD.files, **STALE})
    board.fuse_bytes = plenty = 1 << 30
    flash(board, NEW)
    return plenty - board.fuse_bytes


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2, 0.3, 0.5, 0.7, 0.85, 0.9, 0.95, 0.99])
def test_power_may_fail_at_any_moment(plug_in, traffic_bytes, share):
    board = plug_in({**OLD.files, **STALE, **KEPT})
    board.wait_for("motors", "on old")
    board.fuse_bytes = int(share * traffic_bytes)
    with pytest.raises(NoBoardError):
        flash(board, NEW)
    board.unplug()
    (board.flash / "motors").unlink()
    left = firmware_on(board)
    assert "main.py" not in left or left in ({**OLD.files, **STALE}, NEW.files)
    board.fuse_bytes = None
    board.plug_in()
    flash(board, NEW)
    board.wait_for("motors", "on new")
    assert firmware_on(board) == NEW.files
    assert files_of(board)["settings0.bin"] == KEPT["settings0.bin"]


def firmware_on(board):
    left = files_of(board)
    return {path: left[path] for path in left.keys() - KEPT.keys() - {"motors"}}


def test_nobody_at_the_port_is_told():
    with pytest.raises(NoBoardError, match="cannot be opened"):
        BoardLink("/dev/none", MonotonicClock())


def test_error_on_the_board_is_told_in_one_line(plug_in):
    board = plug_in({})
    with BoardLink(board.port, MonotonicClock()) as link:
        with pytest.raises(BoardError, match=r"OSError: .*ENOENT"):
            link.read("none.txt")
        with pytest.raises(BoardError, match="cannot make sense"):
            link.ask("print")


def test_board_without_hashlib_is_read_instead(plug_in):
    board = plug_in({**OLD.files, **KEPT})
    with BoardLink(board.port, MonotonicClock()) as link:
        identify(link)
        quick = survey(link, OLD.files)
        (board.flash / "hashlib.py").write_text("raise ImportError('no module named hashlib')\n")
        link.run("sys.path.insert(0, ''); sys.modules.pop('hashlib', None)")
        assert survey(link, OLD.files) == quick


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    folder = tmp_path_factory.mktemp("image")
    return folder, build_image(folder, "pybv11")


def test_command_flashes_the_real_image_onto_boards_at_once(plug_in, image, capsys):
    folder, built = image
    boards = [plug_in({**OLD.files, **STALE, **KEPT}), plug_in({})]
    ports = [board.port for board in boards]
    assert main(["flash", "--board", "pybv11", "--port", *ports]) == Exit.OK
    told = capsys.readouterr().out
    assert told.count(f"-> {built.version}") == 2
    assert told.count("written and verified") == 2
    for board in boards:
        left = files_of(board)
        assert all(left[str(path)] == (folder / path).read_bytes() for path in built.files)
        assert not left.keys() & (STALE.keys() | {"boards/table.bin", "mdms_cell/__init__.py"})
    assert main(["flash", "--board", "pybv11", "--json", "--port", *ports]) == Exit.OK
    rows = json.loads(capsys.readouterr().out)["boards"]
    assert [(row["firmware"], row["written"]) for row in rows] == [(built.version, [])] * 2


def test_dry_run_writes_nothing_and_the_cell_runs_again(plug_in, capsys):
    board = plug_in(OLD.files)
    board.wait_for("motors", "on old")
    assert main(["flash", "--board", "pybv11", "--dry-run", "--port", board.port]) == Exit.OK
    assert "would write" in capsys.readouterr().out
    board.wait_for("motors", "on old")
    assert {path: files_of(board)[path] for path in OLD.files} == OLD.files


def test_list_shows_what_is_there(plug_in, capsys):
    board = plug_in(OLD.files)
    assert main(["flash", "--list", "--json", "--port", board.port]) == Exit.OK
    (row,) = json.loads(capsys.readouterr().out)["boards"]
    assert row["port"] == board.port
    assert row["chip"] == bytes(range(12)).hex()
    assert row["micropython"].count(".") == 2
    assert len(row["firmware"]) == 12


def test_one_board_that_fails_is_named_and_the_others_are_flashed(plug_in, capsys, image):
    board = plug_in({})
    assert main(["flash", "--board", "pybv11", "--port", board.port, "/dev/none"]) == Exit.NO_DEVICE
    told = capsys.readouterr()
    assert "written and verified" in told.out
    assert "mdms: /dev/none: cannot be opened" in told.err
    assert "1 of 2 boards failed: /dev/none" in told.err


def test_unknown_board_is_left_as_it_is(plug_in, capsys):
    board = plug_in(OLD.files)
    assert main(["flash", "--port", board.port]) == Exit.FAILURE
    assert "--board says what it is like" in capsys.readouterr().err
    board.wait_for("motors", "on old")
