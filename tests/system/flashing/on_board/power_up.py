"""The power-up of a board, for the unix port: `power_up.py [rom] [main]`.

The port has no ROMFS partition; with `rom` there is one as ports/stm32/vfs_rom_ioctl.c of
MicroPython 1.29 has it for SPI flash: blocks are erased to ones, writing makes zeros of ones,
numbers below 0 are errors. Waiting and wear are left out. The content outlives the process in a
file, which is as whole as the flash would be. With `main`, the board's program is run.
"""

import os
import sys

import machine
import vfs

BLOCK = 4096
BLOCKS = 80
EINVAL = 22
OUTSIDE = sys.path[0]  # of a script, its folder
FILE = OUTSIDE + "/rom.bin"

# From now on it keeps the bytes that it gets.
machine.tell("on", "")
sys.path[0] = ""


rom = bytearray(BLOCK * BLOCKS if "rom" in sys.argv else 0)
segment = memoryview(rom)


def keep():
    with open(FILE, "wb") as file:
        file.write(rom)


def erase(at, end):
    if end > len(rom):
        return -EINVAL
    while at < end:
        rom[at : at + BLOCK] = b"\xff" * BLOCK
        at += BLOCK
    keep()
    return 4


def write(at, data):
    if at + len(data) > len(rom):
        return -EINVAL
    for place in range(len(data)):
        rom[at + place] &= data[place]
    keep()
    return 0


def rom_ioctl(request, *given):
    if request == 1:
        return 1
    if given[:1] == (0,):
        if request == 2:
            return segment
        if request == 3 and len(given) > 1:
            at = given[1] if len(given) > 2 else 0
            return erase(at, at + given[-1])
        if request == 4 and len(given) > 2:
            return write(given[1], given[2])
        if request == 6:
            return BLOCK
    return -EINVAL


class Vfs:
    """The module `vfs` with the parts that the port lacks."""

    VfsRom = vfs.VfsRom
    mount = vfs.mount
    umount = vfs.umount
    rom_ioctl = rom_ioctl


def plug_rom():
    """Mount the partition as MicroPython does before anything else is imported."""
    with open(FILE, "rb") as file:
        file.readinto(rom)
    sys.modules["vfs"] = Vfs
    try:
        vfs.mount(vfs.VfsRom(segment), "/rom")
        sys.path += ["/rom", "/rom/lib"]
    except OSError:
        pass


def run_main():
    """Run `main.py`, which alone is interrupted, in the name space that the prompt has then."""
    with open("main.py") as file:
        program = compile(file.read(), "main.py", "exec")
    machine.interruptible = True
    machine.tell("main", "")
    machine.tell("up", "")
    try:
        exec(program, globals())
    finally:
        machine.interruptible = False
        os.remove(OUTSIDE + "/main")


if "rom" in sys.argv:
    plug_rom()
if "main" in sys.argv:
    run_main()
else:
    machine.tell("up", "")
