"""Starts the cell's firmware at power-up: that of a slot, or the firmware from USB.

`docs/boards.md` has the way to the prompt. Firmware that came over the bus never
replaces this file and `mdms_boot`. A watchdog watches a slot on trial from its first line on. If
the slot does not feed it, the board starts again without that slot.
"""

import os
import sys

#: Firmware is imported within this time, with much to spare.
TRIAL_START_MS = 10_000
ROOT, SLOT = "/flash", "/slot"
#: Of flash chips; a file system on other blocks keeps nothing when power fails.
ERASE_BLOCK = 4096


def slots_of_board():
    """The board's slots; None where there is no room for any."""
    try:
        block = os.statvfs(ROOT)[0]
    except OSError:
        return None
    if block < ERASE_BLOCK:
        return None
    from mdms_boot.files import Files
    from mdms_boot.slots import Slots

    return Slots(Files(ROOT))


def enter(slots):
    """Have imports come from the slot that is to be started, if there is one."""
    image = slots.start()
    if image is None:
        return
    import vfs

    if slots.on_trial:
        from machine import WDT

        WDT(timeout=TRIAL_START_MS)
    vfs.mount(vfs.VfsRom(image), SLOT)  # pyright: ignore[reportAttributeAccessIssue]
    sys.path.insert(0, SLOT)


def begin(slots):
    """Run the firmware on this board, unless its button is held."""
    from boards.detect import board_module
    from boards.start import log, run

    module = board_module(sys.implementation._machine)
    if module.held():
        return
    try:
        board = module.board()
    except Exception as error:
        log(error, ROOT)
        raise
    run(board, slots)


if __name__ == "__main__":
    slots = slots_of_board()
    if slots is not None:
        enter(slots)
    begin(slots)
