"""How far a cell takes two parcels to be apart, beside the model's exact distance."""

from math import hypot
from random import Random

import pytest
from tests.firmware.neighbours.outlines import SHAPES, STEP_M, exact_m, outline

from mdms_cell.perception.outline import DISC, RECTANGLE, gap, overlaps_square


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


@pytest.mark.parametrize("seed", range(3))
def test_parcel_lies_over_every_square_that_it_reaches_and_over_no_other(seed) -> None:
    """The right of way goes by it: a square that is missed may be promised to another parcel."""
    random = Random(seed)
    found = {0: 0, 1: 0}
    for _ in range(400):
        pose = tuple(random.uniform(-b, b) for b in (0.25, 0.25, 3.1))
        parcel = (*random.choice(SHAPES), pose)
        half_m = random.choice((0.0635, 0.0695))
        apart, over = (
            exact_m(parcel, (RECTANGLE, 2 * side_m, 2 * side_m, (0.05, -0.03, 0.0)))
            for side_m in (half_m, half_m - 0.001)
        )
        place = (round(each / STEP_M) for each in (0.05, -0.03, half_m))
        believed = overlaps_square(outline(*parcel).registers, *place)
        if apart > 0.001:
            assert not believed, parcel
        if over <= 0.0:
            assert believed, parcel
        found[believed] += 1
    assert min(found.values()) > 60
