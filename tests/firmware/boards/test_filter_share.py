"""Acceptance filters of the boards in the traffic of 18 cells that steer."""

import pytest
from tests.benchmarks.firmware.filters import LAYOUT, PLACES, accepted, mean_share, share


@pytest.mark.parametrize(
    ("controller", "most"),
    [("bxCAN", 0.125), ("FDCAN of a G4", 0.001), ("FDCAN of an H7, FlexCAN", 0.0)],
)
def test_share_that_software_drops(controller, most):
    mean = mean_share(PLACES[controller], LAYOUT.node_ids)
    assert mean.dropped <= most


def test_cell_behind_few_filters_may_drop_more_than_half_of_the_bus_and_no_other_does():
    """42 identifiers share 7 places, and one filter of an unlucky cell lets nearly all in."""
    assert max(len(accepted(number)) for number in LAYOUT.node_ids) == 42
    at_parcel = (1, 2, 3, 4, 7, 8, 9, 10, 13, 14, 15, 16)
    worst = {
        controller: max(share(number, places, at_parcel).dropped for number in LAYOUT.node_ids)
        for controller, places in PLACES.items()
    }
    assert worst["bxCAN"] < 0.6
    assert worst["FDCAN of a G4"] < 0.01
    assert worst["FDCAN of an H7, FlexCAN"] == 0.0
