from math import pi

import numpy as np
import pytest

from mdms_host.estimation.footprint import Disc, Footprint, Rectangle
from mdms_host.motion.by_cells.reports import Elsewhere, Pose

STEP_S = 0.01
HERE = np.array([0.1, 0.0, 0.2])
BOX, DISC = Rectangle(0.36, 0.30), Disc(0.30)


def found(*theirs: Pose, footprint: Footprint = BOX, here_s: float = 1.0) -> list[float]:
    """When cells 1, 2, ... are found to be wrong that believe a parcel here, within a second.

    The host is sure of the place for so long.
    """
    parcel, times_s = Elsewhere(footprint), []
    for step in range(100):
        now_s = STEP_S * step
        pose = HERE if now_s < here_s else None
        if parcel.step(pose, dict(enumerate(theirs, 1)), now_s):
            times_s.append(now_s)
    return times_s


def test_two_cells_that_have_a_parcel_elsewhere_are_wrong_after_a_tenth_of_a_second() -> None:
    times_s = found((0.2, 0.0, 0.2), (0.1, -0.06, 0.2), (0.1, 0.0, 0.2))
    assert times_s[0] == pytest.approx(0.1)


def test_one_may_be_wrong_about_its_own_place() -> None:
    assert not found((0.2, 0.0, 0.2), (0.1, 0.0, 0.2), (0.1, 0.0, 0.2))


def test_no_cell_is_wrong_within_the_tolerance_of_host_and_cells() -> None:
    assert not found((0.13, 0.0, 0.25), (0.07, -0.02, 0.15))


def test_a_turn_counts_by_the_way_of_a_corner_and_not_where_it_looks_the_same() -> None:
    assert found((0.1, 0.0, 0.5), (0.1, 0.0, 0.5))
    assert not found((0.1, 0.0, 0.2 + pi), (0.1, 0.0, 0.2 - pi))
    assert not found((0.1, 0.0, 0.9), (0.1, 0.0, -1.3), footprint=DISC)


def test_nothing_is_wrong_while_the_host_is_not_sure() -> None:
    assert not found((0.2, 0.0, 0.2), (0.2, 0.0, 0.2), here_s=0.09)
