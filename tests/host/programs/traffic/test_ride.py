"""One parcel under way along its route."""

import numpy as np
import pytest
from tests.host.motion.driving import BOX, Table, mass_of, traction_of

from mdms_host.motion.goal import Goal
from mdms_host.motion.trajectory.path import Path
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.ride import Load, Ride
from mdms_host.routes.route import Route, Visits

NOWHERE = Visits(*(np.zeros(0, dtype=kind) for kind in (np.intp, *[float] * 4)))
POSES = np.array([(-0.05, 0.0, 0.0), (0.0, 0.02, 0.1)])


@pytest.mark.parametrize("off_m", [-1e-13, 0.0, 1e-13])
def test_a_way_that_is_free_to_its_end_ends_there_however_its_length_is_rounded(
    off_m: float,
) -> None:
    reach_m = BOX.bottom.reach_m
    along_m = np.array([0.0, Path(POSES, reach_m).length_m + off_m])
    route = Route("box", POSES, along_m, along_m[:1], along_m[1:], NOWHERE, reach_m)
    load = Load(BOX.bottom, mass_of(BOX))
    ride = Ride(Order("box", Goal(0.0, 0.02, 0.1)), route, load, traction_of())
    table = Table(POSES[0])
    for _ in range(300):
        table.step(lambda belief, step_s: ride.step(belief, step_s, route.length_m, room=True))
    assert ride.arrived
