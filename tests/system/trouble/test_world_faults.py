"""Firmware and coordinator in a world that goes wrong, or that is not as believed."""

from math import pi, radians, remainder

import numpy as np
import pytest
from tests.benchmarks.host.care import struck

import mdms_array as mdms
from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import simulate

#: All wheels along x at 0.3 m/s of reference; the box starts in the middle and leaves cell 1 free.
UNIFORM = (
    "motion.field='uniform'",
    "motion.speed_m_s=0.3",
    "parcel.0.x_m=0.0",
    "parcel.0.y_m=0.0",
    "run.duration_s=1.8",
)


def run(*overrides):
    return mdms.simulate(load_scenario("array18", [*UNIFORM, *overrides]))


def of_wheel(values, cell, axis=1):
    return values[:, 2 * (cell - 1) + axis - 1]


@pytest.fixture(scope="module")
def well():
    return run()


def test_a_jammed_wheel_stands_under_the_full_voltage_of_its_loop(well):
    jammed = run("fault=[{kind='wheel_jammed', start_s=1.0, cells=[1], axes=[1]}]").record
    late = jammed.time_s > 1.1
    assert (of_wheel(jammed.speed_m_s, 1)[late] == 0.0).all()
    # G (r - 0): nothing turns that could take it back.
    assert of_wheel(jammed.voltage_v, 1)[late] == pytest.approx(3.0, abs=0.05)
    assert of_wheel(well.record.voltage_v, 1)[late].max() < 2.6
    assert np.array_equal(of_wheel(jammed.speed_m_s, 18), of_wheel(well.record.speed_m_s, 18))


def test_a_wheel_whose_encoder_is_stuck_below_the_stall_voltage_is_no_fault_of_its_cell():
    stuck = run("fault=[{kind='encoder_stuck', start_s=1.0, cells=[1], axes=[1]}]").record
    late = stuck.time_s > 1.4
    assert (of_wheel(stuck.speed_m_s, 1)[late] > 0.5).all()


def test_a_reversed_motor_is_a_runaway_that_stops_the_array_and_names_the_cell():
    finished = run("fault=[{kind='motor_reversed', start_s=1.0, cells=[1], axes=[1]}]")
    record = finished.record
    assert finished.status == "fault"
    assert finished.reason.startswith("cell 1 (node 1) has disabled its drives")
    turning = (record.time_s > 1.02) & (record.time_s < 1.1)
    assert (of_wheel(record.speed_m_s, 1)[turning] < -0.1).all()
    assert np.abs(record.speed_m_s[record.time_s > 1.7]).max() < 1e-3


def test_wheels_stop_when_the_host_is_gone_and_stay_so_when_it_is_back(well):
    finished = run("fault=[{kind='host', start_s=1.0, duration_s=0.4}]", "run.pauses=0")
    record = finished.record
    # The setpoint's time-out is 50 ms; the wheels ramp down, and are held for 0.3 s.
    assert np.abs(record.speed_m_s[(record.time_s > 1.2) & (record.time_s < 1.4)]).max() < 0.01
    assert (record.voltage_v[record.time_s > 1.5] == 0.0).all()
    assert np.abs(record.speed_m_s[record.time_s > 1.7]).max() < 2e-3
    assert np.abs(well.record.speed_m_s[well.record.time_s > 1.7]).max() > 0.1
    # It takes all cells for silent, since it has missed their heartbeats, and ends the run.
    assert finished.reason.startswith("cell 1 (node 1) has fallen silent: no heartbeat for 0.3 s")


def test_cells_get_the_gain_that_the_host_believes_in():
    jam = "fault=[{kind='wheel_jammed', start_s=1.0, cells=[1], axes=[1]}]"
    record = run(jam, "belief.gain_vs_per_m=5").record
    late = record.time_s > 1.1
    assert of_wheel(record.voltage_v, 1)[late] == pytest.approx(5 * 0.3, abs=0.03)


def test_a_box_that_is_longer_than_believed_is_carried_by_its_believed_edges():
    """The host is off by about half of what its belief is off, until edges on both ends show it."""
    scenario = load_scenario(
        "array18", ["belief.box.length_m=0.30", "run.duration_s=2.0", "parcel.0.yaw_rad=0.0"]
    )
    assert scenario.parcel[0].length_m > 0.35
    believing = mdms.simulate(scenario).record
    right = mdms.simulate(load_scenario("array18", ["run.duration_s=2.0"])).record

    def away_m(record):
        return np.nanmax(np.abs((record.estimate - record.pose)[:, 0, 0]))

    assert away_m(believing) > 0.015
    assert away_m(right) < 0.010


@pytest.mark.parametrize("off_m", [-0.015, 0.015])
def test_a_size_that_is_told_roughly_is_learned_before_the_parcel_has_arrived(off_m):
    """On so short a way edges pass sensors on one side only, unless the parcel feels for them."""
    scenario = load_scenario(
        "array18",
        [
            *("run.duration_s=4.0", "motion.speed_m_s=0.3"),
            *("parcel.0.length_m=0.36", "parcel.0.width_m=0.30"),
            *("parcel.0.x_m=-0.095", "parcel.0.y_m=-0.04", "parcel.0.yaw_rad=-0.062"),
            "parcel.0.goal={x_m=-0.124, y_m=-0.043, yaw_rad=-0.059}",
            f"belief.box.length_m={0.36 + off_m}",
            f"belief.box.width_m={0.30 + off_m}",
            "belief.box.size_spread_m=0.008",
        ],
    )
    ended = mdms.simulate(scenario)
    assert ended.status == "reached"
    x_m, y_m, _ = ended.parcels["box"].true_pose
    assert np.hypot(x_m + 0.124, y_m + 0.043) < 0.005


@pytest.mark.parametrize(
    ("start", "goal", "seed"),
    [
        (
            (0.12878161692789075, -0.001496537206905471, -1.4977763959093837),
            (0.06512742515350706, -0.0029745742935555, -3.067153618539824),
            6,
        ),
        (
            (0.1462969140999686, 0.03568630063847496, 1.7669451536757466),
            (0.14201825436170346, -0.031009796869262807, 1.6156219259308726),
            11,
        ),
    ],
)
def test_a_parcel_that_is_told_too_large_is_found_with_the_sizes_that_sensors_allow(
    start, goal, seed
):
    """With the told size alone it was found beside, or turned a quarter, and called arrived."""
    scenario = load_scenario(
        "neighbours",
        [
            *("motion.control='host'", "run.duration_s=8.0", f"run.seed={seed}"),
            *("cell.motor_spread=0.3", "cell.friction_spread=0.3"),
            *("parcel.0.length_m=0.36", "parcel.0.width_m=0.30"),
            f"parcel.0.x_m={start[0]}",
            f"parcel.0.y_m={start[1]}",
            f"parcel.0.yaw_rad={start[2]}",
            "parcel.0.goal={{x_m={}, y_m={}, yaw_rad={}}}".format(*goal),
            *("belief.box.length_m=0.375", "belief.box.width_m=0.315"),
            "belief.box.size_spread_m=0.008",
        ],
    )
    ended = mdms.simulate(scenario)
    assert ended.status == "reached"
    x_m, y_m, yaw_rad = ended.parcels["box"].true_pose
    assert np.hypot(x_m - goal[0], y_m - goal[1]) < 0.003
    assert abs(remainder(yaw_rad - goal[2], pi)) < radians(1.0)


@pytest.mark.parametrize("cell", [8, 9])
@pytest.mark.parametrize("kind", ["encoder_stuck", "wheel_jammed"])
def test_a_parcel_gets_past_a_wheel_that_stands_and_the_wheel_is_named(kind, cell):
    fault = f'fault=[{{kind="{kind}", cells=[{cell}], axes=[1], start_s=0.45}}]'
    scenario = load_scenario("array18", ["run.duration_s=3", fault])
    coordinator = coordinator_of(scenario)
    record = until_over(scenario, coordinator)
    name = f"cell {cell} (node {cell}) axis 1 does not follow"
    (named_s,) = [time_s for time_s, text in coordinator.troubles if name in text]
    assert 0.45 < named_s < 0.75
    assert coordinator.finished
    assert np.hypot(*(record.pose[-1, 0, :2] - (0.10, 0.0))) < 0.002


@pytest.mark.parametrize("kind", ["encoder_stuck", "wheel_jammed"])
def test_a_wheel_that_stands_at_a_reference_is_named_within_half_a_second(kind):
    fault = f'fault=[{{kind="{kind}", cells=[9], axes=[1], start_s=1.0}}]'
    slow = "motion.speed_m_s=0.1"
    scenario = load_scenario("array18", ["run.duration_s=1.6", slow, fault])
    coordinator = coordinator_of(scenario)
    simulate(scenario, [coordinator])
    named_s = [time_s for time_s, text in coordinator.troubles if "cell 9 (node 9) axis 1" in text]
    assert named_s
    assert 1.0 < named_s[0] <= 1.5


def wrong_place(cell, as_cell):
    fault = f"fault=[{{kind='wrong_place', cells=[{cell}], as_cell={as_cell}}}]"
    scenario = load_scenario("array18", ["run.duration_s=10", fault])
    coordinator = coordinator_of(scenario)
    return until_over(scenario, coordinator), coordinator


def until_over(scenario, coordinator, nodes="cpython"):
    """The record of a run that ends with a fault, or at its goal."""

    def over():
        return coordinator.fault or coordinator.finished

    return simulate(scenario, [coordinator], nodes, over=over).record


def refused(nodes, *overrides):
    """A run on a table that tells cells their places; cells 2 and 17 are exchanged."""
    fault = "fault=[{kind='wrong_place', cells=[2], as_cell=17}]"
    settings = ["run.duration_s=6", "array.coded_places=true", fault, *overrides]
    scenario = load_scenario("array18", settings)
    coordinator = coordinator_of(scenario)
    return until_over(scenario, coordinator, nodes), coordinator


@pytest.mark.parametrize("nodes", ["cpython", "micropython"])
def test_where_places_are_told_exchanged_cells_do_not_start_and_are_named(nodes):
    record, coordinator = refused(nodes)
    assert coordinator.fault == (
        "in the place of another cell (0xFF02): cell 2 (node 2), cell 17 (node 17); put the boards "
        "back, or write their places anew with mdms commission"
    )
    assert record.time_s[-1] < 1.0
    assert not record.voltage_v.any()
    assert (record.pose[:, 0] == record.pose[0, 0]).all()


def test_a_run_that_goes_on_does_so_without_their_wheels_and_their_sensors():
    record, coordinator = refused("cpython", "run.on_lost_cell='go_on'", "run.duration_s=10")
    assert any("goes on without them" in text for _, text in coordinator.troubles)
    for cell in (2, 17):
        for axis in (1, 2):
            assert not of_wheel(record.voltage_v, cell, axis).any()
    assert record.voltage_v.any()
    assert coordinator.finished
    assert np.hypot(*(record.pose[-1, 0, :2] - (0.10, 0.0))) < 0.005


@pytest.mark.parametrize("policy", ["stop", "go_on"])
def test_cells_that_come_back_in_each_others_places_are_named_and_not_taken_back(policy):
    """They are without power for half a second, and a person puts each where the other was."""
    faults = (
        "{kind='off', cells=[2, 17], start_s=1.0, duration_s=0.5}",
        "{kind='wrong_place', cells=[2], as_cell=17, start_s=1.2}",
    )
    settings = ("motion.speed_m_s=0.1", f"run.on_lost_cell='{policy}'", "run.duration_s=5")
    fault = f"fault=[{', '.join(faults)}]"
    scenario = load_scenario("array18", ["array.coded_places=true", fault, *settings])
    coordinator = coordinator_of(scenario)
    record = simulate(scenario, [coordinator]).record
    texts = [coordinator.fault or "", *coordinator.lost_cells.values()]
    for cell in (2, 17):
        refusal = f"cell {cell} (node {cell}) is not taken back: 0xFF02: it stands in the place"
        assert any(refusal in text for text in texts), texts
        late = record.time_s > 1.5
        for axis in (1, 2):
            assert not of_wheel(record.voltage_v, cell, axis)[late].any()
    assert bool(coordinator.fault) == (policy == "stop")


@pytest.mark.parametrize("cells", [(2, 17), (8, 11)])
def test_a_parcel_arrives_past_cells_in_each_others_places_and_they_are_named(cells):
    """Cell 8 is under the box, and should be 11, which should be there.

    Its wheels push where nobody expects it, so the place is felt for three times before arrival.
    """
    record, coordinator = wrong_place(*cells)
    named = [text for _, text in coordinator.troubles]
    for cell in cells:
        assert any(f"cell {cell} (node {cell}): presence sensors" in text for text in named)
    assert coordinator.finished
    assert np.hypot(*(record.pose[-1, 0, :2] - (0.10, 0.0))) < 0.005


@pytest.mark.parametrize("seed", [2, 8])
def test_sensors_lead_no_belief_aside_when_they_count_again_after_a_hold(seed):
    """The box is braked 2 mm from its belief, which bits then led 9 mm and 6 mm from it."""
    record = mdms.simulate(struck("host cut off for 0.5 s", seed)).record
    (back_s,) = (event.time_s for event in record.events if "all cells are back" in event.detail)
    off_m = (record.estimate - record.pose)[record.time_s > back_s, 0, :2]
    assert np.hypot(*off_m.T).max() < 0.0055
