"""Two served buses have a door each, and nothing of one comes out at the other."""

import os
import resource
import threading
from contextlib import contextmanager
from types import SimpleNamespace

import can
import pytest

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.kernel import Kernel
from mdms_sim.serve.server import ServedAddresses, Server, ways_in

MS = 1_000_000
PATIENCE_S = 20.0


class Node:
    """Answers every frame with a frame that has its own number."""

    def __init__(self, bus, number):
        self.number = number
        self.controller = bus.attach(self)

    def on_frame(self, frame, now_ns):
        self.controller.send(Frame(0x700 + self.number, frame.data))


@contextmanager
def serving(path, **options):
    kernel, over = Kernel(), threading.Event()
    buses = [Bus(kernel), Bus(kernel)]
    for number, bus in enumerate(buses):
        Node(bus, number)
    simulation = SimpleNamespace(
        kernel=kernel, bus=buses[0], buses=buses, tipped=False, blinking=[]
    )

    def tick():
        kernel.at(kernel.now_ns + MS, 0, tick)

    tick()
    with Server(simulation, str(path), **options) as server:
        thread = threading.Thread(target=server.run, args=(over.is_set,))
        thread.start()
        try:
            yield server
        finally:
            over.set()
            thread.join()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "bus"


def test_each_bus_has_its_name_and_is_reached_by_it(path):
    with serving(path) as server:
        names = [each.channel for each in server.all_addresses]
        assert names == [f"{path}.0", f"{path}.1"]
        for number, name in enumerate(names):
            with can.Bus(name, interface="mdms") as client:
                client.send(can.Message(arbitration_id=0x10, data=b"?", is_extended_id=False))
                answer = client.recv(PATIENCE_S)
                assert (answer.arbitration_id, bytes(answer.data)) == (0x700 + number, b"?")
                # The other bus's node has not received it.
                assert client.recv(0.05) is None


@pytest.fixture
def many_files():
    """A program with more open files than `select` takes."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (2000, limits[1]))
    files = [os.open(os.devnull, os.O_RDONLY) for _ in range(1024)]
    yield
    for each in files:
        os.close(each)
    resource.setrlimit(resource.RLIMIT_NOFILE, limits)


@pytest.mark.usefixtures("many_files")
def test_a_program_with_many_open_files_reaches_a_bus(path):
    with serving(path), can.Bus(f"{path}.0", interface="mdms") as client:
        client.send(can.Message(arbitration_id=0x10, is_extended_id=False), timeout=PATIENCE_S)
        assert client.recv(PATIENCE_S).arbitration_id == 0x700


def test_each_bus_has_its_terminal_and_its_port(path):
    with serving(path, tcp_port=0) as server:
        assert len({each.device for each in server.all_addresses}) == 2
        for number, each in enumerate(server.all_addresses):
            url = f"socket://127.0.0.1:{each.tcp_port}"
            with can.Bus(url, interface="slcan", bitrate=1_000_000) as client:
                client.send(can.Message(arbitration_id=0x10, data=b"?", is_extended_id=False))
                assert client.recv(PATIENCE_S).arbitration_id == 0x700 + number


def test_lines_to_copy_have_the_bit_rate_of_the_bus():
    lines = ways_in(ServedAddresses("slow", "/dev/pts/1", 4001, 500_000))
    assert [line.endswith(" -b 500000") for line in lines] == [False, False, True, True]


def test_doors_are_shut_at_the_end(path):
    with serving(path):
        assert {each.name for each in path.parent.iterdir()} == {"bus.0", "bus.1"}
    assert not list(path.parent.iterdir())
