"""The kernel's pseudo-terminal as a client and the server have it."""

import fcntl
import os
import tty
from array import array
from contextlib import closing
from termios import FIONREAD

import pytest

from mdms_sim.serve.endpoint import Terminal

LINE = b"t20180011223344556677\r"
TIMES = 300


@pytest.fixture
def ends():
    """A terminal and its two ends: the server's, and the end that a client has opened."""
    with closing(Terminal()) as terminal:
        client = os.open(terminal.name, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(client)
        yield terminal, terminal.descriptor, client
        os.close(client)


def waiting(descriptor):
    """Bytes that could be read now; asking moves none, as reading would."""
    count = array("i", [0])
    fcntl.ioctl(descriptor, FIONREAD, count)
    return count[0]


@pytest.mark.parametrize("towards", ["server", "client"])
def test_all_that_was_written_has_arrived_once_the_terminal_has_settled(ends, towards):
    terminal, server, client = ends
    source, target = (client, server) if towards == "server" else (server, client)
    for _ in range(TIMES):
        os.write(source, LINE)
        terminal.settle()
        assert waiting(target) == len(LINE)
        assert os.read(target, len(LINE)) == LINE


def test_a_client_that_does_not_read_holds_nobody_up(ends):
    terminal, server, client = ends
    for _ in range(TIMES):
        os.write(server, LINE)
        terminal.settle()
    assert os.read(client, len(LINE)) == LINE
