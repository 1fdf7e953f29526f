"""A controller by Modbus TCP alone: two boxes go north, and all chutes are full in between.

python examples/line/modbus_controller.py [PORT], beside `mdms serve examples/line/table.toml
--modbus 15020`. It needs nothing but Python.
"""

import itertools
import socket
import struct
import sys
import time

RESET, START, STOP = 1, 2, 3
STOPPED, IDLE, SUSPENDED, EXECUTE = 2, 4, 5, 6
ORDER, ASK, LEFT, ANY_YAW = 0, 3, 4, 0x8000
link = socket.create_connection(("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 15020))
beats = itertools.count(1)


def request(pdu: bytes) -> bytes:
    """The answer to a request."""
    link.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
    _, _, length, _ = struct.unpack(">HHHB", link.recv(7, socket.MSG_WAITALL))
    answer = link.recv(length - 1, socket.MSG_WAITALL)
    if answer[0] & 0x80:
        raise SystemExit(f"function {pdu[0]} is refused: exception {answer[1]}")
    return answer


def read(address: int, count: int = 1) -> tuple[int, ...]:
    """Registers, by function 3."""
    return struct.unpack(f">{count}H", request(struct.pack(">BHH", 3, address, count))[2:])


def write(address: int, *values: int) -> None:
    """Write registers, by function 16."""
    head = struct.pack(">BHHB", 16, address, len(values), 2 * len(values))
    request(head + struct.pack(f">{len(values)}H", *values))


def until(done, what: str) -> None:
    """Wait for something, and give the heartbeat meanwhile."""
    for _ in range(1200):
        write(100, next(beats) & 0xFFFF)
        if done():
            print(what, flush=True)
            return
        time.sleep(0.1)
    raise SystemExit(f"not {what} within two minutes; the table is in state {read(1)[0]}")


def command(number: int, state: int, what: str) -> None:
    """Give a command, and wait for the state that it leads to."""
    write(101, number, (read(103)[0] + 1) & 0xFFFF)
    until(lambda: read(1)[0] == state, what)


def order(kind: int, key: str, parcel: str, exit: int = 0) -> tuple[int, ...]:
    """Send a request: its counter, its result, and the state of the order."""
    texts = struct.unpack(">16H", key.encode().ljust(16, b"\0") + parcel.encode().ljust(16, b"\0"))
    write(200, (read(224)[0] + 1) & 0xFFFF, kind, exit, 0, 0, 0, ANY_YAW, *texts)
    return read(224, 3)


run = f"{time.time():.0f}"[-6:]
order(ORDER, f"{run}-1", "box 1", exit=1)
order(ORDER, f"{run}-2", "box 2", exit=1)
command(RESET, IDLE, "idle")
command(START, EXECUTE, "executing")
until(lambda: order(ASK, f"{run}-1", "")[2] == LEFT, "box 1 has left to the north")
write(105, 0b111)
until(lambda: read(1)[0] == SUSPENDED, "suspended: all chutes are full")
write(105, 0)
until(lambda: read(1)[0] == EXECUTE, "executing again")
until(lambda: order(ASK, f"{run}-2", "")[2] == LEFT, "box 2 has left, too")
command(STOP, STOPPED, "stopped")
