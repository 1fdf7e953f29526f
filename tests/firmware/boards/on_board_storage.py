"""When a board writes to flash, and its behaviour without flash to write; on MicroPython.

The faked flash counts as stopping the processor whenever a sector is erased or a word programmed.
"""

import hashlib

import world
from bench import NODE, Bench
from internal_flash import InternalFlash

from mdms_boot.files import Files
from mdms_boot.slots import Slots
from mdms_cell.cell import Cell
from mdms_cell.update import key_id, sign
from mdms_protocol import pdo
from mdms_protocol.codecs import bundle, cia402, sdo
from mdms_protocol.version import VERSION

KEY = bytes(range(32))
SAVE = b"\x23\x10\x10\x01save"


def operational(bench):
    """The board with an operational cell; what stops its processor from here on is counted."""
    bench.boot()
    bench.can.deliver(0x000, bytes((1, NODE)))
    bench.pass_ms(2)
    stops = []

    def on_stop():
        assert not world.levels[bench.wake], "a bridge is awake while flash is written"
        stops.append(world.now_ms)

    world.flash.on_stop = on_stop
    return stops


def enable(bench):
    """All that it takes to enable both axes, and targets for a while."""
    for word in (cia402.SHUTDOWN, cia402.SWITCH_ON, cia402.ENABLE_OPERATION):
        bench.can.deliver(0x300 + NODE, pdo.CONTROLWORD.encode((word, word)))
        bench.pass_ms(2)
    for _ in range(20):
        for encoder, step in zip(bench.encoders, (4, -4)):  # noqa: B905 - MicroPython has no strict
            world.counts[encoder] = world.counts.get(encoder, 0) + step
        bench.target(100_000)
        bench.pass_ms()
        world.sent.clear()


def test_settings_are_saved_right_after_the_motors_were_on_with_the_bridges_asleep(bench):
    stops = operational(bench)
    enable(bench)
    for _ in range(50):  # the wheels come to stand
        bench.target(100_000)
        bench.pass_ms()
    assert world.levels[bench.wake]
    world.told.clear()
    # Both frames lie in the inbox before the next turn, and no tick comes in between.
    bench.can.deliver(0x300 + NODE, pdo.CONTROLWORD.encode((0, 0)))
    bench.can.deliver(0x600 + NODE, SAVE)
    bench.runner.turn(world.now_ms)
    if stops:
        assert world.told == [("watchdog", 5000)]
    bench.pass_ms(3)
    answer = b"\x60\x10\x10\x01\0\0\0\0" if stops else b"\x80\x10\x10\x01\x20\0\0\x08"
    assert (0x580 + NODE, answer) in world.sent
    assert bool(stops) == (bench.board.settings is not None)
    assert not world.flash.dirty


def test_node_id_is_not_saved_while_motors_are_on(bench):
    stops = operational(bench)
    enable(bench)
    bench.can.deliver(0x7E5, b"\x04\x01\0\0\0\0\0\0")
    bench.can.deliver(0x7E5, b"\x17\0\0\0\0\0\0\0")
    bench.pass_ms(3)
    assert (0x7E4, bytes((0x17, 2, 0, 0, 0, 0, 0, 0))) in world.sent
    assert not stops
    assert not world.flash.dirty
    assert not bench.off()


def test_only_flash_that_can_be_read_after_a_cut_save_keeps_settings(bench):
    assert (bench.board.settings is None) == (bench.name == "nucleo_g474re")


def test_node_id_and_settings_are_there_after_the_power_was_off(bench):
    operational(bench)
    bench.can.deliver(0x600 + NODE, b"\x2b\x00\x30\x00\x4d\x00\x00\x00")
    bench.pass_ms(2)
    bench.can.deliver(0x600 + NODE, SAVE)
    for data in (b"\x04\x01", b"\x11\x09", b"\x17\x00"):
        bench.pass_ms(2)
        bench.can.deliver(0x7E5, data + bytes(6))
    bench.pass_ms(2)
    if bench.name == "pybv11":
        world.flash = InternalFlash(world.flash.content)
    cell = Cell(bench.module.board(), NODE)
    saved = bench.name != "nucleo_g474re"
    assert cell.node_id == (9 if saved else NODE)
    sent = []
    cell._board.send = lambda can_id, data: sent.append((can_id, data)) or True
    for now_ms in (0, 50):
        cell.poll(now_ms)
    cell.on_frame(0x600 + cell.node_id, b"\x40\x00\x30\x00\0\0\0\0", 0)
    assert sent[-1][1][4] == (77 if saved else 50)


def test_firmware_goes_into_flash_with_the_bridges_asleep_and_is_started_by_a_reset(bench):
    if not has_room(bench):
        bench.boot()
        assert bench.board.slots is None
        return
    stops = operational(bench)
    assert bench.board.slots_room() > 0
    send_firmware(bench)
    assert stops
    bench.pass_ms(100)
    assert "reset" in world.told
    slots = Slots(Files("/flash"))
    slots._files.unpack = lambda path: b"the image"
    assert slots.start() == b"the image"
    assert slots.on_trial


def test_bridges_stay_asleep_while_firmware_comes_in_right_after_the_motors_were_on(bench):
    if not has_room(bench):
        return
    stops = operational(bench)
    enable(bench)
    for _ in range(50):  # the wheels come to stand
        bench.target(100_000)
        bench.pass_ms()
    bench.can.deliver(0x300 + NODE, pdo.CONTROLWORD.encode((0, 0)))
    bench.pass_ms(3)
    assert world.levels[bench.wake]
    send_firmware(bench)
    assert stops


def has_room(bench):
    """Whether a board takes firmware over the bus; such a board has the array's key from now."""
    if bench.name not in ("teensy41", "weact_h743"):
        return False
    with open("/flash/update.key", "wb") as file:
        file.write(KEY)
    return True


def send_firmware(bench):
    """Clear, bring a bundle by segments, and start it."""
    write(bench, b"\x2f\x51\x1f\x01\x03")
    sent = bundle_of(bench.board, bytes([number * 7 & 0xFF for number in range(600)]))
    write(bench, b"\x21\x50\x1f\x01" + len(sent).to_bytes(4, "little"))
    for start in range(0, len(sent), 7):
        piece = sent[start : start + 7]
        command = (start // 7 & 1) << 4 | (7 - len(piece)) << 1 | (start + 7 >= len(sent))
        write(bench, bytes((command,)) + piece)
    write(bench, b"\x2f\x51\x1f\x01\x01")


def write(bench, data):
    """An SDO request that is not refused."""
    world.sent.clear()
    bench.can.deliver(0x600 + NODE, data + bytes(8 - len(data)))
    bench.pass_ms(2)
    (answer,) = [data for can_id, data in world.sent if can_id == 0x580 + NODE]
    assert answer[0] != sdo.ABORT, answer


def bundle_of(board, packed):
    """A signed bundle for a board."""
    digest = hashlib.sha256(packed).digest()
    version = bundle.version_number(VERSION)
    fields = (0, board.bytecode, 1 << board.number, version, 1, len(packed), 1000)
    signed = bundle.pack(bundle.Head(*fields, key_id(KEY), digest))
    return signed + sign(KEY, signed) + packed


def run(board, name):
    globals()[name](Bench(board))
    print("done")
