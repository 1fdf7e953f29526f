"""A program on its way into a board's flash, and power that fails at any step; on MicroPython."""

import os

import world
from bench import NODE, Bench

from boards import flash

OLD = b"the program before" * 30
NEW = bytes(range(256)) * 5


class PowerLossError(Exception):
    """The supply is gone."""


class Power:
    """Counts what is done to flash, and fails at the step `last`, if any."""

    def __init__(self, last):
        self.last = last
        self.steps = 0

    def step(self):
        if self.steps == self.last:
            raise PowerLossError
        self.steps += 1


class Disk:
    """`os` on FAT, where no file takes another's place."""

    def __init__(self, power):
        self._power = power
        self.stat = os.stat

    def rename(self, old, new):
        assert not there(new), "FAT does not rename onto a file"
        self._power.step()
        os.rename(old, new)

    def remove(self, path):
        self._power.step()
        os.remove(path)


class File:
    """A file of which half a piece may be written when power fails."""

    def __init__(self, power, path):
        self._power = power
        power.step()
        self._file = open(path, "wb")  # noqa: SIM115 - what is tested closes it

    def write(self, data):
        self._file.write(data[: len(data) // 2])
        self._file.flush()
        self._power.step()
        return len(data) // 2 + self._file.write(data[len(data) // 2 :])

    def close(self):
        self._power.step()
        self._file.close()


def there(path):
    try:
        os.stat(path)
    except OSError:
        return False
    return True


def content():
    with open("program.bin", "rb") as file:
        return file.read()


def download(program, data):
    program.begin(len(data))
    for start in range(0, len(data), 100):
        program.write(data[start : start + 100])
    program.end()


def refuses(action, *arguments):
    try:
        action(*arguments)
    except OSError:
        return
    raise AssertionError("not refused")


def test_old_program_stays_until_all_of_the_new_one_is_there(bench):
    program = bench.board.program
    download(program, OLD)
    assert content() == OLD
    program.begin(None)
    program.write(NEW)
    assert content() == OLD
    download(program, NEW)
    assert content() == NEW
    assert not there("program.tmp")
    assert not there("program.new")


def test_power_that_fails_at_any_step_leaves_one_of_the_two(bench):
    last = 0
    complete = False
    while not complete:
        flash.os, flash.open = os, open
        download(flash.Program(".", lambda: False), OLD)
        power = Power(last)
        flash.os, flash.open = Disk(power), opener(power)
        try:
            download(flash.Program(".", lambda: False), NEW)
            complete = True
        except PowerLossError:
            flash.os, flash.open = os, open
            flash.Program(".", lambda: False)
            assert content() == (NEW if last >= power_steps() - 2 else OLD), last
            assert not there("program.tmp")
        last += 1
    assert content() == NEW
    assert last > power_steps()
    flash.os, flash.open = os, open


def power_steps():
    """Opening, 13 pieces, closing, a name for the whole file, the old one gone, its name."""
    return 1 + 13 + 1 + 3


def opener(power):
    def opened(path, mode):
        return File(power, path) if mode == "wb" else open(path, mode)

    return opened


def test_power_that_fails_once_more_at_the_next_start_loses_nothing(bench):
    download(bench.board.program, NEW)
    os.rename("program.bin", "program.new")
    for last in range(2):
        with open("program.bin", "wb") as file:
            file.write(OLD)
        flash.os = Disk(Power(last))
        try:
            flash.Program(".", lambda: False)
        except PowerLossError:
            assert there("program.new")
    flash.os = os
    flash.Program(".", lambda: False)
    assert content() == NEW


def test_flash_that_fails_at_the_start_does_not_keep_the_cell_from_starting(bench):
    def refuse(*_arguments):
        raise OSError(5)

    download(bench.board.program, NEW)
    os.rename("program.bin", "program.new")
    disk = Disk(Power(None))
    disk.rename = refuse
    flash.os = disk
    program = flash.Program(".", lambda: False)
    refuses(program.begin, None)
    flash.os = Disk(Power(None))
    download(program, OLD)
    assert content() == OLD
    flash.os = os


def test_flash_that_does_not_hold_what_was_written_is_refused(bench):
    program = bench.board.program
    download(program, OLD)
    program.begin(len(NEW))
    program.write(NEW)
    with open("program.tmp", "ab") as file:
        file.write(b"x")
    refuses(program.end)
    assert content() == OLD
    refuses(program.end)


def test_nothing_is_written_while_motors_may_turn(bench):
    bench.boot()
    program = bench.board.program
    program.begin(len(NEW))
    program.write(NEW[:100])
    bench.drive(100_000)
    refuses(program.write, NEW[100:])
    refuses(program.end)
    assert not there("program.bin")


def test_sdo_download_ends_in_the_file(bench):
    bench.boot()
    world.sent.clear()
    begin = b"\x21\x50\x1f\x01\x12\0\0\0"
    for frame in (begin, b"\x00the pro", b"\x10gram be", b"\x07fore\0\0\0"):
        bench.can.deliver(0x600 + NODE, frame)
        bench.pass_ms(3)
    answers = [data[0] for can_id, data in world.sent if can_id == 0x580 + NODE]
    assert answers == [0x60, 0x20, 0x30, 0x20], world.sent
    assert content() == OLD[:18]


def run(board, name):
    globals()[name](Bench(board))
    print("done")
