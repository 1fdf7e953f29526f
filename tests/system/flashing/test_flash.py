"""`mdms flash` onto boards made of real MicroPython, whose power may fail at any moment."""

import json
from binascii import crc32
from contextlib import contextmanager
from pathlib import Path

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
from tests.system.flashing.unix_board import boards_in

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.clock import MonotonicClock
from mdms_host.flashing import board_link
from mdms_host.flashing.board_link import (
    WATCHDOG_MS,
    BoardError,
    BoardLink,
    BoardPort,
    NoBoardError,
)
from mdms_host.flashing.board_survey import identify, survey
from mdms_protocol.version import VERSION

pytestmark = pytest.mark.xdist_group("flash")
ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def plug_in_for_module(tmp_path_factory):
    with boards_in(tmp_path_factory.mktemp("boards")) as plug_in:
        yield plug_in


def test_running_cell_is_stopped_flashed_and_runs_the_new_firmware(plug_in):
    board = plug_in({**OLD.files, **STALE, **KEPT})
    board.wait_for("motors", "on old")
    plan = flash(board, NEW)
    assert set(plan.stale) == set(STALE)
    assert plan.written == ("mdms_protocol/version.py", "boards/table.bin", "main.py")
    board.wait_for("motors", "on new")
    left = files_of(board)
    assert left.keys() == NEW.files.keys() | KEPT.keys() | {"motors"}
    assert left["settings0.bin"] == KEPT["settings0.bin"]
    assert left["crash.log"].startswith(b"before\nKeyboardInterrupt")


def test_cell_that_starts_right_after_it_was_flashed_is_flashed_again(plug_in):
    board = plug_in(OLD.files)
    flash(board, NEW)
    flash(board, OLD)
    board.wait_for("motors", "on old")
    assert firmware_on(board) == OLD.files


def test_watchdog_of_the_cell_is_held_while_its_files_are_written(plug_in):
    board = plug_in(OLD.files)
    board.wait_for("motors", "on old")
    with BoardLink(board.port, MonotonicClock()) as link:
        board.wait_for("motors", "off")
        board.starve(WATCHDOG_MS - 1)
        assert link.ask("1 + 1") == 2
    assert board.timeouts_ms == [1000, WATCHDOG_MS, WATCHDOG_MS]
    assert board.resets == 0
    board.starve(WATCHDOG_MS + 1)
    assert board.resets == 1
    board.wait_for("motors", "on old")


def test_same_firmware_is_not_written_again_unless_forced(plug_in):
    board = plug_in(NEW.files)
    board.wait_for("motors", "on new")
    assert flash(board, NEW).written == ()
    board.wait_for("motors", "on new")
    assert set(flash(board, NEW, force=True).written) == set(NEW.files)


@pytest.fixture(scope="module")
def traffic_bytes(plug_in_for_module):
    """How many bytes a board receives while it is flashed."""
    return traffic_of(plug_in_for_module({**OLD.files, **STALE}), NEW)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2, 0.3, 0.5, 0.7, 0.85, 0.9, 0.95, 0.99])
def test_power_may_fail_at_any_moment(plug_in, traffic_bytes, share):
    board = plug_in({**OLD.files, **STALE, **KEPT})
    board.wait_for("motors", "on old")
    board.fuse_bytes = int(share * traffic_bytes)
    cut_off(board, NEW)
    (board.flash / "motors").unlink()
    left = firmware_on(board)
    assert "main.py" not in left or left in ({**OLD.files, **STALE}, NEW.files)
    board.fuse_bytes = None
    board.plug_in()
    flash(board, NEW)
    board.wait_for("motors", "on new")
    assert firmware_on(board) == NEW.files
    assert files_of(board)["settings0.bin"] == KEPT["settings0.bin"]


@pytest.fixture
def gone_for_good(monkeypatch):
    """Ports that are not there are not waited for."""
    monkeypatch.setattr(board_link, "_RETURN_S", 0.0)


def test_nobody_at_the_port_is_told(gone_for_good):
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
        quick = survey(link, OLD)
        (board.flash / "hashlib.py").write_text("raise ImportError('no module named hashlib')\n")
        link.run("sys.path.insert(0, ''); sys.modules.pop('hashlib', None)")
        assert survey(link, OLD) == quick


@pytest.fixture
def shares(monkeypatch):
    """The shares that the bars of the boards are told, by their names."""
    told = {}

    @contextmanager
    def bars(names):
        told.update({name: [] for name in names})
        yield lambda name, share: told[name].append(share)

    monkeypatch.setattr("mdms_host.cli.cells.flash.bars", bars)
    return told


def test_command_flashes_the_real_firmware_onto_boards_at_once(plug_in, copies, shares, capsys):
    boards = [plug_in({**OLD.files, **STALE, **KEPT}), plug_in({})]
    ports = [board.port for board in boards]
    assert main(["flash", "--board", "pybv11", "--port", *ports]) == ExitCode.OK
    told = capsys.readouterr().out
    assert f"old -> {VERSION}" in told
    assert f"no firmware -> {VERSION}" in told
    assert told.count("written and verified") == 2
    assert list(shares) == ports
    for share in shares.values():
        assert share == sorted(share)
        assert len(share) > 10
        assert share[-1] == 1.0
    for board in boards:
        assert firmware_on(board) == copies.files
    assert main(["flash", "--board", "pybv11", "--json", "--port", *ports]) == ExitCode.OK
    rows = json.loads(capsys.readouterr().out)["boards"]
    assert [(row["firmware"], row["written"]) for row in rows] == [(VERSION, [])] * 2


def test_flashed_modules_are_those_that_a_board_imports(plug_in, copies, capsys):
    sources = {"mdms_cell/cell.py": b"raise OSError\n", "mdms_cell/__init__.py": b""}
    board = plug_in(sources)
    assert main(["flash", "--board", "pybv11", "--port", board.port]) == ExitCode.OK
    assert imported_from(board, "mdms_cell.cell") == "mdms_cell/cell.mpy"


def test_dry_run_writes_nothing_and_the_cell_runs_again(plug_in, capsys):
    board = plug_in(OLD.files)
    board.wait_for("motors", "on old")
    assert main(["flash", "--board", "pybv11", "--dry-run", "--port", board.port]) == ExitCode.OK
    assert "would write" in capsys.readouterr().out
    board.wait_for("motors", "on old")
    assert {path: files_of(board)[path] for path in OLD.files} == OLD.files


def test_list_shows_the_boards_that_are_there(plug_in, capsys):
    board = plug_in(OLD.files)
    assert main(["flash", "--list", "--json", "--port", board.port]) == ExitCode.OK
    (row,) = json.loads(capsys.readouterr().out)["boards"]
    assert row["port"] == board.port
    assert row["chip"] == bytes(range(12)).hex()
    assert row["serial"] == f"{crc32(bytes(range(12))):08X}"
    assert row["micropython"].count(".") == 2
    assert row["firmware"] == "old"
    assert row["frozen"] is None


def test_list_for_people_has_the_serial_number_of_the_bus_and_compares_versions(plug_in, capsys):
    later = {**OLD.files, "mdms_protocol/version.py": b"VERSION = '99.0.0'\n"}
    ports = [plug_in(files).port for files in (OLD.files, later, {})]
    assert main(["flash", "--list", "--port", *ports]) == ExitCode.OK
    printed = capsys.readouterr().out
    assert printed.count(f"{crc32(bytes(range(12))):08X}") == 3
    assert f"old (other than {VERSION} here)" in printed
    assert f"99.0.0 (newer than {VERSION} here)" in printed
    assert " none " in printed


def test_one_board_that_fails_is_named_and_the_others_are_flashed(plug_in, gone_for_good, capsys):
    board = plug_in({})
    assert (
        main(["flash", "--board", "pybv11", "--port", board.port, "/dev/none"])
        == ExitCode.NO_DEVICE
    )
    told = capsys.readouterr()
    assert "written and verified" in told.out
    assert "mdms: /dev/none: cannot be opened" in told.err
    assert "1 of 2 boards failed: /dev/none" in told.err


def test_file_that_flash_does_not_keep_is_named_and_the_firmware_does_not_start(
    plug_in, monkeypatch, capsys
):
    write = BoardLink.write

    def wear(link, path, data):
        write(link, path, data[:-1] + b"?" if path.endswith("table.bin") else data)

    monkeypatch.setattr(BoardLink, "write", wear)
    monkeypatch.setattr("mdms_host.flashing.firmware.compiled_firmware", lambda _machine: NEW)
    board = plug_in({**OLD.files, **KEPT})
    board.wait_for("motors", "on old")
    assert main(["flash", "--board", "pybv11", "--port", board.port]) == ExitCode.FAILURE
    printed = capsys.readouterr()
    assert "boards/table.bin did not arrive whole; flash it again" in printed.err
    assert "verified" not in printed.out
    board.wait_for("motors", "off")
    assert "main.py" not in firmware_on(board)
    assert files_of(board)["settings0.bin"] == KEPT["settings0.bin"]


def test_flash_that_is_full_is_told_with_the_way_out(plug_in):
    with BoardLink(plug_in({}).port, MonotonicClock()) as link:
        for error in ("28", "28, 'ENOSPC'"):
            with pytest.raises(BoardError, match=r"its flash is full.*mpremote fs ls"):
                link.run(f"raise OSError({error})")
        with pytest.raises(BoardError, match=r"^OSError: 2$|ENOENT$"):
            link.run("raise OSError(2)")


@pytest.mark.parametrize("which", [(), ("--all",)])
def test_can_adapter_stays_one_unless_its_port_is_named(plug_in, monkeypatch, capsys, which):
    adapter = (ROOT / "firmware" / "adapter_main.py").read_bytes()
    board = plug_in({**OLD.files, "main.py": adapter})
    ports = [BoardPort(board.port)]
    monkeypatch.setattr("mdms_host.flashing.board_link.board_ports", lambda _ports: ports)
    monkeypatch.setattr("mdms_host.flashing.firmware.compiled_firmware", lambda _machine: NEW)
    assert main(["flash", "--board", "pybv11", *which]) == ExitCode.OK
    assert "it is a CAN adapter, and stays one" in capsys.readouterr().err
    assert (board.flash / "main.py").read_bytes() == adapter
    assert main(["flash", "--board", "pybv11", "--port", board.port]) == ExitCode.OK
    board.wait_for("motors", "on new")


def test_unknown_board_is_left_as_it_is(plug_in, capsys):
    board = plug_in(OLD.files)
    assert main(["flash", "--port", board.port]) == ExitCode.FAILURE
    assert "--board names a board like it" in capsys.readouterr().err
    board.wait_for("motors", "on old")
