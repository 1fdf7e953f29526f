"""One parcel under way along its route."""

from dataclasses import replace

import numpy as np
import pytest
from tests.host.motion.driving import BOX, Table, mass_of, traction_of

from mdms_host.estimation.belief import Belief
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.follower import Carried
from mdms_host.motion.trajectory.path import Path
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.ride import Load, Ride
from mdms_host.routes.reservations import REST_M
from mdms_host.routes.route import Route, Visits

NOWHERE = Visits(*(np.zeros(0, dtype=kind) for kind in (np.intp, *[float] * 4)))
POSES = np.array([(-0.05, 0.0, 0.0), (0.0, 0.02, 0.1)])
LENGTH_M = Path(POSES, BOX.footprint.reach_m).length_m


def ride_of(length_m: float) -> Ride:
    """A ride along the poses, with their length as the route has it."""
    along_m = np.array([0.0, length_m])
    route = Route("box", POSES, along_m, along_m[:1], along_m[1:], NOWHERE, BOX.footprint.reach_m)
    load = Load(BOX.footprint, mass_of(BOX))
    return Ride(Order("box", GoalPose(0.0, 0.02, 0.1)), route, load, traction_of())


@pytest.mark.parametrize("off_m", [-1e-13, 0.0, 1e-13])
def test_a_way_that_is_free_to_its_end_ends_there_however_its_length_is_rounded(
    off_m: float,
) -> None:
    ride = ride_of(LENGTH_M + off_m)
    table = Table(POSES[0])
    for _ in range(300):
        table.step(lambda belief, step_s: ride.step(belief, step_s, ride.route.length_m, moves=()))
    assert ride.arrived


def test_a_parcel_that_ends_its_way_beside_it_has_come_when_it_is_at_its_goal() -> None:
    ride, table = ride_of(LENGTH_M), Table(POSES[0])
    aside_m = np.array([0.0, 0.0, 0.0])

    def steered(belief: Belief, step_s: float) -> Carried | None:
        off = replace(belief, pose=belief.pose + aside_m)
        return ride.step(off, step_s, LENGTH_M, moves=())

    while not ride.has_come:
        # The belief goes wrong just as the way ends, until a sensor shows it.
        if ride.progress_m > LENGTH_M - 0.001:
            aside_m[1] = 0.009
        table.step(steered)
    aside_m[1] = 0.0
    assert ride.progress_m < LENGTH_M - REST_M
    for _ in range(300):
        table.step(steered)
    assert ride.arrived
    assert ride.progress_m > LENGTH_M - REST_M
