"""A served bus under programs that are rude, many, or none of its own; real sockets."""

import os
import socket
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from types import SimpleNamespace

import can
import pytest
from tests.sim_bus.bus.ear import Ear

from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import ErrorState
from mdms_sim.kernel import Kernel
from mdms_sim.serve import python_can
from mdms_sim.serve.client import BACKLOG_BYTES
from mdms_sim.serve.endpoint import Acceptor, FullError, ServeError, UnixListener, listen_tcp
from mdms_sim.serve.packet import HELLO
from mdms_sim.serve.server import CONNECTIONS_MAX, Server, ways_in

MS = 1_000_000
PATIENCE_S = 20.0


@contextmanager
def serving(path, speed=1.0, **options):
    """A bus with one listener on it, served by a thread of its own, which changes its speed."""
    kernel, ear, over, told, speeds = Kernel(), Ear(), threading.Event(), [], []
    bus = Bus(kernel, 1_000_000)
    simulation = SimpleNamespace(kernel=kernel, bus=bus, buses=[bus], tipped=False, blinking=[])
    bus.attach(ear)

    def tick():
        kernel.at(kernel.now_ns + MS, 0, tick)

    tick()

    def attend():
        while speeds:
            server.time.change_speed(speeds.pop(), kernel.now_ns)
        return over.is_set()

    with Server(simulation, str(path), speed=speed, report=told.append, **options) as server:
        thread = threading.Thread(target=server.run, args=(attend,))
        thread.start()
        try:
            yield SimpleNamespace(server=server, ear=ear, told=told, kernel=kernel, speeds=speeds)
        finally:
            over.set()
            thread.join()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "bus.sock"


def connect_tcp(served):
    connection = socket.create_connection(("127.0.0.1", served.server.addresses.tcp_port))
    connection.settimeout(PATIENCE_S)
    return connection


def ends(connection):
    """Read until the other side has closed; returns the bytes before."""
    came = b""
    with suppress(ConnectionResetError):
        while data := connection.recv(1 << 16):
            came += data
    return came


def dead_socket(path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


# Files


def test_a_regular_file_of_the_name_stays(path):
    path.write_text("somebody's work")
    with pytest.raises(ServeError, match="no socket"):
        UnixListener(str(path))
    assert path.read_text() == "somebody's work"


def test_a_link_stays_whatever_it_leads_to(path, tmp_path):
    dead_socket(tmp_path / "other.sock")
    path.symlink_to(tmp_path / "other.sock")
    with pytest.raises(ServeError, match="no socket"):
        UnixListener(str(path))
    assert path.is_symlink()


def test_a_dead_socket_is_replaced_and_a_live_one_is_not(path):
    dead_socket(path)
    listener = UnixListener(str(path))
    with pytest.raises(ServeError, match="in use"):
        UnixListener(str(path))
    listener.close()
    assert not path.exists()


def test_a_socket_whose_owner_is_too_busy_to_answer_is_not_taken_for_dead(path):
    with socket.socket(socket.AF_UNIX) as busy:
        busy.bind(str(path))
        busy.listen(0)
        with socket.socket(socket.AF_UNIX) as first:
            first.connect(str(path))
            with pytest.raises(ServeError, match="in use"):
                UnixListener(str(path))
    assert path.is_socket()


FULL = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a full queue is a refusal")


@pytest.mark.parametrize("waiting", [0, pytest.param(2, marks=FULL)])
def test_a_bus_whose_server_does_not_answer_is_not_said_to_be_served_by_nobody(
    path, monkeypatch, waiting
):
    monkeypatch.setattr(python_can, "_HELLO_TIMEOUT_S", 0.01)
    with socket.socket(socket.AF_UNIX) as busy, ExitStack() as others:
        busy.bind(str(path))
        busy.listen(0)
        for _ in range(waiting):
            with suppress(BlockingIOError):
                other = others.enter_context(socket.socket(socket.AF_UNIX))
                other.setblocking(False)
                other.connect(str(path))
        with pytest.raises(can.CanInitializationError, match="its server does not answer within"):
            can.Bus(str(path), interface="mdms")


def test_a_socket_that_a_killed_server_has_left_is_not_said_to_be_served(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "mdms").mkdir()
    dead_socket(tmp_path / "mdms" / "killed.sock")
    with pytest.raises(
        can.CanInitializationError, match=r"\(Connection refused\); nothing is served"
    ):
        can.Bus("killed", interface="mdms")


def test_a_file_that_took_the_name_meanwhile_stays_at_the_end(path):
    listener = UnixListener(str(path))
    path.unlink()
    path.write_text("somebody's work")
    listener.close()
    assert path.read_text() == "somebody's work"


def test_a_server_that_cannot_open_all_leaves_no_socket(path):
    with (
        listen_tcp(0) as taken,
        pytest.raises(ServeError, match="cannot listen"),
        serving(path, tcp_port=taken.getsockname()[1]),
    ):
        pass
    assert not path.exists()


# TCP


def test_a_port_beyond_the_last_is_refused_as_that_of_a_second_bus_may_be():
    with pytest.raises(ServeError, match=r"port 65536 .* give a lower one with --tcp"):
        listen_tcp(65536)


def test_tcp_is_closed_unless_it_is_asked_for(path):
    with serving(path) as served:
        assert served.server.addresses.tcp_port is None
        assert "socket://" not in "".join(ways_in(served.server.addresses))
    with serving(path, tcp_port=0) as served:
        port = served.server.addresses.tcp_port
        assert f"socket://127.0.0.1:{port}" in ways_in(served.server.addresses)[-1]


@pytest.mark.parametrize("method", ["POST", "GET", "OPTIONS", "CONNECT", "LOCK", "VIEW"])
@pytest.mark.parametrize("at_once", [True, False])
def test_a_web_page_puts_nothing_on_the_bus(path, method, at_once):
    head = f"{method} / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
    body = b"\rC\rS8\rO\rt000201" + b"00\r"
    with serving(path, tcp_port=0) as served, connect_tcp(served) as page:
        if at_once:
            page.sendall(head + body)
        else:
            page.sendall(head[:3])
            with suppress(ConnectionError):
                for byte in head[3:] + body:
                    page.sendall(bytes((byte,)))
        assert ends(page) == b""
        with connect_tcp(served) as adapter:
            adapter.sendall(b"S8\rO\rt7010\r")
            assert adapter.recv(8)
        assert all(frame.can_id == 0x701 for frame, _ in served.ear.heard)


def test_a_tls_handshake_is_closed_before_its_first_line_ends(path):
    with serving(path, tcp_port=0) as served, connect_tcp(served) as page:
        page.sendall(b"\x16\x03\x01\x02\x00" + bytes(40))
        assert ends(page) == b""


def test_a_line_that_comes_at_the_wrong_time_ends_no_connection(path):
    with serving(path, tcp_port=0) as served, connect_tcp(served) as adapter:
        adapter.sendall(b"t2010\r")
        assert adapter.recv(1) == b"\x07"
        adapter.sendall(b"S8\r")
        assert adapter.recv(1) == b"\r"


# python-can


def test_a_message_that_is_sent_again_with_other_data_is_received_as_it_was_each_time(path):
    options = {"interface": "mdms", "channel": str(path), "receive_own_messages": True}
    with serving(path), can.Bus(**options) as bus:
        message = can.Message(arbitration_id=0x201, data=[1], is_extended_id=False)
        bus.send(message)
        message.data[0] = 2
        bus.send(message)
        assert [bus.recv(PATIENCE_S).data[0] for _ in range(2)] == [1, 2]
        assert message.is_rx


@pytest.mark.parametrize(
    "kind", [{"is_fd": True, "data": bytes(12)}, {"is_error_frame": True}], ids=["fd", "error"]
)
def test_a_message_that_no_classic_bus_carries_is_refused(path, kind):
    message = can.Message(arbitration_id=0x201, is_extended_id=False, **kind)
    with (
        serving(path),
        can.Bus(interface="mdms", channel=str(path)) as bus,
        pytest.raises(can.CanOperationError, match="classic CAN alone"),
    ):
        bus.send(message)


def test_a_bus_that_was_shut_down_is_closed_to_both_ways(path):
    with serving(path):
        bus = can.Bus(interface="mdms", channel=str(path))
        bus.shutdown()
        with pytest.raises(can.CanOperationError, match="is closed"):
            bus.send(can.Message(arbitration_id=0x201, is_extended_id=False))
        with pytest.raises(can.CanOperationError, match="is closed") as closed:
            bus.recv(0.01)
        # A cause would tell a reader of bytes that cannot be decoded.
        assert closed.value.__cause__ is None


# Terminals


def test_a_client_of_a_terminal_gets_nothing_that_was_for_one_that_was_killed(path):
    with serving(path) as served, can.Bus(interface="mdms", channel=str(path)) as other:
        device = served.server.addresses.device

        def opened(number):
            terminal = os.open(device, os.O_RDWR | os.O_NOCTTY)
            os.write(terminal, b"C\rS8\rO\rt%03X0\r" % number)
            wait_for(served.ear, number)
            return terminal

        killed = opened(0x201)
        # More than a terminal holds for a client that does not read.
        for _ in range(5000):
            other.send(can.Message(arbitration_id=0x202, is_extended_id=False))
        other.send(can.Message(arbitration_id=0x203, is_extended_id=False))
        wait_for(served.ear, 0x203)
        os.close(killed)
        terminal, came = opened(0x204), b""
        while not came.endswith(b"z\r"):
            came += os.read(terminal, 1 << 16)
        assert came == b"\r\r\rz\r"
        os.close(terminal)


def wait_for(ear, can_id):
    wait_until(lambda: can_id in {frame.can_id for frame in ear.frames})


def wait_until(is_so):
    deadline_s = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


# While time stands still


def send_by_python_can(served, path):
    with can.Bus(interface="mdms", channel=str(path)) as bus:
        bus.send(can.Message(arbitration_id=0x201, is_extended_id=False))


def send_over_tcp(served, path):
    with connect_tcp(served) as connection:
        connection.sendall(b"S8\rO\rt2010\r")


def send_at_the_terminal(served, path):
    terminal = os.open(served.server.addresses.device, os.O_RDWR | os.O_NOCTTY)
    os.write(terminal, b"S8\rO\rt2010\r")
    # Its answers say that the frame is refused.
    assert os.read(terminal, 3) == b"\r\r\x07"
    os.close(terminal)


@pytest.mark.parametrize("send", [send_by_python_can, send_over_tcp, send_at_the_terminal])
def test_a_client_that_goes_while_time_stands_still_leaves_no_frame_for_later(path, send):
    with serving(path, tcp_port=0) as served:
        with can.Bus(interface="mdms", channel=str(path)) as staying:
            served.speeds.append(0.0)
            wait_until(lambda: not served.server.time.speed)
            staying.send(can.Message(arbitration_id=0x202, is_extended_id=False))
            send(served, path)
            wait_until(lambda: send is send_at_the_terminal or all_left(served, 1))
            served.speeds.append(1.0)
            wait_for(served.ear, 0x202)
        send_by_python_can(served, path)
        wait_for(served.ear, 0x201)
    assert [frame.can_id for frame in served.ear.frames] == [0x202, 0x201]


# Many, and too much


def test_answers_that_nobody_reads_are_dropped_and_counted(path):
    line, answer = b"V\r", b"V1013\r"
    lines = BACKLOG_BYTES
    with serving(path, speed=1000.0, tcp_port=0) as served:
        with connect_tcp(served) as client:
            client.sendall(line * lines)
            client.shutdown(socket.SHUT_WR)
            # Not read until all is sent and the server has seen the end.
            while not any("has left" in text for text in served.told):
                threading.Event().wait(0.01)
        (left,) = [text for text in served.told if "has left" in text]
    assert "answers dropped" in left
    assert len(answer) * lines > 4 * BACKLOG_BYTES


def test_a_client_is_read_no_faster_than_a_full_bus(path):
    """On a machine of any speed: at most 512 bytes a simulated millisecond, and one read."""
    with serving(path, tcp_port=0) as served, connect_tcp(served) as flood:
        start_ns = served.kernel.now_ns
        flood.sendall(b"\r" * 50_000)
        answered = 0
        while answered < 50_000:
            answered += len(flood.recv(1 << 16))
        assert served.kernel.now_ns - start_ns >= (50_000 - 1024) * 2_000


def test_of_150_connections_at_once_those_beyond_the_limit_are_refused(path):
    with serving(path) as served, can.Bus(interface="mdms", channel=str(path)) as first:
        many = [socket.socket(socket.AF_UNIX) for _ in range(150)]
        for one in many:
            one.connect(str(path))
            one.settimeout(PATIENCE_S)
        greeted = 0
        for one in many:
            with suppress(ConnectionResetError):
                greeted += one.recv(len(HELLO)) == HELLO
        assert greeted == CONNECTIONS_MAX - 1
        assert sum("refused" in text for text in served.told) == 1
        with pytest.raises(can.CanInitializationError, match="no more clients"):
            can.Bus(interface="mdms", channel=str(path))
        first.send(can.Message(arbitration_id=0x201, is_extended_id=False))
        for one in many:
            one.close()
        while not all_left(served, greeted):
            threading.Event().wait(0.01)
        with can.Bus(interface="mdms", channel=str(path)) as late:
            late.send(can.Message(arbitration_id=0x202, is_extended_id=False))
            assert first.recv(PATIENCE_S).arbitration_id == 0x202
    assert [frame.can_id for frame, _ in served.ear.heard] == [0x201, 0x202]


def test_clients_that_have_gone_bus_off_come_back(path):
    """Two programs with one identifier and other data destroy each other's frames."""

    def send(bus, can_id, number):
        with suppress(can.CanOperationError):
            bus.send(can.Message(arbitration_id=can_id, data=[number], is_extended_id=False), 0.01)

    with (
        serving(path) as served,
        can.Bus(interface="mdms", channel=str(path)) as one,
        can.Bus(interface="mdms", channel=str(path)) as other,
    ):
        states = []
        served.server.simulation.bus.observe_states(lambda each, _: states.append(each.state))
        while ErrorState.BUS_OFF not in states:
            send(one, 0x10, 1)
            send(other, 0x10, 2)
        deadline_s = time.monotonic() + PATIENCE_S
        while not {0x201, 0x202} <= {frame.can_id for frame in served.ear.frames}:
            assert time.monotonic() < deadline_s
            send(one, 0x201, 1)
            send(other, 0x202, 2)
    assert any("has gone bus off: python-can" in text for text in served.told)


def all_left(served, count):
    return sum("has left" in text for text in served.told) == count


def test_a_connection_is_refused_when_no_file_descriptor_is_left(path):
    acceptor, listener = Acceptor(), UnixListener(str(path))
    clients = [socket.socket(socket.AF_UNIX) for _ in range(2)]
    for client in clients:
        client.connect(str(path))
    used = []
    with suppress(OSError):
        while True:
            used.append(os.dup(0))
    try:
        with pytest.raises(FullError):
            acceptor.accept(listener.socket)
        assert clients[0].recv(1) == b""
    finally:
        for descriptor in used:
            os.close(descriptor)
    connection = acceptor.accept(listener.socket)
    assert connection is not None
    for each in (*clients, connection, acceptor, listener):
        each.close()
