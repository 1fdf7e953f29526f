"""A parcel on three buses: the host carries it over both borders."""

import math
from collections import defaultdict

import pytest

from mdms_array.simulation import run_scenario
from mdms_model.run.folder import START_S
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob


def array54(*overrides):
    return load_scenario("array54", list(overrides))


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    log = tmp_path_factory.mktemp("run") / "bus.log"
    run = run_scenario(array54("run.duration_s=5.5", "array.forwarded=[1]"), bus_log=log)
    return run, log.read_text().splitlines()


def test_box_reaches_its_goal_over_the_borders_of_buses(carried):
    run, _ = carried
    x_m, y_m, yaw_rad = run.record.pose[-1, 0]
    assert run.status == "reached"
    assert math.hypot(x_m - 0.35, y_m - 0.15) < 0.005
    assert abs(math.degrees(yaw_rad) - 30) < 2
    assert run.bus.errors == 0


def test_cells_of_all_three_buses_have_driven_it(carried):
    run, _ = carried
    driven = (abs(run.record.reference_m_s) > 0).any(axis=0).reshape(6, 9, 2)
    assert all(driven[:, first : first + 3].any() for first in (0, 3, 6))


def test_every_bus_has_its_own_sync_at_the_same_instant(carried):
    _, log = carried
    times_s = defaultdict(list)
    for line in log:
        time, name, frame = line.split()
        if frame.startswith(f"{cob.SYNC:03X}#"):
            times_s[name].append(float(time.strip("()")) - START_S)
    assert {*times_s} == {"can0", "can1", "can2"}
    # Where a bus is busy at that instant, SYNC waits for the end of the frame on it; in bring-up,
    # for those that stand in the mailboxes before it.
    settled = [at_s for at_s in zip(*times_s.values(), strict=True) if min(at_s) > 1.0]
    assert len(settled) == 450
    assert max(max(at_s) - min(at_s) for at_s in settled) < 150e-6


def test_states_of_border_cells_are_heard_on_both_sides(carried):
    _, log = carried
    counts = defaultdict(int)
    for line in log:
        _, name, frame = line.split()
        counts[name, int(frame[:3], 16) - cob.TPDO_BASES[0]] += 1
    # Six cells of a column are node 3, 6, ... 18 on bus 0, and 126, 125, ... 121 on bus 1.
    assert all(counts["can0", 3 * row] - 2 < counts["can1", 127 - row] for row in range(1, 7))
    assert counts["can0", 120] == 0


def test_loss_of_one_cell_stops_the_cells_of_all_buses():
    lost = 'fault=[{kind="off", cells=[23], start_s=1.0}]'
    run = run_scenario(array54("run.duration_s=2.2", "run.pauses=0", lost))
    assert "cell 23 (node 8 of bus 1)" in run.reason
    assert abs(run.record.twist[-1, 0]).max() < 5e-3
    assert not run.record.voltage_v[-1].any()
