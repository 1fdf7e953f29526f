"""Registers are not widened where a word has 32 bits."""

import pytest

from mdms_image.narrow import narrow
from mdms_image.sources import source_of

SOURCE = "def f(r, w):\n    return (r[1] << w >> w) + (r[2] << 3 >> w) + (r[3] >> w << w)\n"


def test_what_is_shifted_up_and_down_again_is_left_as_it_is_on_32_bits():
    space = {}
    exec(narrow(SOURCE, "armv7emsp"), space)
    assert space["f"]([0, 5, 6, 7], 1) == 5 + (6 << 3 >> 1) + (7 >> 1 << 1)
    assert "<< w >> w" not in narrow(SOURCE, "armv7emsp")


@pytest.mark.parametrize("architecture", ["x64", None])
def test_64_bits_and_bytecode_keep_it(architecture):
    assert narrow(SOURCE, architecture) == SOURCE


def test_speed_loop_has_nothing_left_that_widens():
    source = source_of("mdms_cell.drive.speed_loop").read_text()
    assert source.count("<< widen >> widen") >= 5
    assert "<< widen" not in narrow(source, "armv7emsp")
