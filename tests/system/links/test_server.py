"""The refusals of a server of an array, and its end; no program drives its cells."""

import os
import resource
import signal
import socket
from contextlib import suppress
from pathlib import Path

import can
import pytest
from tests.system.links.heartbeats import PATIENCE_S, all_heartbeats, listen

from mdms_sim.serve.packet import HELLO

pytestmark = pytest.mark.xdist_group("server")


@pytest.fixture(scope="module")
def alone(serve_array):
    """A server of this module; its last test ends it."""
    return serve_array(name="alone")


def test_nothing_served_under_a_name_is_told_with_a_cure(alone):
    done = alone.run("mdms", "scan", "-i", "mdms", "-c", "nobody")
    assert done.returncode == 4
    assert "mdms serve array18" in done.stderr
    assert "Traceback" not in done.stderr


def test_second_server_of_a_name_is_refused(alone):
    done = alone.run("mdms", "serve", "array18", "--name", alone.channel)
    assert done.returncode == 1
    assert "in use" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_sockets_go_with_the_server_however_it_is_ended(serve_array, number):
    array = serve_array(name=f"ended-by-{number}")
    path = Path(array.environment["XDG_RUNTIME_DIR"]) / "mdms" / f"{array.channel}.sock"
    assert path.is_socket()
    array.process.send_signal(number)
    _, said = array.process.communicate(timeout=PATIENCE_S)
    # A machine that is too busy is reported.
    said = [line for line in said.splitlines() if "too busy" not in line]
    assert (array.process.returncode, said) == (0, [])
    assert not path.exists()


def test_server_goes_on_and_refuses_when_it_is_out_of_file_descriptors(alone):
    with can.Bus(interface="mdms", channel=alone.channel) as bus:
        # A thread that waits in accept() holds a number that is not listed.
        highest = max(map(int, os.listdir(f"/proc/{alone.process.pid}/fd")))
        limit = highest + 1 + 3
        resource.prlimit(alone.process.pid, resource.RLIMIT_NOFILE, (limit, limit))
        path = os.path.join(alone.environment["XDG_RUNTIME_DIR"], "mdms", "alone.sock")
        many = [socket.socket(socket.AF_UNIX) for _ in range(12)]
        for one in many:
            one.settimeout(PATIENCE_S)
            one.connect(path)
        greetings = []
        for one in many:
            with suppress(ConnectionResetError):
                greetings.append(one.recv(len(HELLO)))
        assert greetings[:3] == [HELLO] * 3
        assert HELLO not in greetings[3:]
        for one in many:
            one.close()
        assert all_heartbeats(listen(bus, all_heartbeats))
    assert "refused: no file descriptor" in alone.stop()
