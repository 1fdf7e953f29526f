import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.host.motion.driving import LAYOUT, WHEELS

from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.footholds import Footholds
from mdms_model.outline import polygon_outline
from mdms_model.statics.support_margin import support_margins_m

BOX = Rectangle(0.28, 0.22)
SIDE_M = st.floats(0.1, 0.5)
BESIDE_M = st.floats(-0.05, 0.05)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), SIDE_M, SIDE_M, BESIDE_M, BESIDE_M)
def test_margins_are_those_of_the_model(
    seed: int, length_m: float, width_m: float, x_m: float, y_m: float
) -> None:
    poses = np.random.default_rng(seed).uniform((-0.4, -0.25, -3.0), (0.4, 0.25, 3.0), (50, 3))
    footprint = Rectangle(length_m, width_m)
    margins_m = Footholds(LAYOUT, footprint, (x_m, y_m)).margins_m(poses, 0.0)
    outline = polygon_outline(footprint.outline_m(np.zeros(3)))
    modelled_m = support_margins_m(LAYOUT.wheel_positions_m, outline, (x_m, y_m), poses)
    inside = modelled_m > 0.0
    np.testing.assert_allclose(margins_m[inside], modelled_m[inside], atol=1e-9)
    assert (margins_m[~inside] <= 1e-9).all()


def test_supports_count_so_far_inside_the_outline() -> None:
    # The row at 0.127 m lies 8 mm inside the long side of this box.
    pose = np.array([[0.0, 0.025, 0.0]])
    footholds = Footholds(LAYOUT, BOX, (0.0, 0.0))
    assert footholds.margins_m(pose, 0.007)[0] == pytest.approx(0.025)
    assert footholds.margins_m(pose, 0.009)[0] <= 0.0


def test_there_is_no_margin_beside_the_table() -> None:
    footholds = Footholds(LAYOUT, BOX, (0.0, 0.0))
    np.testing.assert_array_equal(footholds.margins_m(np.array([[2.0, 0.0, 0.0]]), 0.0), -np.inf)


def test_on_wheels_in_one_line_only_the_way_along_it_counts() -> None:
    row = Layout(6, 1, wheels=tuple(WheelPlace(*wheel) for wheel in WHEELS))
    footholds = Footholds(row, BOX, (0.01, 0.0))
    poses = np.array([(0.0, 0.0, 0.0), (0.1, 0.02, 0.0), (0.5, 0.0, 0.0)])
    outline = polygon_outline(BOX.outline_m(np.zeros(3)))
    modelled_m = support_margins_m(row.wheel_positions_m, outline, (0.01, 0.0), poses)
    assert modelled_m[0] > 0.05
    np.testing.assert_allclose(footholds.margins_m(poses, 0.0), modelled_m, atol=1e-9)
