"""Of poses that look alike a parcel is found at the pose nearest to the told one."""

from math import degrees, pi, radians

import numpy as np
import pytest
from tests.host.estimation.lying import WHEELS, Lying

from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout

#: A hexagon as a drawing has it, in whole millimetres.
HEXAGON = (
    (0.17, 0.0),
    (0.085, 0.147),
    (-0.085, 0.147),
    (-0.17, 0.0),
    (-0.085, -0.147),
    (0.085, -0.147),
)


@pytest.mark.parametrize("seed", range(3))
def test_a_hexagon_is_found_turned_as_was_told_within_half_a_side(seed) -> None:
    random = np.random.default_rng(seed)
    for _ in range(4):
        x_m, y_m, yaw_rad = random.uniform((-0.3, -0.2, -pi), (0.3, 0.2, pi)).tolist()
        told_rad = yaw_rad + random.uniform(-radians(15.0), radians(15.0))
        parcel = Parcel("hexagon", 0.34, 0.294, (x_m, y_m), told_rad, "polygon", HEXAGON)
        table = Lying(Layout(9, 6, wheels=WHEELS), (parcel,))
        table.put("hexagon", parcel.footprint, x_m, y_m, yaw_rad)
        table.run(0.5)
        found = table.tracker.estimate("hexagon", table.now_s)
        assert abs(degrees(found.yaw_rad - yaw_rad)) < 30.0


@pytest.mark.parametrize("seed", range(2))
def test_a_box_that_lies_a_quarter_turn_from_the_told_way_is_believed_there(seed) -> None:
    """Its sides differ by less than their spread, and edges show which is the longer one."""
    x_m, y_m = np.random.default_rng(seed).uniform(-0.05, 0.05, 2)
    told = Parcel("box", 0.30, 0.265, yaw_hint_rad=0.0, spread_m=0.015)
    table = Lying(Layout(9, 6, wheels=WHEELS), (told,))
    table.put("box", told.footprint, x_m, y_m, pi / 2)
    table.run(0.4)
    for twist in ((0.04, 0.0, 0.0), (0.0, 0.04, 0.0)):
        table.run(1.5, {"box": twist})
    found = table.tracker.estimate("box", table.now_s)
    assert abs(degrees(found.yaw_rad) % 180.0 - 90.0) < 1.0
    size = table.tracker.size("box")
    assert size is not None
    assert (size.length_m, size.width_m) == pytest.approx((0.30, 0.265), abs=0.002)
