"""A controller by Modbus TCP: brings the table to Execute, has a box leave to the north, and stops.

python examples/line/modbus_controller.py PORT, beside the table that `docs/line.md` serves.
"""

import itertools
import socket
import struct
import sys
import time

RESET, START, STOP = 1, 2, 3
STOPPED, IDLE, EXECUTE = 2, 4, 6
ORDER, ASK, NORTH, ANY_YAW, LEFT = 0, 3, 1, 0x8000, 4
link = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
# The next heartbeat, command or request needs a number that is not the last one.
numbers = (number & 0xFFFF for number in itertools.count(int(time.time())))
# The key of the order, and the parcel: 16 characters each, two in a register.
texts = struct.unpack(">16H", f"{time.time():<16.0f}{'box 1':16}".encode())


def exchange(address: int, *values: int, result: int) -> int:
    """Write registers from an address on, then read one as the result, by function 23."""
    count = len(values)
    pdu = struct.pack(f">BHHHHB{count}H", 23, result, 1, address, count, 2 * count, *values)
    link.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
    (length,) = struct.unpack(">4xHx", link.recv(7, socket.MSG_WAITALL))
    function, *answer = link.recv(length - 1, socket.MSG_WAITALL)
    if function != 23:
        raise SystemExit(f"register {address} is refused: exception {answer[0]}")
    return answer[1] << 8 | answer[2]


def state() -> int:
    """Give the heartbeat; returns the state of the table."""
    return exchange(100, next(numbers), result=1)


def command(number: int, wanted: int, name: str) -> None:
    """Give a command, and wait for the state that it leads to."""
    if exchange(101, number, next(numbers), result=104) != 0:
        raise SystemExit(f"the table does not get {name}: the command is refused")
    while state() != wanted:
        time.sleep(0.1)
    print(name, flush=True)


def order(request: int) -> int:
    """Order the box to the north, or ask for that order; returns its state."""
    return exchange(200, next(numbers), request, NORTH, 0, 0, 0, ANY_YAW, *texts, result=226)


order(ORDER)
command(RESET, IDLE, "idle")
command(START, EXECUTE, "executing")
while order(ASK) != LEFT:
    state()
    time.sleep(0.1)
print("the box has left to the north", flush=True)
command(STOP, STOPPED, "stopped")
