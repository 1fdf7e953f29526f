"""Goals of a scenario: each parcel is taken to its goal, and kept there."""

import re
from math import hypot

import numpy as np
import pytest
from tests.host.programs.rolling import CYCLE_S, Rolling

from mdms_host.estimation.belief import Belief, BeliefKind
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.parcel import Parcel
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.program import FieldProgram
from mdms_sim.physics.plane.handling import lift, set_down

#: A disc of 0.16 m; an unknown thing may reach farther by the way to the next sensor.
SMALL = ("parcel.1.length_m=0.16", "parcel.1.width_m=0.16")


def goals(*more, box=(0.36, 0.0), disc=None, **options):
    """The box and the disc of `swap2` on 9 x 6 cells, with goals; the disc is beside the way."""
    given = [f"parcel.0.goal={{x_m={box[0]}, y_m={box[1]}, yaw_rad=0.0}}"] if box else []
    given += [f"parcel.1.goal={{x_m={disc[0]}, y_m={disc[1]}, yaw_rad=0.0}}"] if disc else []
    places = "parcel.0.y_m=0.0", "parcel.1.x_m=0.0", "parcel.1.y_m=0.2"
    return Rolling("swap2", "motion.field=goal", "task=[]", *places, *given, *more, **options)


def away_m(pose, x_m, y_m):
    return hypot(pose[0] - x_m, pose[1] - y_m)


def test_all_parcels_are_taken_to_their_goals_at_once():
    table = goals(box=(0.30, -0.15), disc=(-0.2, 0.2))
    table.run(1.0)
    assert away_m(table.pose("box"), -0.36, 0.0) > 0.05
    assert away_m(table.pose("disc"), 0.0, 0.2) > 0.05
    table.run_until(9.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.30, -0.15) < 0.002
    assert away_m(table.pose("disc"), -0.2, 0.2) < 0.002


def test_a_parcel_without_a_goal_stands_as_others_go_around_it():
    table = goals(*SMALL, "parcel.1.y_m=0.1")
    table.run_until(9.0, lambda: table.program.finished)
    assert not table.events("touch")
    assert away_m(table.pose("disc"), 0.0, 0.1) < 1e-4


def test_nothing_moves_before_its_parcel_has_been_found():
    table = goals()
    table.hidden.add("box")
    table.run(8.0)
    assert set(table.program.awaits) == {"box"}
    assert not table.program.finished
    assert table.program.stuck is None
    table.hidden.clear()
    table.run_until(9.0, lambda: table.program.finished)


def test_a_way_leads_around_the_place_where_a_parcel_was_put_that_is_not_found():
    table = goals(*SMALL, "parcel.1.y_m=0.1")
    table.hidden.add("disc")
    table.run_until(9.0, lambda: table.program.finished)
    assert not table.events("touch")
    assert away_m(table.pose("disc"), 0.0, 0.1) < 1e-4


def test_a_parcel_that_has_arrived_is_brought_back_to_its_goal():
    table = goals()
    table.run_until(9.0, lambda: table.program.finished)
    table.put("box", 0.2, -0.1)
    table.run(0.1)
    assert not table.program.finished
    table.run_until(9.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.002


def test_a_parcel_that_was_lost_for_long_is_taken_on_from_where_it_is_found():
    table = goals(disc=(0.0, 0.15))
    table.run(1.0)
    table.hidden.add("box")
    table.run(8.0)
    assert table.program.stuck is None
    table.put("box", -0.3, -0.2)
    table.hidden.clear()
    table.run_until(9.0, lambda: table.program.finished)
    assert not table.events("touch")


def test_a_parcel_at_its_goal_that_is_lost_is_not_there():
    table = goals()
    table.run_until(9.0, lambda: table.program.finished)
    table.hidden.add("box")
    table.run(0.1)
    assert not table.program.finished
    assert not table.program.controllers["box"].arrived


def test_a_program_is_not_finished_while_the_place_of_a_parcel_is_doubtful():
    table = goals()
    table.run_until(9.0, lambda: table.program.finished)
    table.doubted.add("box")
    table.run(0.05)
    assert not table.program.finished
    table.doubted.clear()
    table.run_until(0.5, lambda: table.program.finished)


def test_a_parcel_that_does_not_get_on_is_given_up_after_five_tries_and_steered_to_a_new_goal():
    table = goals(disc=(0.0, 0.15))
    table.run(0.6)
    lift(table.world.scene, 0)
    table.run_until(12.0, lambda: table.program.stuck is not None)
    assert re.fullmatch(
        r"box does not get on, \d+ mm from its goal, tried 5 times: stopped", table.program.stuck
    )
    assert table.program.controllers["disc"].arrived
    assert table.program.stuck in table.program.take_notices()
    assert not table.references_m_s.any()
    set_down(table.world.scene, 0, None, None, None)
    table.program.set_goal("box", GoalPose(0.0, -0.2, 0.0))
    assert table.program.stuck is None
    table.run_until(9.0, lambda: table.program.finished)


def test_two_that_are_in_each_others_way_for_good_wait_and_are_given_up():
    narrow = "array.rows=3", "array.buses=[]", "parcel.1.x_m=0.3", "parcel.1.y_m=0.0"
    table = goals(*narrow, box=(0.36, 0.0), disc=(-0.36, 0.0))
    table.run(2.0)
    waits = [text for text in table.program.take_notices() if "waits, for 5 s at most" in text]
    assert len(waits) == 2
    assert table.program.stuck is None
    table.run_until(8.0, lambda: table.program.stuck is not None)
    assert "'box' has no way" in table.program.stuck
    assert "'disc' has no way" in table.program.stuck
    assert not table.events("touch")


@pytest.mark.parametrize("gap_m", [0.005, 0.015])
def test_a_goal_may_be_close_to_where_another_parcel_stands(gap_m):
    """Nearer than tiles and clearances keep others: the parcel comes no nearer on its way."""
    table = goals("parcel.1.y_m=0.1", box=(0.02, -0.2 - gap_m))
    table.run_until(9.0, lambda: table.program.finished)
    assert not table.events("touch")
    assert away_m(table.pose("disc"), 0.0, 0.1) < 1e-4


def test_a_goal_into_which_another_parcel_reaches_is_not_gone_to():
    table = goals("parcel.1.y_m=0.1", box=(0.02, -0.17))
    table.run_until(9.0, lambda: table.program.stuck is not None)
    assert not table.events("touch")


def test_a_parcel_waits_for_an_unknown_thing_and_goes_on_when_it_is_gone():
    table = goals(*SMALL, "parcel.1.x_m=0.3", "parcel.1.y_m=0.0", unknown=["disc"])
    table.run(7.0)
    (notice,) = table.program.take_notices()
    assert notice.startswith("box waits, for 60 s at most: ")
    table.hidden.add("disc")
    table.put("disc", 0.0, 0.25)
    table.run_until(9.0, lambda: table.program.finished)
    assert not table.events("touch")


def test_an_unknown_thing_beside_a_parcel_at_its_goal_takes_nothing_from_it():
    table = goals(*SMALL, "parcel.1.x_m=-0.3", "parcel.1.y_m=0.26", unknown=["disc"])
    table.run_until(9.0, lambda: table.program.finished)
    table.put("disc", 0.36, 0.26)
    table.run(7.0)
    assert table.program.finished
    assert table.program.take_notices() == []


def test_a_parcel_gets_another_goal_on_its_way_and_is_taken_there_without_slip():
    table = goals("motion.speed_m_s=0.5")
    table.run(0.8)
    table.program.set_goal("box", GoalPose(-0.36, -0.2, 0.4))
    assert table.program.controllers["box"].goal == GoalPose(-0.36, -0.2, 0.4)
    table.run_until(9.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), -0.36, -0.2) < 0.002


def test_the_goal_of_a_parcel_that_is_not_found_may_be_changed():
    table = goals()
    table.hidden.add("box")
    table.run(0.1)
    table.program.set_goal("box", GoalPose(0.0, -0.2, 0.0))
    table.hidden.clear()
    table.run_until(9.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.0, -0.2) < 0.002


def test_a_parcel_without_a_goal_gets_one_and_one_that_is_not_there_none():
    table = goals()
    table.run_until(9.0, lambda: table.program.finished)
    table.program.set_goal("disc", GoalPose(-0.2, 0.1, None))
    assert not table.program.finished
    table.run_until(9.0, lambda: table.program.finished)
    with pytest.raises(KeyError):
        table.program.set_goal("crate", GoalPose(0.0, 0.0))


class Named:
    """The tracker of a table on which a crate has got a name, by hand."""

    def __init__(self):
        self.parcels = {"crate": Parcel("crate", 0.3, 0.3)}

    def take_withdrawn(self):
        return []

    def lay_there(self, name):
        return False


@pytest.mark.parametrize("kind", [BeliefKind.UNKNOWN, BeliefKind.HEAP, BeliefKind.PARCEL])
def test_a_thing_that_was_named_gets_a_goal_and_no_other_does(kind):
    table = goals(*SMALL, box=None, disc=(0.0, 0.2))
    table.program.attend(Named())
    place, still = np.array([0.3, -0.1, 0.0]), np.zeros(3)
    crate = Belief("crate", Rectangle(0.3, 0.3), place, still, np.zeros((3, 3)), kind=kind)
    there = {"crate": crate}
    table.program.references_m_s(there, CYCLE_S)
    if kind is not BeliefKind.PARCEL:
        with pytest.raises(KeyError):
            table.program.set_goal("crate", GoalPose(0.0, 0.0))
        return
    table.program.set_goal("crate", GoalPose(0.1, -0.1, 0.0))
    pushed = [table.program.references_m_s(there, CYCLE_S).any() for _ in range(10)]
    assert any(pushed)


def test_wheels_that_slip_under_a_parcel_are_reported_once():
    table = goals("motion.speed_m_s=0.6", "parcel.0.mass_kg=2.0")
    true_steps = table.world.step_ideal
    # The wheels push more than the parcel gains.
    table.world.step_ideal = lambda references_m_s, step_s: true_steps(3 * references_m_s, step_s)
    table.run(1.5)
    notices = [text for text in table.program.take_notices() if "slip" in text]
    assert len(notices) == 1
    assert notices[0].startswith("wheels slip under box: they push with")


def test_a_field_takes_no_goal():
    with pytest.raises(ValueError, match="steers no parcel"):
        FieldProgram(np.zeros(72)).set_goal("left", GoalPose(0.0, 0.0))
