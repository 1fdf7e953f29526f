"""Fields add up, hold in regions, and take turns over the table."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.fields import FIELDS, FieldError, inside, references_m_s
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.motion import Part, Region

SCENARIO = load_scenario("array18")
WHEELS = build_wheels(SCENARIO)
LEFT = Region("rectangle", corners_m=((-1.0, -1.0), (0.0, 1.0)))

numbers = st.floats(-1.0, 1.0)
places = st.tuples(numbers, numbers)


@st.composite
def parts(draw, depth=2):
    """A field with any keys, or a sum or regions of such."""
    kinds = sorted(set(FIELDS) - {"table"}) + (["sum", "regions"] if depth else [])
    kind = draw(st.sampled_from(kinds))
    inner = ()
    if kind in ("sum", "regions"):
        inner = tuple(draw(st.lists(parts(depth=depth - 1), min_size=1, max_size=3)))
    region = draw(st.none() | st.builds(lambda c: Region("disc", centre_m=c, radius_m=1.5), places))
    return Part(
        kind,
        speed_m_s=draw(numbers),
        heading_rad=draw(numbers),
        centre_m=draw(places),
        velocity_m_s=draw(places),
        yaw_rate_rad_s=draw(numbers),
        gradient_per_s=(draw(places), draw(places)),
        width_m=0.3,
        exit_rad=draw(numbers),
        region=region,
        part=inner,
    )


def test_parts_of_a_sum_add_up():
    @given(st.lists(parts(), min_size=1, max_size=4))
    def add_up(inner):
        total = references_m_s(Part("sum", part=tuple(inner)), WHEELS)
        np.testing.assert_allclose(total, sum(references_m_s(p, WHEELS) for p in inner), atol=1e-12)

    add_up()


@given(parts(), parts())
def test_one_field_holds_in_a_region_and_another_elsewhere(one, other):
    one = replace(one, region=LEFT)
    both = references_m_s(Part("regions", part=(one, other)), WHEELS)
    left = inside(LEFT, WHEELS.position_m)
    np.testing.assert_array_equal(both[left], references_m_s(one, WHEELS)[left])
    np.testing.assert_array_equal(both[~left], references_m_s(other, WHEELS)[~left])


def test_where_two_regions_overlap_the_first_holds():
    fast, slow = (Part("uniform", speed_m_s=v, region=LEFT) for v in (0.2, 0.1))
    both = references_m_s(Part("regions", part=(fast, slow)), WHEELS)
    np.testing.assert_array_equal(both, references_m_s(fast, WHEELS))


def test_a_field_is_zero_outside_its_region():
    references = references_m_s(Part("uniform", speed_m_s=0.1, region=LEFT), WHEELS)
    left = WHEELS.position_m[:, 0] < 0.0
    np.testing.assert_array_equal(references[::2], np.where(left[::2], 0.1, 0.0))


def test_a_field_and_its_regions_move_along_with_the_array():
    shift_m = np.array([0.4, -0.7])
    there = replace(WHEELS, position_m=WHEELS.position_m + shift_m)

    def field(x_m, y_m):
        corners = tuple((a + x_m, b + y_m) for a, b in ((-0.2, -0.3), (0.3, -0.1), (0.0, 0.3)))
        disc = Region("disc", centre_m=(x_m + 0.1, y_m), radius_m=0.17)
        squeeze = Part("squeeze", speed_m_s=0.1, heading_rad=0.3, centre_m=(x_m, y_m), region=disc)
        inward = Part("inward", speed_m_s=0.2, centre_m=(x_m + 0.01, y_m + 0.01))
        region = Region("polygon", corners_m=corners)
        regions = Part("regions", region=region, part=(squeeze, inward))
        return Part("sum", part=(regions, Part("uniform", speed_m_s=0.05, heading_rad=1.0)))

    here_m_s = references_m_s(field(0.0, 0.0), WHEELS)
    np.testing.assert_allclose(references_m_s(field(*shift_m), there), here_m_s, atol=1e-12)
    assert len(np.unique(here_m_s.round(9))) > 5


def test_a_table_may_be_a_part():
    table = Part("table", table_m_s=tuple(np.linspace(-1, 1, 36)))
    uniform = Part("uniform", speed_m_s=0.1)
    total = references_m_s(Part("sum", part=(table, uniform)), WHEELS)
    np.testing.assert_allclose(total[::2], np.linspace(-1, 1, 36)[::2] + 0.1)


def test_an_unknown_field_is_refused_with_the_known_ones():
    with pytest.raises(FieldError, match=r"motion.part.0.field: .*'swirl'.*inward.*sum, regions"):
        references_m_s(Part("sum", part=(Part("swirl"),)), WHEELS)


def test_a_table_of_the_wrong_length_is_refused_by_its_key():
    inner = Part("sum", part=(Part("uniform"), Part("table", table_m_s=(0.1,))))
    with pytest.raises(FieldError, match=r"motion.part.0.part.1.field: .*36 wheels.*got 1"):
        references_m_s(Part("sum", part=(inner,)), WHEELS)


def test_a_region_beside_the_table_is_refused_with_where_wheels_are():
    away = Region("disc", centre_m=(3.0, 0.0), radius_m=0.5)
    with pytest.raises(FieldError, match=r"motion.part.0.region has none of the 36.*x -0.3475 to"):
        references_m_s(Part("sum", part=(Part("uniform", region=away),)), WHEELS)
