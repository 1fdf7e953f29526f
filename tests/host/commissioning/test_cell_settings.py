from dataclasses import replace

import pytest

from mdms_host.commissioning.cell_settings import (
    BY_NAME,
    CellSettings,
    Change,
    NotTakenError,
    StrangerError,
    apply_changes,
    check_identity,
    identify_cells,
    read_settings,
)
from mdms_host.commissioning.network import Identity, RefusedError
from mdms_protocol.dictionary import DEVICE_NAME, PRODUCT_CODE, REVISION, VENDOR_ID

GAIN, LAG = BY_NAME["axis1.gain"], BY_NAME["axis1.observer_lag"]
TIMEOUT = BY_NAME["setpoint_timeout"]
CELL = Identity(DEVICE_NAME, "0.1.0", VENDOR_ID, PRODUCT_CODE, REVISION, 7)


def test_a_stranger_and_a_cell_of_another_protocol_are_refused():
    check_identity(3, CELL)
    check_identity(3, replace(CELL, revision=REVISION + 1))
    with pytest.raises(StrangerError, match="node 3 is 'pump', not an MDMS cell"):
        check_identity(3, replace(CELL, name="pump"))
    with pytest.raises(StrangerError, match="node 3 speaks revision 2 of the protocol"):
        check_identity(3, replace(CELL, revision=0x00020000))


def test_changes_are_what_differs():
    cell = read_back({GAIN: 10_000, TIMEOUT: 50})
    assert cell.changes({GAIN: 12_000, TIMEOUT: 50}) == [Change(1, GAIN, 10_000, 12_000)]


@pytest.mark.parametrize(("gain", "order"), [(5_000, [GAIN, LAG]), (12_000, [LAG, GAIN])])
def test_loop_has_its_margin_on_the_way_too(gain, order):
    cell = read_back({GAIN: 10_000, LAG: 2_750})
    for wanted in ({GAIN: gain, LAG: 3_000}, {LAG: 3_000, GAIN: gain}):
        assert [change.parameter for change in cell.changes(wanted)] == order


def read_back(values):
    return CellSettings(1, 7, values)


def test_settings_are_read_changed_and_verified(commissioning):
    cell = read_settings(commissioning, 2, [GAIN, TIMEOUT])
    assert (cell.serial, cell.values) == (2, {GAIN: 13_000, TIMEOUT: 50})
    shares = []
    apply_changes(commissioning, cell.changes({GAIN: 12_500, TIMEOUT: 80}), shares.append)
    assert shares == [0.5, 1.0]
    again = read_settings(commissioning, 2, [GAIN, TIMEOUT])
    assert again.values == {GAIN: 12_500, TIMEOUT: 80}


def test_a_cell_that_says_yes_and_does_otherwise_is_found_out(commissioning, monkeypatch):
    monkeypatch.setattr(commissioning, "write", lambda *_: None)
    with pytest.raises(NotTakenError, match=r"node 2, axis1.gain: 12 V s/m was .* 13 V s/m is"):
        apply_changes(commissioning, [Change(2, GAIN, 13_000, 12_000)], lambda _share: None)


def test_what_is_stored_outlives_a_restart_until_the_defaults_are_restored(commissioning):
    commissioning.write(3, *GAIN.place, 9_000)
    commissioning.restart(3)
    assert commissioning.read(3, *GAIN.place) == 13_000
    commissioning.write(3, *GAIN.place, 9_000)
    commissioning.store(3)
    commissioning.restart(3)
    assert commissioning.read(3, *GAIN.place) == 9_000
    commissioning.restore_defaults(3)
    assert commissioning.read(3, *GAIN.place) == 13_000


def test_cells_of_one_serial_number_are_told(commissioning, monkeypatch):
    assert [each.serial for each in identify_cells(commissioning, [1, 2, 3]).values()] == [1, 2, 3]
    monkeypatch.setattr(commissioning, "identity", lambda _node: CELL)
    with pytest.raises(StrangerError, match="node 1 and node 2 have the same serial number"):
        identify_cells(commissioning, [1, 2])


def test_who_has_no_identity_is_no_cell(commissioning, monkeypatch):
    def refuse(_node):
        raise RefusedError

    monkeypatch.setattr(commissioning, "identity", refuse)
    assert identify_cells(commissioning, [1]) == {}
