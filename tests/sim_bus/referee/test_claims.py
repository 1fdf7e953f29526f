"""The rules about words: 'arrived' is true, and a fault is said."""

from math import inf, pi

import pytest
from tests.sim_bus.referee.stand_ins import (
    ABOUT_WHEELS,
    ARRIVED,
    REST,
    UNDER,
    along_x,
    estimate,
    every,
    judged,
    noted,
    page,
    table,
)

from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.neighbours import messages
from mdms_sim.referee.truth import HostReport

pytestmark = pytest.mark.violates(*ABOUT_WHEELS)

BOX = (-0.2, 0.0)
HOST_GONE = '{kind="host", start_s=0.2}'
EMERGENCY = Frame(cob.EMCY_BASE + 8, bytes([0x30, 0x81, 0x10, 0, 0, 0, 0, 0]))


def arrives(goal, at_s=0.3, over=False):
    """A host that says from a time on that the box is at its goal."""

    def said(simulation):
        there = {"box1": goal} if simulation.kernel.now_ns >= at_s * 1e9 else {}
        return HostReport(goals={"box1": goal}, arrived={} if over else there, over=bool(there))

    return said


@pytest.mark.violates("true")
@pytest.mark.parametrize("goal", [(-0.194, 0.0, 0.0), (-0.2, 0.0, 0.04)])
@pytest.mark.parametrize("over", [False, True])
def test_an_arrival_that_is_not_true_is_noted_when_it_is_said(goal, over):
    """6 mm, or 2.3 degrees, off; the same where the host says that all is done."""
    simulation = judged(table(BOX), 0.5, host=arrives(goal, over=over))
    assert noted(simulation)[0] == ("true", pytest.approx(0.325, abs=0.026), None, "box1")


@pytest.mark.violates("true")
def test_an_arrival_that_the_host_itself_takes_for_too_far_off_is_noted():
    """The truth is within 5 mm and 2 degrees, the belief not within 3 mm and 1 degree."""
    goal = (-0.2, 0.0, 0.0)
    for believed in ((-0.2029, 0.0, 0.017), (-0.2031, 0.0, 0.0), (-0.2, 0.0, 0.018)):

        def said(simulation, pose=believed):
            there = simulation.kernel.now_ns >= 3e8
            arrived, places = ({"box1": goal}, {"box1": pose}) if there else ({}, {})
            return HostReport(goals={"box1": goal}, arrived=arrived, believed=places)

        found = noted(judged(table(BOX), 0.5, host=said))
        assert [rule for rule, *_ in found] == ([] if believed[0] == -0.2029 else ["true"])


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_square_is_there_however_often_it_is_turned_by_90_degrees(turns):
    goal = (-0.204, 0.0, 0.03 + turns * pi / 2)
    assert not noted(judged(table(BOX), 0.5, host=arrives(goal)))


def outlined(shape):
    """One parcel of 0.25 m, and its shape."""
    box = f'{{name="box1", mass_kg=2.0, length_m=0.25, x_m=-0.2, goal={{x_m=0, y_m=0}}, {shape}}}'
    return load_scenario("array18", [f"parcel=[{box}]"])


HEXAGON = "width_m=0.2166, shape='polygon', corners_m=[{}]".format(
    ", ".join(
        f"[{x}, {y}]"
        for x, y in (
            *((0.125, 0.0), (0.0625, 0.10825), (-0.0625, 0.10825)),
            *((-0.125, 0.0), (-0.0625, -0.10825), (0.0625, -0.10825)),
        )
    )
)


@pytest.mark.violates("true")
@pytest.mark.parametrize(
    ("shape", "same_rad", "other_rad"),
    [
        ("width_m=0.25, shape='disc'", 1.234, None),
        ("width_m=0.2", pi, pi / 2),
        (HEXAGON, pi / 3, pi / 2),
        (
            "width_m=0.2, shape='polygon', corners_m=[[0.125, -0.1], [0.125, 0.1], [-0.125, 0.0]]",
            0.0,
            pi,
        ),
    ],
)
def test_turns_that_no_sensor_can_tell_apart_are_as_good(shape, same_rad, other_rad):
    scenario = outlined(shape)
    assert not noted(judged(scenario, 0.4, host=arrives((-0.2, 0.0, same_rad))))
    if other_rad is not None:
        assert noted(judged(scenario, 0.4, host=arrives((-0.2, 0.0, other_rad))))


def said_by_cells(goal_x_m, until_s=1.4):
    """The four cells under the box say that it has arrived; no host says anything."""
    program = [
        (0.1, page(messages.Place, 1, *BOX)),
        (0.1, page(messages.Goal, 1, goal_x_m, 0.0, 0, 0)),
    ]
    cells = [estimate(cell, 1, UNDER, flags=ARRIVED) for cell in (7, 8, 9)]
    return noted(judged(table(BOX), 1.4, frames=[*program, *every(0.01, 0.5, until_s, *cells)]))


@pytest.mark.violates("true")
def test_the_word_of_most_cells_for_half_a_second_is_to_be_true():
    assert said_by_cells(-0.19) == [("true", pytest.approx(1.0, abs=0.2), None, "box1")]
    assert not said_by_cells(-0.202)
    assert not said_by_cells(-0.19, until_s=0.8)


def goes_until(stop_s):
    """The box is driven, and then held."""
    return lambda time_s: along_x(1.0) if time_s < stop_s else REST


def steers(trouble_s=inf, reason=None):
    """A host that steers the box far off, and reports a trouble at a time."""

    def said(simulation):
        now_s = simulation.kernel.now_ns / 1e9
        return HostReport(
            goals={"box1": (0.2, 0.0, 0.0)},
            reason=reason,
            trouble_s=trouble_s if now_s >= trouble_s else -inf,
        )

    return said


JAM = '{kind="wheel_jammed", start_s=0.5, cells=[8]}'


@pytest.mark.violates("said")
def test_a_fault_that_stops_a_parcel_and_is_not_reported_is_noted():
    scenario = table(BOX, faults=[JAM])
    (violation,) = noted(judged(scenario, 3.5, drive=goes_until(0.6), host=steers()))
    assert violation == ("said", pytest.approx(2.8, abs=0.2), None, "box1")
    late = judged(scenario, 3.5, drive=goes_until(0.6), host=steers(trouble_s=3.2))
    assert [rule for rule, *_ in noted(late)] == ["said"]


@pytest.mark.parametrize("host", [steers(trouble_s=1.5), steers(reason="cell 8 is lost")])
def test_one_that_is_reported_in_time_is_not(host):
    assert not noted(judged(table(BOX, faults=[JAM]), 3.5, drive=goes_until(0.6), host=host))


def reasons(from_s, until_s):
    """A host that leads the box, and gives a reason for a while."""

    def said(simulation):
        standing = from_s <= simulation.kernel.now_ns / 1e9 < until_s
        return steers(reason="the program has been killed" if standing else None)(simulation)

    return said


@pytest.mark.violates("said")
@pytest.mark.parametrize(("from_s", "until_s", "said"), [(1.0, 1.5, True), (0.1, 0.4, False)])
def test_a_reason_counts_that_stood_since_the_fault_and_no_older_one(from_s, until_s, said):
    scenario = table(BOX, faults=[JAM])
    found = noted(judged(scenario, 3.5, drive=goes_until(0.6), host=reasons(from_s, until_s)))
    assert bool(found) != said


@pytest.mark.violates("said")
@pytest.mark.parametrize(("node_id", "said"), [(nmt.ALL_NODES, True), (8, False)])
def test_without_the_host_a_stop_of_all_cells_needs_no_other_reason(node_id, said):
    scenario = table(BOX, faults=[HOST_GONE], more=["parcel.0.goal.x_m=0.2"])
    frames = [(0.3, nmt.command(nmt.ENTER_PRE_OPERATIONAL, node_id))]
    found = noted(judged(scenario, 4.5, drive=goes_until(0.3), host=steers(), frames=frames))
    assert bool(found) != said


@pytest.mark.violates("true")
@pytest.mark.parametrize(("arrived_s", "true"), [(0.2, True), (9.0, False)])
def test_what_a_hand_takes_away_had_arrived_if_that_was_said_before(arrived_s, true):
    """The host loses the box that a hand lifts, and finishes without it."""
    goal = (*BOX, 0.0)

    def said(simulation):
        now_s = simulation.kernel.now_ns / 1e9
        there = {"box1": goal} if arrived_s <= now_s < 0.5 else {}
        return HostReport(goals={"box1": goal}, arrived=there, over=now_s >= 1.0)

    lift = '{kind="lift", start_s=0.4, duration_s=0.3, parcel="box1", x_m=-0.1, y_m=0.0}'
    assert bool(noted(judged(table(BOX, faults=[lift]), 1.3, host=said))) != true


def pauses(stop_s, again_s):
    """The box is driven, held, driven on for a moment, and stopped again."""

    def drive(time_s):
        on_s = time_s - again_s
        if time_s < stop_s or 0 <= on_s < 0.1:
            return along_x(1.0)
        return along_x(-1.0) if 0.1 <= on_s < 0.18 else REST

    return drive


@pytest.mark.violates("said")
@pytest.mark.parametrize(("again_s", "silent"), [(0.9, True), (1.5, False)])
def test_a_parcel_that_has_stood_and_gone_on_stands_later_for_another_reason(again_s, silent):
    scenario = table(BOX, faults=[JAM.replace("start_s=0.5", "start_s=0.5, duration_s=0.3")])
    found = noted(judged(scenario, 4.4, drive=pauses(0.6, again_s), host=steers()))
    assert bool(found) == silent


def test_a_fault_beside_which_a_parcel_goes_on_stops_none():
    scenario = table(BOX, faults=[JAM.replace("[8]", "[18]")])
    assert not noted(judged(scenario, 3.5, drive=goes_until(0.6), host=steers()))


@pytest.mark.violates("said")
def test_without_the_host_an_emergency_on_the_bus_says_it():
    scenario = table(BOX, faults=[HOST_GONE], more=["parcel.0.goal.x_m=0.2"])
    (violation,) = noted(judged(scenario, 4.5, drive=goes_until(0.3), host=steers()))
    assert violation == ("said", pytest.approx(4.0, abs=0.2), None, "box1")
    frames = [(0.4, EMERGENCY)]
    assert not noted(judged(scenario, 4.5, drive=goes_until(0.3), host=steers(), frames=frames))


def test_a_fault_that_comes_while_an_earlier_one_stops_the_parcel_needs_no_word_of_its_own():
    faults = [JAM.replace("start_s=0.5", "start_s=0.18"), HOST_GONE]
    scenario = table(BOX, faults=faults, more=["parcel.0.goal.x_m=0.2"])
    frames = [(0.19, EMERGENCY)]
    assert not noted(judged(scenario, 4.5, drive=goes_until(0.3), host=steers(), frames=frames))


@pytest.mark.violates("said")
def test_a_run_in_which_nothing_moves_and_nobody_says_why_is_noted_after_30_s():
    (violation,) = noted(judged(table(BOX), 33.0, host=steers()))
    assert violation == ("said", pytest.approx(30.3, abs=0.3), None, "box1")
    assert not noted(judged(table(BOX), 33.0, host=steers(trouble_s=20.0)))
    assert not noted(judged(table(BOX), 33.0, host=arrives((*BOX, 0.0))))
