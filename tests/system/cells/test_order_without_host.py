"""Parcels that have to pass each other when the host is killed, on 54 cells on three buses."""

from random import Random

import pytest
from tests.benchmarks.host.legs import FIRST_S, FOUND, SHARE, alone, winding

# In the first each of the two would stand before a cell that the other is on, without an order over
# cells; in the second one would come over a cell by a hair before its turn.
SEEDS = (1210, 3021)


@pytest.mark.parametrize("seed", SEEDS)
def test_parcels_that_pass_each_other_arrive_though_the_host_dies_on_the_way(seed: int) -> None:
    found, tasks, end_s = next(iter(winding(FOUND, seed)))
    assert found == seed
    outcomes = alone(tasks, seed, Random(f"legs {seed}").uniform(FIRST_S, FIRST_S + SHARE * end_s))
    assert outcomes == {"parcel 0": "arrived", "parcel 1": "arrived"}
