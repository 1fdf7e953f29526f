"""Every error code that a cell may send has its words."""

import re

import pytest

from mdms_cell import cell, runner
from mdms_cell.canopen import nmt, store
from mdms_cell.drive import axes
from mdms_cell.perception import suspicion
from mdms_protocol.emergencies import CODES, code_text, error_text

#: The codes that a cell sends, by the modules that send them.
SENT = {
    *(code for _bit, code in axes._ERROR_CODES),
    *(runner.BUS_OFF, runner.INTERNAL_ERROR, store.SETTINGS_LOST),
    *(nmt.HEARTBEAT_LOST, nmt.NODE_ID_TAKEN, nmt.RPDO_TOO_SHORT, nmt.RPDO_OVERDUE),
    *(suspicion.CODE, cell.IN_ANOTHERS_PLACE, axes.STOPPED_MEANWHILE),
}


def test_every_code_that_a_cell_sends_has_words():
    assert CODES.keys() == SENT


def test_every_code_that_the_fail_safe_table_lists_has_words(pytestconfig):
    table = (pytestconfig.rootpath / "docs" / "faults.md").read_text("utf-8")
    listed = {int(code, 16) for code in re.findall(r"(?:fault|EMCY) 0x([0-9A-F]{4})", table)}
    assert len(listed) >= 9
    assert listed <= CODES.keys()


@pytest.mark.parametrize(
    ("source", "code", "text"),
    [
        (1, 0x8250, "0x8250: no setpoint for 50 ms (axis 1)"),
        (6, 0x8140, "0x8140: bus off"),
        (9, 0x1234, "0x1234: a code that no cell of this version has"),
    ],
)
def test_words_of_a_code(source, code, text):
    assert error_text(source, code) == text
    assert text.startswith(code_text(code))
