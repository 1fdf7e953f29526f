"""Runs a cell on its board, and never leaves the motors on.

The motors are cut first when the loop ends, for any reason. Then the reason goes to the bus and
into `crash.log`. After that the watchdog is no longer fed and resets the board.
"""
# The stubs know no StringIO as a file.
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false

import gc
import io
import os
import sys
import time

from boards import flash
from mdms_cell.cell import Cell
from mdms_cell.runner import INTERNAL_ERROR, Runner
from mdms_protocol.version import VERSION

#: Of a cell whose node id was never set; LSS gives it one.
NODE_UNSET = 0xFF
FAREWELL_MS = 20
LOG_MAX = 8192


def run(board, slots=None, folder="/flash", node_id=NODE_UNSET, watchdog=True):
    """Run the cell until something goes wrong, and raise that with the motors cut.

    Firmware comes over the bus into `slots` where flash is such that power may fail meanwhile.
    """
    if slots is not None and flash.keeps_whole(folder):
        slots.may_write = board.asleep
        board.slots = slots
    cell = None
    try:
        cell = Cell(board, node_id)
        runner = Runner(board, cell)
        gc.collect()  # the start leaves garbage between the lasting objects
        board.start(runner.tick, watchdog)
        while True:
            runner.turn(time.ticks_ms())
    except BaseException as error:
        board.stop()
        if cell is not None:
            say_farewell(board, cell)
        # A reset while the log is written may cost the whole file system.
        board.wait_for_flash()
        log(error, folder)
        board.feed()
        raise
    finally:
        board.stop()


def say_farewell(board, cell):
    """Report the error to the bus, if there is still a way."""
    try:
        cell.fail(INTERNAL_ERROR)
        start_ms = time.ticks_ms()
        while time.ticks_diff(time.ticks_ms(), start_ms) < FAREWELL_MS:
            board.service(time.ticks_ms())
            cell.poll(time.ticks_ms())
    except Exception as error:
        sys.print_exception(error)


def log(error, folder):
    """Append version and traceback to `crash.log`, which begins anew when it has grown too long.

    An error that the log ends with is not told again: a cell that fails at every start would wear
    its flash out within a day.
    """
    path = folder + "/crash.log"
    try:
        told = io.StringIO()
        print("mdms", VERSION, file=told)
        sys.print_exception(error, told)
        data = told.getvalue().encode()
        if not ends_with(path, data):
            with open(path, "ab" if size(path) < LOG_MAX else "wb") as file:
                file.write(data)
    except (OSError, MemoryError) as failure:
        sys.print_exception(failure)


def ends_with(path, data):
    """Whether a file ends with these bytes; a power cut may have left it with any others."""
    before = size(path) - len(data)
    if before < 0:
        return False
    with open(path, "rb") as file:
        file.seek(before)
        return file.read() == data


def size(path):
    """Bytes in a file, 0 if there is none."""
    try:
        return os.stat(path)[6]
    except OSError:
        return 0
