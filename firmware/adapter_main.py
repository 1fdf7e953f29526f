"""Makes the board an SLCAN adapter over USB; copied as `main.py` instead of the cell's.

Hold the user button at power-up to get the prompt instead. Both wheels stay off.
"""

import gc
import sys
import time

from boards.detect import board_module
from mdms_adapter.adapter import Adapter
from mdms_adapter.ports import port
from mdms_cell.queues import Inbox

#: Frames that may wait while the program does something else: 60 ms of a full bus.
INBOX_SIZE = 512


def run(board, line):
    """Carry frames until the board is switched off."""
    bus = board.bus
    bus.inbox = Inbox(INBOX_SIZE)
    bus.listen(None)
    adapter = Adapter(bus, line, board.serial)
    gc.collect()
    bus.start()
    while True:
        now_ms = time.ticks_ms()
        adapter.turn(now_ms)
        board.show(now_ms, adapter.state, adapter.lost)


if __name__ == "__main__":
    module = board_module(sys.implementation._machine)
    if not module.held():
        run(module.board(), port())
