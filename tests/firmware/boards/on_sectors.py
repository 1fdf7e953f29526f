"""Settings in sectors of a PYBv1.1, cut off wherever its flash is written; runs on MicroPython."""

import gc

import vfs
import world
from bench import Bench
from internal_flash import InternalFlash, PowerLost
from pyb import Flash
from refusal import code_of

from boards import flash, pybv11
from mdms_cell.canopen.objects import Objects
from mdms_cell.canopen.store import Store
from mdms_protocol import record
from mdms_protocol.codecs import sdo

ALL = record.STORED_COMMUNICATION | record.STORED_APPLICATION
NODE = 9
TIMEOUT = 0x3000
OLD, NEW = 77, 88


def always():
    return True


def memory():
    return pybv11.Sectors(always)


def restored(memory):
    """Node id and setpoint timeout that a cell has which starts with this memory."""
    store = Store(memory)
    objects = Objects()
    objects.reset(5, ALL | record.FROM_NODE)
    store.restore(objects, ALL)
    return store.node_id(), objects.number(TIMEOUT)


def save(memory, timeout_ms):
    store = Store(memory)
    objects = Objects()
    objects.reset(5, ALL | record.FROM_NODE)
    objects.put(TIMEOUT, 0, timeout_ms)
    store.save(objects, ALL)


def content_with(saves):
    """Flash in which the old settings have been saved so often: bank and sector change with it."""
    Store(memory()).save_node_id(NODE)
    for _ in range(saves):
        save(memory(), OLD)
    return bytes(world.flash.content)


def reboot(content, budget=None, seed=1):
    world.flash = None
    gc.collect()
    world.flash = InternalFlash(bytearray(content), seed)
    world.flash.budget = budget


def outcomes(content, change, stride=1):
    """The cell's settings at its start after a change, cut off at each operation; then uncut.

    A stride leaves operations out where there are thousands.
    """
    budget = 0
    cut = True
    while cut:
        reboot(content, budget, seed=budget + 1)
        try:
            change()
            cut = False
        except PowerLost:
            pass
        reboot(world.flash.content)
        yield restored(memory())
        budget += stride


def test_power_may_fail_at_any_erase_or_word_of_a_save():
    for saves in (1, 2):
        content = content_with(saves)
        found = list(outcomes(content, lambda: save(memory(), NEW)))
        assert len(found) > 8, found
        assert set(found[:-1]) <= {(NODE, OLD), (NODE, NEW)}, found
        assert found[0] == (NODE, OLD)
        assert found[-1] == (NODE, NEW)
        reboot(content)


def test_power_may_fail_while_the_node_id_is_saved():
    content = content_with(1)
    found = list(outcomes(content, lambda: Store(memory()).save_node_id(7)))
    assert set(found) == {(NODE, OLD), (7, OLD)}
    assert found[-1] == (7, OLD)


def test_saving_goes_on_after_any_cut():
    content = content_with(1)
    for settings in outcomes(content, lambda: save(memory(), NEW)):
        save(memory(), 99)
        reboot(world.flash.content)
        assert restored(memory()) == (NODE, 99), settings


def test_a_save_never_touches_the_file_system():
    content = content_with(1)
    system = content[: pybv11.BANKS[0]]
    for _ in outcomes(content, lambda: save(memory(), NEW)):
        assert world.flash.content[: len(system)] == system


def test_files_that_wait_in_the_cache_do_not_take_settings_along():
    content = content_with(1)

    def write_a_block_and_save():
        Flash(start=0).writeblocks(3, b"\x55" * 512)
        save(memory(), NEW)

    found = list(outcomes(content, write_a_block_and_save, 101))
    assert set(found) == {(NODE, OLD), (NODE, NEW)}
    assert found[-1] == (NODE, NEW)


def test_power_may_fail_at_any_erase_or_word_of_a_file_without_harm_to_settings():
    content = content_with(1)

    def write_a_file():
        device = Flash(start=0, len=pybv11.BANKS[0])
        vfs.mount(vfs.VfsFat(device), "/cut")
        try:
            with open("/cut/crash.log", "w") as file:
                file.write("a line\n" * 9)
        except OSError:
            pass
        finally:
            vfs.umount("/cut")
        device.ioctl(3, 0)

    found = list(outcomes(content, write_a_file, 307))
    assert len(found) > 4
    assert set(found) == {(NODE, OLD)}


class Worn(InternalFlash):
    """Flash with one stuck byte in each sector."""

    def _program(self):
        super()._program()
        self.content[self._start + 20] = 0


def test_byte_that_flash_does_not_take_is_noticed_though_the_cache_has_it():
    content_with(1)
    world.flash = Worn(world.flash.content)
    assert code_of(save, memory(), NEW) == sdo.HARDWARE_ERROR
    assert restored(memory()) == (NODE, OLD)


def test_nothing_is_written_where_the_file_system_leaves_no_room():
    content = content_with(1)
    for size in (0x8200, 0x1C000):
        world.flash = InternalFlash(bytearray(content))
        vfs.VfsFat.mkfs(Flash(start=0, len=size))
        world.flash.sync()
        before = bytes(world.flash.content)
        assert code_of(save, memory(), NEW) == sdo.HARDWARE_ERROR
        assert world.flash.content == before
        assert not world.flash.dirty


def test_settings_are_still_there_when_the_port_has_made_a_new_file_system_over_all():
    content_with(1)
    vfs.VfsFat.mkfs(Flash(start=0))
    world.flash.sync()
    assert restored(memory()) == (NODE, OLD)


def test_blank_flash_has_no_settings():
    world.flash = InternalFlash()
    assert restored(memory()) == (None, 50)
    assert code_of(save, memory(), NEW) == sdo.HARDWARE_ERROR


def test_nothing_is_written_while_a_bridge_is_awake():
    content_with(1)
    before = bytes(world.flash.content)
    awake = pybv11.Sectors(lambda: False)
    assert code_of(save, awake, NEW) == sdo.HARDWARE_ERROR
    assert bytes(world.flash.content) == before
    assert not world.flash.dirty


def test_room_is_made_without_the_settings_of_before():
    content_with(2)
    pybv11.make_room()
    assert restored(memory()) == (None, 50)


def test_two_files_on_this_flash_lose_both_whatever_the_file_system():
    """Why settings are no files here, and that the model of the flash shows it."""
    for system in (vfs.VfsFat, vfs.VfsLfs2):
        world.flash = InternalFlash()
        system.mkfs(Flash(start=0))

        def mounted(action, system=system):
            """The result of an action in a freshly mounted file system, None without one."""
            try:
                vfs.mount(system(Flash(start=0)), "/cut")
            except OSError:
                return None
            try:
                return action(flash.Settings("/cut", always))
            finally:
                vfs.umount("/cut")

        mounted(lambda files: (Store(files).save_node_id(NODE), save(files, OLD)))
        world.flash.sync()
        content = bytes(world.flash.content)
        lost = 0
        for budget in range(0, 60, 3):
            reboot(content, budget, seed=budget + 1)
            try:
                mounted(lambda files: save(files, NEW))
                world.flash.sync()
            except (PowerLost, sdo.AbortError, OSError):
                pass
            reboot(world.flash.content)
            try:
                lost += mounted(restored) not in ((NODE, OLD), (NODE, NEW))
            except OSError:
                lost += 1
        assert lost, system


def run(board, name):
    Bench(board)
    globals()[name]()
    print("done")
