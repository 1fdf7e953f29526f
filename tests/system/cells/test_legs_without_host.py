"""A way of several legs; the cells take each leg that follows while the host is gone."""

import numpy as np
import pytest
from tests.system.cells.neighbour_host import Box, Run, run, scenario_of

from mdms_protocol.neighbours import frames as wire

#: East, then north, then east again and turned, on 4 x 3 cells, each in about a second.
WAY = ((-0.03, 0.0, 0.0), (-0.03, 0.03, 0.0), (0.0, 0.03, 0.1))
GONE_S = 1.2
#: Three short legs, after which sequence numbers come round again, then one to cells in the fifth
#: column that nobody has told which leg the others are on.
LONG_WAY = ((-0.12, 0.0, 0.0), (-0.12, 0.01, 0.0), (-0.11, 0.01, 0.0), (0.10, 0.0, 0.0))


@pytest.fixture(scope="module")
def alone() -> Run:
    box = Box((-0.06, 0.0, 0.0), WAY[0], flags=wire.GO_ON, legs=WAY[1:])
    scenario = scenario_of([box], 4, 3, faults=[f'{{kind="host", start_s={GONE_S}}}'])
    return run(scenario, [box], 5.7)


def test_box_gets_to_the_end_of_its_way_though_the_host_dies_on_the_first_leg(alone: Run) -> None:
    record = alone.record
    gone_m = record.pose[record.time_s >= GONE_S][0, 0]
    assert gone_m[0] < -0.035
    assert alone.arrived()
    assert alone.stands()


def test_it_goes_by_the_corners_and_cuts_none(alone: Run) -> None:
    x_m, y_m, _ = alone.record.pose[:, 0].T
    for corner_x_m, corner_y_m, _ in WAY[:2]:
        assert np.hypot(x_m - corner_x_m, y_m - corner_y_m).min() < 0.005


def test_cells_that_it_comes_to_after_several_legs_take_it_on_and_not_back() -> None:
    box = Box((-0.127, 0.0, 0.0), LONG_WAY[0], speed_m_s=0.2, flags=wire.GO_ON, legs=LONG_WAY[1:])
    scenario = scenario_of([box], 5, 3, faults=['{kind="host", start_s=0.9}'])
    done = run(scenario, [box], 8.0, still_after_s=4.0)
    assert done.arrived()
    assert done.stands()
    x_m, time_s = done.record.pose[:, 0, 0], done.record.time_s
    assert (np.diff(x_m[time_s > 3.0]) > -1e-4).all()
