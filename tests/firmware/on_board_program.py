"""A program on its way into a board's flash, and power that fails at any step; on MicroPython."""

import binascii
import os

import world
from bench import NODE, Bench, there

from boards import flash
from mdms_cell import speed_loop

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


def content():
    """The program that lies there, without its check sum."""
    with open("program.bin", "rb") as file:
        data = file.read()
    assert binascii.crc32(data[:-4]).to_bytes(4, "little") == data[-4:]
    return data[:-4]


def with_crc(data):
    return data + binascii.crc32(data).to_bytes(4, "little")


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
        download(flash.Program(".", lambda: True), OLD)
        power = Power(last)
        flash.os, flash.open = Disk(power), opener(power)
        try:
            download(flash.Program(".", lambda: True), NEW)
            complete = True
        except PowerLossError:
            flash.os, flash.open = os, open
            program = flash.Program(".", lambda: True)
            assert content() == (NEW if last >= power_steps() - 2 else OLD), last
            assert program.crc == binascii.crc32(content())
            assert not there("program.tmp")
        last += 1
    assert content() == NEW
    assert last > power_steps()
    flash.os, flash.open = os, open


def power_steps():
    """Opening, 13 pieces and the check sum, closing, a name for it, the old one gone, its name."""
    return 1 + 14 + 1 + 3


def opener(power):
    def opened(path, mode):
        return File(power, path) if mode == "wb" else open(path, mode)

    return opened


def test_power_that_fails_once_more_at_the_next_start_loses_nothing(bench):
    download(bench.board.program, NEW)
    os.rename("program.bin", "program.new")
    for last in range(2):
        with open("program.bin", "wb") as file:
            file.write(with_crc(OLD))
        flash.os = Disk(Power(last))
        try:
            flash.Program(".", lambda: True)
        except PowerLossError:
            assert there("program.new")
    flash.os = os
    assert flash.Program(".", lambda: True).crc == binascii.crc32(NEW)
    assert content() == NEW


def test_flash_that_fails_at_the_start_does_not_keep_the_cell_from_starting(bench):
    def refuse(*_arguments):
        raise OSError(5)

    download(bench.board.program, NEW)
    os.rename("program.bin", "program.new")
    disk = Disk(Power(None))
    disk.rename = refuse
    flash.os = disk
    program = flash.Program(".", lambda: True)
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
        file.write(b"more than a check sum")
    refuses(program.end)
    assert content() == OLD
    refuses(program.end)


def test_nothing_is_written_while_motors_may_turn(bench):
    bench.boot()
    program = bench.board.program
    program.begin(len(NEW))
    program.write(NEW[:100])
    bench.board.registers[speed_loop.MODE] = speed_loop.RUN
    for action in ((program.write, NEW[100:]), (program.end,), (program.begin, None)):
        refuses(*action)
    refuses(program.cancel)
    refuses(bench.board.settings.erase, 0)
    refuses(bench.board.settings.write, 0, 0, b"x")
    assert not there("program.bin")
    assert not there("settings0.bin")


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
    assert identification(bench) == binascii.crc32(OLD[:18])


def identification(bench):
    world.sent.clear()
    bench.can.deliver(0x600 + NODE, b"\x40\x56\x1f\x01\0\0\0\0")
    bench.pass_ms(3)
    return int.from_bytes(world.sent[-1][1][4:], "little")


def test_identification_is_that_of_what_lies_there_after_a_restart(bench):
    download(bench.board.program, NEW)
    bench.board.program = flash.Program(".", lambda: True)
    bench.boot()
    assert identification(bench) == binascii.crc32(NEW)


def test_damaged_program_has_no_identification(bench):
    whole = with_crc(NEW)
    damaged = [whole[:size] for size in (0, 1, 3, 4, 100, len(whole) - 1)]
    damaged += [whole + b"\0", b"\1" + whole[1:], whole[:-1] + b"\1", whole[:600] + whole[601:]]
    for data in damaged:
        with open("program.bin", "wb") as file:
            file.write(data)
        assert flash.Program(".", lambda: True).crc == 0, data
    os.remove("program.bin")
    assert flash.Program(".", lambda: True).crc == 0


def test_damaged_new_program_never_takes_the_place_of_a_whole_old_one(bench):
    download(bench.board.program, OLD)
    with open("program.new", "wb") as file:
        file.write(with_crc(NEW)[:-1])
    assert flash.Program(".", lambda: True).crc == binascii.crc32(OLD)
    assert content() == OLD
    assert not there("program.new")


def run(board, name):
    globals()[name](Bench(board))
    print("done")
