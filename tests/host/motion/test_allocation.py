import numpy as np

from mdms_host.estimation.footprint import Rectangle
from mdms_host.motion.carrying import FREE, WheelClaim, allocate

BOX = Rectangle(0.30, 0.20)


def claim(x_m: float, *, parked: bool) -> WheelClaim:
    return WheelClaim(BOX, np.array([x_m, 0.0, 0.0]), parked)


def serves(*claims: WheelClaim, at_m: float) -> int:
    return int(allocate(np.array([[at_m, 0.0]]), claims)[0])


def test_a_wheel_far_from_all_parcels_is_free() -> None:
    assert serves(claim(0.0, parked=False), at_m=0.21) == FREE
    assert serves(claim(0.0, parked=True), at_m=0.17) == FREE
    assert serves(at_m=0.0) == FREE


def test_a_wheel_ahead_of_a_parcel_that_moves_runs_already() -> None:
    assert serves(claim(0.0, parked=False), at_m=0.19) == 0


def test_of_two_that_move_the_nearer_has_the_wheel() -> None:
    movers = claim(-0.18, parked=False), claim(0.18, parked=False)
    assert [serves(*movers, at_m=at_m) for at_m in (-0.01, 0.01)] == [0, 1]


def test_a_wheel_under_or_close_to_a_parked_parcel_holds_it_beside_any_other() -> None:
    mover, parked = claim(-0.16, parked=False), claim(0.16, parked=True)
    for at_m in (0.02, 0.005):
        assert serves(mover, parked, at_m=at_m) == 1
        assert serves(parked, mover, at_m=at_m) == 0
    overlapping = claim(-0.10, parked=False)
    assert serves(overlapping, parked, at_m=0.03) == 1


def test_a_parked_parcel_leaves_wheels_beside_it_to_one_that_moves() -> None:
    assert serves(claim(-0.16, parked=False), claim(0.16, parked=True), at_m=-0.005) == 0
