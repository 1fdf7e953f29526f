"""A box of 0.28 x 0.22 m reaches one row of wheels only where it lies along and right above it."""

from math import pi

import numpy as np
import pytest
from tests.host.motion.believing import beliefs
from tests.host.motion.driving import LAYOUT, WHEELS

from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.footholds import MARGIN_M, Footholds
from mdms_host.motion.trajectory.path import Path
from mdms_host.motion.way_search import WaySearch

BOX = Parcel("box", 0.28, 0.22)
MIDDLE = (0.0, 0.0)
START, END = np.array([0.14, -0.014, 0.3]), np.array([-0.08, -0.026, -0.8])


def found(
    start: np.ndarray, end: np.ndarray, parcel: Parcel = BOX, layout: Layout = LAYOUT
) -> tuple[Path, int]:
    """The way, and in how many steps it is found."""
    belief = beliefs({"box": start}, [parcel])["box"]
    search = WaySearch(Footholds(layout, parcel.footprint, MIDDLE), belief, end)
    for steps in range(1, 100):
        path = search.step()
        if path is not None:
            return path, steps
    raise AssertionError("no way is found")


def least_m(path: Path, inset_m: float) -> float:
    """The least margin on a way."""
    along_m = np.linspace(0.0, path.length_m, 400)
    poses = np.array([path.pose_at(s_m) for s_m in along_m.tolist()])
    return float(Footholds(LAYOUT, BOX.footprint, MIDDLE).margins_m(poses, inset_m).min())


def test_a_box_that_would_tip_turns_elsewhere() -> None:
    straight = Path(np.array([START, END]), BOX.footprint.reach_m)
    assert least_m(straight, 0.002) < 0.0
    path, steps = found(START, END)
    assert least_m(path, 0.005) >= MARGIN_M
    assert path.length_m < 1.5 * straight.length_m
    assert steps < 20
    np.testing.assert_allclose(path.end, END, atol=1e-12)


def test_a_box_is_turned_to_cross_a_row() -> None:
    start, end = np.array([0.0, -0.06, 0.0]), np.array([0.05, 0.06, 0.0])
    path, _ = found(start, end)
    assert least_m(path, 0.005) >= MARGIN_M
    np.testing.assert_allclose(path.end, end, atol=1e-12)


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("width_m", [0.28, 0.30])
def test_a_box_that_stands_safely_everywhere_goes_straight_at_once(
    width_m: float, yaw_rad: float
) -> None:
    end = np.array([-0.2, 0.04, yaw_rad])
    path, steps = found(np.array([0.2, -0.05, -0.5]), end, Parcel("box", 0.28, width_m))
    assert (len(path.pieces), steps) == (1, 1)


def test_a_box_that_might_tip_only_beside_its_way_keeps_to_it() -> None:
    start, end = np.array([0.16, -0.01, -1.41]), np.array([-0.19, -0.03, 1.68])
    straight, _ = found(start, end)
    assert len(straight.pieces) == 1
    assert least_m(straight, 0.002) >= MARGIN_M
    assert least_m(straight, 0.006) < 0.006


def test_a_box_that_is_not_safe_where_it_stands_leaves_that_first() -> None:
    start, end = np.array([0.1, 0.005, 0.02]), np.array([-0.1, 0.01, pi / 2])
    path, _ = found(start, end)
    straight = Path(np.array([start, end]), BOX.footprint.reach_m)
    assert unsafe_m(path) < 0.5 * unsafe_m(straight)


def unsafe_m(path: Path) -> float:
    along_m = np.linspace(0.0, path.length_m, 400)
    poses = np.array([path.pose_at(s_m) for s_m in along_m.tolist()])
    margins_m = Footholds(LAYOUT, BOX.footprint, MIDDLE).margins_m(poses, 0.002)
    return path.length_m * float((margins_m < MARGIN_M).mean())


def test_where_no_way_is_safe_the_search_ends_with_one() -> None:
    narrow = Parcel("box", 0.28, 0.12)
    path, steps = found(np.array([0.1, 0.06, 0.0]), np.array([-0.1, 0.06, 0.0]), narrow)
    assert steps < 30
    np.testing.assert_allclose(path.end, (-0.1, 0.06, 0.0), atol=1e-12)


def test_on_a_row_and_to_an_unsafe_goal_the_way_is_straight() -> None:
    row = Layout(6, 1, wheels=tuple(WheelPlace(*wheel) for wheel in WHEELS))
    for layout, end in ((row, (-0.1, 0.0, 0.0)), (LAYOUT, (0.0, 0.3, 0.0))):
        path, steps = found(np.array([0.1, 0.03, 0.0]), np.array(end), layout=layout)
        assert (len(path.pieces), steps) == (1, 1)
