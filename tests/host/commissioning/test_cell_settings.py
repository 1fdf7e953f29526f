from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.commissioning.cell_settings import (
    CellSettings,
    Change,
    NotTakenError,
    StrangerError,
    apply_changes,
    check_identity,
    identify_cells,
)
from mdms_host.commissioning.network import Identity, RefusedError
from mdms_host.commissioning.parameters import (
    BY_NAME,
    PARAMETERS,
    WIRING,
    ParameterError,
    find_parameters,
    parse_assignments,
)
from mdms_protocol.dictionary import DEVICE_NAME, ENTRIES, PRODUCT_CODE, REVISION, VENDOR_ID


def test_every_stored_object_is_a_setting_under_a_name_of_its_own():
    stored = {(entry.index, entry.sub) for entry in ENTRIES.values() if entry.stored}
    assert {each.place for each in (*PARAMETERS, *WIRING)} == stored
    assert len(BY_NAME) == len(stored)


def test_wiring_agrees_with_the_coordinator():
    assert {each.entry.index for each in WIRING} & set(range(0x2000, 0x7000)) == set()
    assert {each.place for each in PARAMETERS} >= {(0x1017, 0), (0x2000, 0), (0x3000, 0)}


@pytest.mark.parametrize(
    ("name", "places"),
    [
        ("gain", [(0x2000, 0), (0x2800, 0)]),
        ("axis2.gain", [(0x2800, 0)]),
        ("Over-Current Time", [(0x2006, 0), (0x2806, 0)]),
        ("0x2001", [(0x2001, 0)]),
        ("0x2001:0", [(0x2001, 0)]),
        ("0x1016:2", [(0x1016, 2)]),
        ("setpoint_timeout", [(0x3000, 0)]),
        ("consumer_heartbeat_time_2", [(0x1016, 2)]),
    ],
)
def test_setting_goes_by_name_or_object(name, places):
    assert [each.place for each in find_parameters(name)] == places


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("gain=10", {10_000}),
        ("gain=12.5 V s/m", {12_500}),
        ("setpoint_timeout=0.05", {50}),
        ("observer_lag=2.75e-3", {2_750}),
        ("axis1.direction=-1.5707963", {-1_570_796}),
        ("0x1014=0x85", {0x85}),
        ("resolution=37595", {37_595}),
    ],
)
def test_values_are_in_si_units(text, numbers):
    assert set(parse_assignments([text]).values()) == numbers


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("gain", "expected KEY=VALUE"),
        ("gian=1", "did you mean gain"),
        ("gain=fast", r"axis1.gain: 'fast' is no number \[V s/m\]"),
        ("gain=nan", "is no number"),
        ("gain=100.001", r"axis1.gain: 100.001 is not in 0 to 100 V s/m"),
        ("gain=1e999999999", "is not in 0 to 100"),
        ("gain=-0.0001 V s/m", "is not in"),
        ("observer_lag=0.0001", "not in 0.001 to 0.02 s"),
        ("resolution=37595.5", "no whole number"),
        ("0x6041=1", "keeps no such setting"),
        ("statusword=1", "there is no such setting"),
        ("=1", "'': there is no such setting"),
    ],
)
def test_an_impossible_value_is_refused_with_the_possible_ones(text, told):
    with pytest.raises(ParameterError, match=told):
        parse_assignments([text])


def test_two_values_for_one_setting_contradict_each_other():
    assert len(parse_assignments(["gain=10", "axis1.gain=10.0"])) == 2
    with pytest.raises(ParameterError, match="given twice"):
        parse_assignments(["gain=10", "axis1.gain=11"])


@given(st.sampled_from((*PARAMETERS, *WIRING)), st.data())
def test_a_shown_value_means_the_same_when_it_is_set(parameter, data):
    number = data.draw(st.integers(parameter.entry.low, parameter.entry.high))
    assert parameter.parse(parameter.text(number)) == number
    assert parameter.parse(repr(parameter.si(number))) == number


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


def test_changes_are_the_differences():
    cell = read_back({GAIN: 10_000, TIMEOUT: 50})
    assert cell.changes({GAIN: 12_000, TIMEOUT: 50}) == [Change(1, GAIN, 10_000, 12_000)]


@pytest.mark.parametrize(("gain", "order"), [(5_000, [GAIN, LAG]), (12_000, [LAG, GAIN])])
def test_loop_has_its_margin_on_the_way_too(gain, order):
    cell = read_back({GAIN: 10_000, LAG: 2_750})
    for wanted in ({GAIN: gain, LAG: 3_000}, {LAG: 3_000, GAIN: gain}):
        assert [change.parameter for change in cell.changes(wanted)] == order


def read_back(values):
    return CellSettings(1, 7, values)


def test_a_cell_that_says_yes_and_does_otherwise_is_found_out(commissioning, monkeypatch):
    monkeypatch.setattr(commissioning, "write", lambda *_: None)
    with pytest.raises(NotTakenError, match=r"node 2, axis1.gain: 12 V s/m was .* 13 V s/m is"):
        apply_changes(commissioning, [Change(2, GAIN, 13_000, 12_000)])


def test_cells_of_one_serial_number_are_told(commissioning, monkeypatch):
    assert [each.serial for each in identify_cells(commissioning, [1, 2, 3]).values()] == [1, 2, 3]
    monkeypatch.setattr(commissioning, "identity", lambda _node: CELL)
    with pytest.raises(StrangerError, match="node 1 and node 2 have the same serial number"):
        identify_cells(commissioning, [1, 2])


def test_a_node_without_an_identity_is_no_cell(commissioning, monkeypatch):
    def refuse(_node):
        raise RefusedError

    monkeypatch.setattr(commissioning, "identity", refuse)
    assert identify_cells(commissioning, [1]) == {}
