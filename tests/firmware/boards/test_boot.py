"""The work of `main.py` before any firmware runs, on real MicroPython."""

from pathlib import Path

import pytest

from mdms_host.flashing.firmware import rom_image

ROOT = Path(__file__).parents[3]
FAKES = ROOT / "tests" / "firmware" / "fakes"
FILES = (
    ROOT / "firmware" / "main.py",
    FAKES / "machine.py",
    FAKES / "pin_names.py",
    FAKES / "world.py",
    FAKES / "can_bx.py",
    FAKES / "can_controller.py",
    FAKES / "can_stm32.py",
)
IMAGE = {"cell_of_the_slot.py": b"NAME = __file__\n"}
ENTER = """
import sys
import main, world
class Slots:
    on_trial = %r
    def start(self):
        return %r
try:
    main.enter(Slots())
    import cell_of_the_slot
    print(cell_of_the_slot.NAME)
except Exception as error:
    print(type(error).__name__)
print(world.told, sys.path[0])
"""


@pytest.mark.parametrize(
    ("on_trial", "image", "printed"),
    [
        (False, IMAGE, ["/slot/cell_of_the_slot.py", "[] /slot"]),
        (True, IMAGE, ["/slot/cell_of_the_slot.py", "[('watchdog', 10000)] /slot"]),
        # The watchdog handles firmware that is signed and yet cannot be started.
        (True, b"no file system", ["OSError", "[('watchdog', 10000)] "]),
        (False, None, ["ImportError", "[] "]),
    ],
)
def test_firmware_of_a_slot_is_imported_and_one_on_trial_watched_from_its_first_line_on(
    micropython, on_trial, image, printed
):
    pytest.importorskip("mpremote", reason="mpremote is not installed")
    made = rom_image(image) if isinstance(image, dict) else image
    assert micropython(ENTER % (on_trial, made), *FILES).splitlines() == printed


SLOTS = """
import main, os
class System:
    def statvfs(self, path):
        if block is None:
            raise OSError("no such folder")
        return (block,)
for block in (None, 512, 4096):
    main.os = System()
    print(main.slots_of_board() is not None)
"""


def test_only_a_file_system_on_the_blocks_of_flash_has_slots(micropython):
    assert micropython(SLOTS, *FILES) == "False\nFalse\nTrue\n"
