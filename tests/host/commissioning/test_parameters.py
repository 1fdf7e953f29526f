import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_host.commissioning.cell_settings import (
    BY_NAME,
    PARAMETERS,
    WIRING,
    ParameterError,
    find_parameters,
    parse_assignments,
)
from mdms_protocol.dictionary import ENTRIES


def test_every_stored_object_is_a_setting_under_a_name_of_its_own():
    stored = {(entry.index, entry.sub) for entry in ENTRIES.values() if entry.stored}
    assert {each.place for each in (*PARAMETERS, *WIRING)} == stored
    assert len(BY_NAME) == len(stored)


def test_wiring_is_what_the_coordinator_relies_on():
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
    ],
)
def test_what_cannot_be_is_refused_with_what_can(text, told):
    with pytest.raises(ParameterError, match=told):
        parse_assignments([text])


def test_two_values_for_one_setting_contradict_each_other():
    assert len(parse_assignments(["gain=10", "axis1.gain=10.0"])) == 2
    with pytest.raises(ParameterError, match="given twice"):
        parse_assignments(["gain=10", "axis1.gain=11"])


@given(st.sampled_from((*PARAMETERS, *WIRING)), st.data())
def test_what_is_shown_means_the_same_when_it_is_set(parameter, data):
    number = data.draw(st.integers(parameter.entry.low, parameter.entry.high))
    assert parameter.parse(parameter.text(number)) == number
    assert parameter.parse(repr(parameter.si(number))) == number
