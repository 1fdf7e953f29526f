"""Parcels that have to pass each other when the host is killed, on 54 cells on three buses."""

from random import Random

from tests.benchmarks.host.legs import FIRST_S, FOUND, SHARE, alone, winding

SEED = 1210


def test_parcels_that_pass_each_other_arrive_though_the_host_dies_on_the_way() -> None:
    # Without an order over cells each of the two would stand before a cell that the other is on.
    found, tasks, end_s = next(iter(winding(FOUND, SEED)))
    assert found == SEED
    outcomes = alone(tasks, SEED, Random(f"legs {SEED}").uniform(FIRST_S, FIRST_S + SHARE * end_s))
    assert outcomes == {"parcel 0": "arrived", "parcel 1": "arrived"}
