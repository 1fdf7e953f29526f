import os
import subprocess
import sys
import tty
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import can
import pytest
from can.cli import add_bus_arguments
from tests.host.can_link.scripted_bus import ScriptedBus

from mdms_host.can_link.link import (
    DeviceGoneError,
    Link,
    LinkCounts,
    NoBusError,
    open_bus,
    remedy,
)
from mdms_host.clock import MonotonicClock
from mdms_protocol.codecs.frame import Frame

HEARTBEAT = Frame(0x701, b"\x05")
MESSAGE = can.Message(arbitration_id=0x701, data=b"\x05", is_extended_id=False)
PATIENCE_S = 60.0


@pytest.fixture
def clock() -> MonotonicClock:
    return MonotonicClock()


def received(link: Link, clock: MonotonicClock, count: int = 1) -> list[Frame]:
    """The next frames; fails when they do not come."""
    frames: list[Frame] = []
    while len(frames) < count:
        link.receive(0.1, lambda frame, _now_s: frames.append(frame))
        assert clock.now_s() < PATIENCE_S
    return frames


def gone(link: Link, clock: MonotonicClock) -> str:
    """The error of the link when its device is gone."""
    while clock.now_s() < PATIENCE_S:
        try:
            link.receive(0.1, lambda *_: None)
        except DeviceGoneError as error:
            return str(error)
    raise AssertionError("the device is not taken to be gone")


def options(*arguments: str):
    parser = ArgumentParser()
    add_bus_arguments(parser)
    return parser.parse_args(arguments)


def test_frames_go_both_ways(clock) -> None:
    with (
        can.Bus("both-ways", interface="virtual") as other,
        Link(can.Bus("both-ways", interface="virtual"), clock) as link,
    ):
        link.send(Frame(0x201, b"\x01\x02"))
        message = other.recv(1.0)
        assert (message.arbitration_id, message.data) == (0x201, b"\x01\x02")
        other.send(MESSAGE)
        assert received(link, clock) == [HEARTBEAT]


def test_stray_datagrams_are_no_device_that_is_gone(clock) -> None:
    """python-can's UdpMulticastBus reports one byte of anybody as an error of its own."""
    stray = can.CanOperationError("could not unpack received message")
    stray.__cause__ = AttributeError("'int' object has no attribute 'update'")
    with Link(ScriptedBus(*[stray] * 5, MESSAGE), clock) as link:
        assert received(link, clock) == [HEARTBEAT]
        assert link.garbled == 5


@pytest.mark.parametrize("garbage", [ValueError("invalid literal"), IndexError()])
def test_a_reader_that_dies_of_garbage_is_started_anew_and_told_of(clock, garbage) -> None:
    bus = ScriptedBus(garbage, MESSAGE, garbage, MESSAGE)
    with Link(bus, clock) as link:
        assert received(link, clock, 2) == [HEARTBEAT, HEARTBEAT]
        assert (link.garbled, bus.flushed) == (2, 0)
        assert [text.split(" of ")[0] for _, text in link.incidents] == ["the reader died"] * 2


def test_bytes_that_cannot_be_decoded_are_flushed_from_the_adapter(clock) -> None:
    bus = ScriptedBus(UnicodeError("undecodable"), MESSAGE)
    with Link(bus, clock) as link:
        assert received(link, clock) == [HEARTBEAT]
        assert (link.garbled, bus.flushed) == (1, 1)


def test_a_device_that_recovers_is_not_given_up(clock) -> None:
    hiccup = can.CanOperationError("overrun")
    with Link(ScriptedBus(*[hiccup] * 4, MESSAGE, *[hiccup] * 4, MESSAGE), clock) as link:
        assert received(link, clock, 2) == [HEARTBEAT, HEARTBEAT]
        assert len(link.incidents) == 8


def test_a_device_that_cannot_be_read_is_gone(clock) -> None:
    with Link(ScriptedBus(*[OSError("unplugged")] * 5), clock) as link:
        assert gone(link, clock) == "the CAN device is gone: unplugged"
        with pytest.raises(DeviceGoneError, match="unplugged"):
            link.send(HEARTBEAT)


def test_frames_that_cannot_be_sent_are_counted_until_the_device_is_gone(clock) -> None:
    bus = ScriptedBus()
    with Link(bus, clock) as link:
        bus.send_error = can.CanOperationError("no room")
        for _ in range(4):
            link.send(HEARTBEAT)
        bus.send_error = None
        link.send(HEARTBEAT)
        assert (link.unsent, len(bus.sent)) == (4, 1)
        bus.send_error = can.CanOperationError("no room")
        for _ in range(5):
            link.send(HEARTBEAT)
        with pytest.raises(DeviceGoneError, match="no room"):
            link.send(HEARTBEAT)


def test_other_than_plain_data_frames_are_counted_and_dropped(clock) -> None:
    strange = [
        can.Message(is_error_frame=True),
        can.Message(arbitration_id=0x701, is_extended_id=True),
        can.Message(arbitration_id=0x701, is_extended_id=False, is_remote_frame=True),
    ]
    with Link(ScriptedBus(*strange, MESSAGE), clock) as link:
        assert received(link, clock) == [HEARTBEAT]
        assert link.counts == LinkCounts(error_frames=1, foreign=2)
        assert str(link.counts) == "1 error frames, 2 with 29 bits, remote or of CAN FD"


class SocketcanBus(ScriptedBus):
    """As python-can's where it matters: messages of programs of this computer are marked."""

    def __init__(self, *script: can.Message | Exception, returns_own: bool) -> None:
        self.socket = SimpleNamespace(getsockopt=lambda *_option: int(returns_own))
        super().__init__(*script)


def marked(frame: Frame) -> can.Message:
    return can.Message(
        arbitration_id=frame.can_id, data=frame.data, is_extended_id=False, is_rx=False
    )


def test_sent_frames_that_a_driver_returns_are_dropped(clock) -> None:
    own = Frame(0x201, b"\x01")
    for bus in (
        ScriptedBus(marked(own), MESSAGE),
        SocketcanBus(marked(own), MESSAGE, returns_own=True),
    ):
        with Link(bus, clock) as link:
            assert received(link, clock) == [HEARTBEAT]


def test_over_socketcan_other_programs_of_this_computer_are_received(clock) -> None:
    stop = Frame(0x000, b"\x80\x00")
    with Link(SocketcanBus(marked(stop), MESSAGE, returns_own=False), clock) as link:
        assert received(link, clock, 2) == [stop, HEARTBEAT]


@pytest.fixture
def adapter() -> Iterator[tuple[int, can.BusABC]]:
    """A serial adapter: the file descriptor of its far end, and python-can's bus on it."""
    far, near = os.openpty()
    tty.setraw(near)
    bus = can.Bus(os.ttyname(near), interface="slcan", sleep_after_open=0)
    os.close(near)
    yield far, bus
    try:
        os.close(far)
    except OSError:
        return  # The test has unplugged it.


REFUSED = b"\x07\r"


@pytest.mark.parametrize("garbage", [b"t70Z1\r", b"\xff\xfe\x80\r", b"t\r", b"T0000\r", REFUSED])
def test_garbage_from_a_serial_adapter_costs_no_later_frame(clock, adapter, garbage) -> None:
    far, bus = adapter
    with Link(bus, clock) as link:
        os.write(far, b"t701105\r")
        assert received(link, clock) == [HEARTBEAT]
        os.write(far, garbage)
        # Read by itself; a refusal of nothing that was sent is no garbage.
        while garbage != REFUSED and not link.garbled:
            assert clock.now_s() < PATIENCE_S
            clock.sleep(0.01)
        os.write(far, b"t701105\r")
        assert received(link, clock) == [HEARTBEAT]


def test_a_serial_adapter_that_is_unplugged_is_gone(clock, adapter) -> None:
    far, bus = adapter
    with Link(bus, clock) as link:
        os.close(far)
        assert gone(link, clock).startswith("the CAN device is gone: ")


class SteppedClock:
    """Time passes as the test sets it."""

    is_real = False

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        """Return at once."""


def test_heartbeats_of_all_cells_that_come_late_are_among_the_delays(clock) -> None:
    bus, stepped = ScriptedBus(), SteppedClock()
    with Link(bus, stepped) as link:
        for stepped.time_s in (1.0, 1.3):
            for node_id in (1, 2):
                bus.script.put(
                    can.Message(arbitration_id=0x700 + node_id, data=[5], is_extended_id=False)
                )
            received(link, clock, 2)
        assert "came after 300 ms" in link.delays.slow_reason(1.3)


@pytest.mark.parametrize(
    ("arguments", "told", "way_out"),
    [
        ((), "no CAN interface was named", "mdms serve array18"),
        (("-c", "e18"), "no CAN interface was named for channel e18", "-i mdms"),
        (("-i", "slcan", "-c", "/dev/no-such-adapter"), "No such file", "serial.tools.list_ports"),
        (("-i", "serial"), "^no channel was named for serial; ", "mdms serve array18"),
        (("-i", "slcan"), "^no channel was named for slcan; ", "-c"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_told_with_a_way_out(
    monkeypatch, arguments, told, way_out
) -> None:
    monkeypatch.setattr("can.util.load_file_config", lambda *_: {})
    for name in ("CAN_INTERFACE", "CAN_CHANNEL"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(NoBusError, match=told) as refused:
        open_bus(options(*arguments))
    assert way_out in str(refused.value)


def test_a_bus_is_opened_by_python_cans_own_options() -> None:
    with open_bus(options("-i", "virtual", "-c", "by-options")) as bus:
        assert "by-options" in bus.channel_info


@pytest.mark.real_time
@pytest.mark.slow
def test_a_served_array_that_ends_is_gone(clock, monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    command = [Path(sys.executable).parent / "mdms", "serve", "array18", "--name", "to-be-ended"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            while "to-be-ended" not in server.stdout.readline():
                assert server.poll() is None
            with Link(can.Bus("to-be-ended", interface="mdms"), clock) as link:
                assert received(link, MonotonicClock())
                server.terminate()
                assert "the CAN device is gone" in gone(link, MonotonicClock())
        finally:
            server.terminate()


@pytest.mark.parametrize(
    ("interface", "problem", "told"),
    [
        ("gs_usb", "Cannot import module: No module named 'usb'", "'python-can[gs-usb]'"),
        ("neovi", "Please install python-ics", "'python-can[neovi]'"),
        ("pcan", "pcanbasic library not found.", "PEAK's PCANBasic library"),
    ],
)
def test_missing_driver_is_named_with_its_package(monkeypatch, interface, problem, told):
    def fail(_options):
        raise can.CanInterfaceNotImplementedError(problem)

    monkeypatch.setattr("mdms_host.can_link.link.create_bus_from_namespace", fail)
    with pytest.raises(NoBusError) as failure:
        open_bus(Namespace(interface=interface, channel="0"))
    assert f"install {'its driver: pip install ' if 'python' in told else ''}{told}" in str(
        failure.value
    )


@pytest.mark.parametrize(
    ("interface", "problem"),
    [("slcan", "could not open port can0"), (None, "No module named 'usb'"), ("own", "not found")],
)
def test_an_error_without_a_missing_package_names_none(interface, problem):
    assert remedy(interface, problem) is None


@pytest.mark.parametrize("error", [TypeError("no host"), NameError("canOpen"), ImportError("ics")])
def test_interface_that_fails_in_its_own_way_is_no_bus(monkeypatch, error):
    def fail(_options):
        raise error

    monkeypatch.setattr("mdms_host.can_link.link.create_bus_from_namespace", fail)
    with pytest.raises(NoBusError, match="kvaser 0 cannot be opened") as refused:
        open_bus(Namespace(interface="kvaser", channel="0"))
    assert "-i and -c" not in str(refused.value)
