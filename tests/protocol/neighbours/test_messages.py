"""Estimates and pages as values: there and back, and refused before they are sent."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_protocol.entry import OutOfRangeError
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import messages


@st.composite
def made(draw, kinds):
    kind = draw(st.sampled_from(kinds))
    limits = messages._LIMITS[kind]
    made = kind(**{name: draw(st.integers(*limits[name])) for name in kind._fields})
    if kind is messages.Goal:
        # A leg is one of those that there are.
        made = made._replace(leg=draw(st.sampled_from((wire.JOINS, *range(made.legs + 1)))))
    return made


@given(made((messages.Estimate,)))
def test_estimate_is_decoded_as_encoded(estimate):
    assert messages.decode_estimate(messages.encode_estimate(estimate)) == estimate


@given(made((messages.Parcel, messages.Place, messages.Goal, messages.End, messages.Lost)))
def test_page_is_decoded_as_encoded(page):
    assert messages.decode_page(messages.encode_page(page)) == page
    assert type(messages.decode_page(messages.encode_page(page))) is type(page)


@given(
    st.builds(
        messages.Precedence,
        st.integers(0, 3),
        st.integers(1, 255),
        st.integers(1, 255),
        st.lists(st.integers(1, 63), max_size=5).map(tuple),
    )
)
def test_order_over_a_cell_is_decoded_as_encoded(order):
    data = messages.encode_page(order)
    assert messages.decode_page(data) == order
    assert data[0] & wire.IDENTITY_MAX == 0


@given(st.binary(max_size=12))
def test_garbage_decodes_to_nothing_or_to_fields_that_encode_again(data):
    estimate = messages.decode_estimate(data)
    if estimate is not None:
        assert messages.encode_estimate(estimate) == data
    page = messages.decode_page(data)
    if page is not None:
        assert messages.decode_page(messages.encode_page(page)) == page


@pytest.mark.parametrize(
    ("page", "says"),
    [
        (messages.Goal(1, 1, 131_072, 0, 0, 0, 0), r"Goal\.x: 131072 is not in -131072\.\.131071"),
        (messages.Place(64, 1, 0, 0, 0), r"Place\.identity: 64 is not in 1\.\.63"),
        (messages.Parcel(1, 1, 2, 0, 0, 1, 1, 0), r"Parcel\.shape: 2 is not in 0\.\.1"),
        (messages.Parcel(1, 1, 0, 9, 9, 0, 1, 0), r"Parcel\.acceleration: 0 is not in 1\.\.255"),
        (messages.Parcel(1, 1, 0, 9, 9, 1, 0, 0), r"Parcel\.speed: 0 is not in 1\.\.255"),
        (messages.Goal(1, 1, 0, 0, 0, leg=3, legs=2), r"Goal\.leg: 3 is not in 0\.\.2, and not 7"),
        (messages.End(1, 0), r"End\.sequence: 0 is not in 1\.\.3"),
        (messages.Precedence(0, 0, 1, ()), r"Precedence\.column: 0 is not in 1\.\.255"),
        (messages.Precedence(0, 1, 1, (64,)), r"Precedence\.identities: 64 is not in 1\.\.63"),
        (messages.Precedence(0, 1, 1, (1,) * 6), r"Precedence\.identities: 6, more than 5"),
    ],
)
def test_page_that_does_not_fit_is_refused(page, says):
    with pytest.raises(OutOfRangeError, match=says):
        messages.encode_page(page)


def test_estimate_that_does_not_fit_is_refused():
    estimate = messages.Estimate(0, 0, 2048, 1, 1, 0, 1, 4, 1, 0)
    with pytest.raises(OutOfRangeError, match=r"Estimate\.yaw: 2048 is not in -2048\.\.2047"):
        messages.encode_estimate(estimate)
