"""How far a cell takes two parcels to be apart, beside the model's exact distance."""

from math import hypot
from random import Random

import pytest

from mdms_cell.perception.angle import ARM_UM
from mdms_cell.perception.outline import DISC, RECTANGLE, STEP_UM, Outline, gap
from mdms_model.outline import gap_m, outline_m
from mdms_model.scenario.scenario import Parcel

STEP_M = STEP_UM * 1e-6
SHAPES = ((RECTANGLE, 0.30, 0.28), (RECTANGLE, 0.40, 0.26), (DISC, 0.30, 0.30))


def outline(shape, length_m, width_m, pose) -> Outline:
    one = Outline()
    one.set(shape, round(length_m * 1e6), round(width_m * 1e6))
    x_m, y_m, yaw_rad = pose
    one.place(round(x_m * 1e6), round(y_m * 1e6), round(yaw_rad * ARM_UM))
    return one


def exact_m(one, other) -> float:
    """The distance of the model's outlines, by the axes of their sides."""
    outlines = []
    for shape, length_m, width_m, pose in (one, other):
        kind = "disc" if shape == DISC else "rectangle"
        parcel = Parcel(name="box", mass_kg=1.0, length_m=length_m, width_m=width_m, shape=kind)
        outlines.append(outline_m(pose, parcel))
    return gap_m(*outlines)


@pytest.mark.parametrize("seed", range(3))
def test_parcels_are_no_farther_apart_than_their_outlines(seed) -> None:
    """A cell may take them for nearer, corner to corner, and for no more than 1 mm farther."""
    random = Random(seed)
    near = 0
    for _ in range(300):
        one, other = (
            (*random.choice(SHAPES), tuple(random.uniform(-b, b) for b in (0.25, 0.25, 3.1)))
            for _ in range(2)
        )
        believed_m = gap(outline(*one).registers, outline(*other).registers) * STEP_M
        true_m = exact_m(one, other)
        if true_m > 0.0:
            assert believed_m < true_m + 0.001
            near += believed_m > 0.0
    assert near > 20


def test_discs_are_as_far_apart_as_their_rims() -> None:
    one, other = ((DISC, 0.3, 0.3, place) for place in ((0.0, 0.0, 0.3), (0.3, 0.2, 0.0)))
    apart_m = gap(outline(*one).registers, outline(*other).registers) * STEP_M
    assert apart_m == pytest.approx(hypot(0.3, 0.2) - 0.3, abs=0.001)
