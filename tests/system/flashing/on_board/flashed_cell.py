"""Power-up of a board whose flash is a file, or its first formatting; on MicroPython.

`flashed_cell.py FLASH READ_FD WRITE_FD TELL_FD CUT` runs the firmware in the flash, as MicroPython
does on a board, and is cut off at that operation on the flash (-1: never); `flashed_cell.py FLASH
FOLDER` makes a file system with the files of the folder.
"""

import os
import sys

import vfs
from file_flash import FileFlash


def fill(chip, folder):
    """Format the chip, and copy the folder into it."""
    vfs.VfsLfs2.mkfs(chip, progsize=256)
    vfs.mount(vfs.VfsLfs2(chip, progsize=256), "/flash")
    copy(folder, "/flash")
    vfs.umount("/flash")


def copy(source, target):
    for name, kind, *_ in os.ilistdir(source):
        if kind & 0x4000:
            os.mkdir(target + "/" + name)
            copy(source + "/" + name, target + "/" + name)
            continue
        with open(source + "/" + name, "rb") as read, open(target + "/" + name, "wb") as write:
            write.write(read.read())


def power_up(chip):
    """Mount the flash as mimxrt does, and run `main.py`."""
    vfs.mount(vfs.VfsLfs2(chip, progsize=256), "/flash")
    sys.path.insert(0, "/flash")
    with open("/flash/main.py") as file:
        exec(file.read(), {"__name__": "__main__"})


if len(sys.argv) == 3:
    fill(FileFlash(sys.argv[1], print), sys.argv[2])
else:
    teller = open(int(sys.argv[4]), "wb")  # noqa: SIM115 - open as long as the process lives
    cut = int(sys.argv[5])
    power_up(
        FileFlash(
            sys.argv[1],
            lambda text: teller.write(text.encode() + b"\n"),
            None if cut < 0 else cut,
        )
    )
