"""TCP ports for servers that a test starts by their number."""

import os
import socket
from itertools import count

#: Linux takes the ports of outgoing connections from 32768 up. So no client of another test takes
#: one of these between its choice and the start of the server.
FIRST, PORTS = 10_000, 20_000

#: Each process begins elsewhere, since two that choose at once would both find a port free.
_numbers = count(os.getpid() * 101)


def free_port() -> int:
    """A port of this machine on which nothing listens."""
    while True:
        port = FIRST + next(_numbers) % PORTS
        try:
            with socket.create_server(("127.0.0.1", port)):
                return port
        except OSError:
            continue
