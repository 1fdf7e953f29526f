"""Settings in files of a LittleFS, cut off wherever the chip is written; runs on MicroPython.

The file system is MicroPython's own, the chip is faked.
"""

import gc
import os

import vfs
from nor_flash import BLOCK, NorFlash
from refusal import code_of

from boards import flash
from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.store import Store
from mdms_protocol import record

ALL = record.STORED_COMMUNICATION | record.STORED_APPLICATION
NODE = 9
TIMEOUT = 0x3000
OLD, NEW = 77, 88
FOLDER = "/cut"
#: As mimxrt mounts its flash, and stm32 SPI flash.
SIZES = ({"progsize": 256}, {})


def always():
    return True


def mounted(chip, action, sizes):
    """The result of an action with the chip's file system in the folder."""
    vfs.mount(vfs.VfsLfs2(chip, **sizes), FOLDER)
    try:
        return action(flash.memory(FOLDER, always))
    finally:
        vfs.umount(FOLDER)
        gc.collect()


def restored(memory):
    store = Store(memory)
    objects = Objects()
    objects.reset(5, ALL | record.FROM_NODE)
    store.restore(objects, ALL)
    return store.node_id(), objects.number(TIMEOUT)


#: Settings enough for LittleFS to give them a block instead of a place in their directory: mapping
#: entries that no PDO counts.
MANY = [(0x1602, 0x1603, 0x1A02, 0x1A03)[number % 4] << 8 | number // 4 + 1 for number in range(32)]
MANY += [(0x1600, 0x1601, 0x1A00)[number % 3] << 8 | number // 3 + 4 for number in range(15)]
MANY += [0x200200, 0x280200, 0x200400, 0x280400, 0x608300, 0x688300, 0x608400, 0x688400]
MANY += [0x101601, 0x101602, 0x607500, 0x687500, 0x200000, 0x280000, 0x101500, 0x101700]


def save(memory, timeout_ms, more=()):
    objects = Objects()
    objects.reset(5, ALL | record.FROM_NODE)
    objects.put(TIMEOUT, 0, timeout_ms)
    for entry in more:
        objects.put(entry >> 8, entry & 0xFF, timeout_ms)
    Store(memory).save(objects, ALL)


def save_new(memory):
    save(memory, NEW)


def save_much(memory):
    save(memory, NEW, MANY)


def chip_with(saves, sizes):
    """The content of a chip on which the old settings have been saved so often."""
    chip = NorFlash()
    vfs.VfsLfs2.mkfs(chip, **sizes)

    def first(memory):
        Store(memory).save_node_id(NODE)
        for _ in range(saves):
            save(memory, OLD)

    mounted(chip, first, sizes)
    return bytes(chip.content)


def outcomes(content, action, sizes):
    """A cell's settings at its start, by the operation that was cut off; then uncut."""
    found = []
    cut = True
    while cut:
        chip = NorFlash(content, seed=len(found) + 1)
        chip.budget = len(found)
        code_of(mounted, chip, action, sizes)
        cut = chip.budget < 0
        found.append(mounted(NorFlash(chip.content), restored, sizes))
    return found


def test_power_may_fail_at_any_erase_or_page_of_a_save():
    for sizes in SIZES:
        for action in (save_new, save_much):
            for saves in (1, 2):
                found = outcomes(chip_with(saves, sizes), action, sizes)
                assert set(found) == {(NODE, OLD), (NODE, NEW)}, found
                assert found[-1] == (NODE, NEW)
            assert action is save_new or len(found) > 6, found


def test_power_may_fail_while_the_directory_is_erased():
    sizes = SIZES[0]
    erasing = 0
    for saves in range(1, 24):
        content = chip_with(saves, sizes)
        chip = NorFlash(content)
        mounted(chip, save_new, sizes)
        if chip.erases:
            erasing += 1
            found = outcomes(content, save_new, sizes)
            assert set(found) == {(NODE, OLD), (NODE, NEW)}, found
            assert found[-1] == (NODE, NEW)
    assert erasing


def test_power_may_fail_while_the_node_id_is_saved():
    for sizes in SIZES:
        content = chip_with(1, sizes)
        found = outcomes(content, lambda memory: Store(memory).save_node_id(7), sizes)
        assert set(found) == {(NODE, OLD), (7, OLD)}, found
        assert found[-1] == (7, OLD)


def test_only_a_littlefs_on_blocks_that_are_erased_for_themselves_keeps_settings():
    class Ram(NorFlash):
        """Blocks of 512 bytes that nothing erases, as the stm32 port has internal flash."""

        def ioctl(self, operation, argument):
            return {4: len(self.content) // 512, 5: 512}.get(operation, 0)

        def readblocks(self, block, buffer, offset=0):
            return super().readblocks(0, buffer, block * 512 + offset)

        def writeblocks(self, block, data, offset=0):
            at = block * 512 + offset
            self.content[at : at + len(data)] = data
            return 0

    assert BLOCK > 512
    for system, chip, kept in (
        (vfs.VfsLfs2, NorFlash(), True),
        (vfs.VfsLfs2, Ram(), False),
        (vfs.VfsFat, Ram(), False),
    ):
        system.mkfs(chip)
        vfs.mount(system(chip), FOLDER)
        assert (flash.memory(FOLDER, always) is not None) == kept
        vfs.umount(FOLDER)
    assert flash.memory(FOLDER, always) is None


class Asked:
    """A file that notes how many bytes it is asked for; MicroPython finds room for all of them."""

    sizes = ()

    def __init__(self, path, mode):
        self._file = open(path, mode)  # noqa: SIM115 - closed as it is left

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self._file.close()

    def read(self, size):
        Asked.sizes += (size,)
        return self._file.read(size)


def test_settings_ask_for_no_more_memory_than_they_fill():
    memory = flash.Settings(".", always)
    memory.erase(0)
    memory.write(0, 0, bytes(300))
    flash.open = Asked
    try:
        assert len(memory.read(0)) == 300
    finally:
        del flash.open
    assert Asked.sizes == (300,)


def test_settings_survive_and_a_broken_write_does_not_count():
    memory = flash.Settings(".", always)
    memory.erase(0)
    memory.write(0, 0, b"abc")
    memory.write(0, 3, b"def")
    assert memory.read(0) == b"abcdef"
    memory.erase(1)
    assert memory.read(1) == b""
    try:
        memory.write(1, 5, b"x")
    except OSError:
        return
    raise AssertionError("a gap was written")


def test_nothing_is_written_while_a_bridge_is_awake():
    memory = flash.Settings(".", lambda: False)
    for write in (lambda: memory.erase(0), lambda: memory.write(0, 0, b"abc")):
        try:
            write()
        except OSError:
            continue
        raise AssertionError("flash was written")
    assert not [name for name in os.listdir(".") if name.startswith("settings")]


def run(_board, name):
    globals()[name]()
    print("done")
