"""Parcels get to their ordered places, and none touches another, with any event in between."""

import re
from dataclasses import replace
from math import hypot
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.host.programs.rolling import Rolling

from mdms_array.recording import PlanLog
from mdms_host.estimation.belief import Standing
from mdms_host.motion.goal import GoalPose
from mdms_host.programs.order import Gate
from mdms_host.programs.script import until
from mdms_host.programs.table import ProgramError
from mdms_sim.physics.plane.handling import lift, set_down

SORT18 = Path(__file__).parents[4] / "examples" / "sort.toml"


#: A disc of 0.16 m; an unknown thing may reach farther by the way to the next sensor.
SMALL = ("parcel.1.length_m=0.16", "parcel.1.width_m=0.16")


def away_m(pose, x_m, y_m):
    return hypot(pose[0] - x_m, pose[1] - y_m)


def two_boxes(*more, **options):
    """A box that is to go from the west end of 9 x 6 cells to the east end, and another."""
    return Rolling(
        "swap2", "parcel.0.y_m=0.0", "parcel.1.x_m=0.0", "parcel.1.y_m=0.2", *more, **options
    )


async def go_east(table):
    await table["box"].move(0.36, 0.0)


def test_a_stream_is_sorted():
    table = Rolling("sort54", "task.0.count=3", "stream.0.start_s=0.1")
    table.run_until(9.0, lambda: table.program.finished)
    exits = [event for event in table.world.events if event.kind == "exit"]
    assert len(exits) == 3
    assert not any("not for" in event.detail for event in exits)
    assert not table.events("touch", "tip")


def test_two_parcels_change_places():
    table = Rolling("swap2")
    box, disc = table.pose("box"), table.pose("disc")
    table.run_until(9.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), *disc[:2]) < 0.003
    assert away_m(table.pose("disc"), *box[:2]) < 0.003
    assert not table.events("touch", "tip")


def test_the_way_leads_around_an_unknown_thing():
    table = two_boxes(*SMALL, "parcel.1.y_m=0.19", main=go_east, unknown=["disc"])
    table.run_until(9.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.003
    assert not table.events("touch")


def test_a_parcel_stops_before_a_thing_that_appears_on_its_way_and_goes_around_it():
    async def main(table):
        await table["box"].move(0.36, -0.19)

    table = two_boxes(*SMALL, "parcel.1.x_m=0.40", main=main, unknown=["disc"])
    table.hidden.add("disc")
    table.run(0.25)
    table.hidden.clear()
    table.put("disc", 0.05, 0.23)
    table.run_until(8.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, -0.19) < 0.003
    assert not table.events("touch")


def test_a_parcel_that_something_unknown_may_reach_to_gets_away_from_there():
    table = two_boxes(*SMALL, "parcel.1.x_m=-0.10", main=go_east, unknown=["disc"])
    table.run_until(8.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.003
    assert not table.events("touch")


def test_with_another_order_a_parcel_comes_to_rest_and_goes_there():
    orders = []

    async def main(table):
        table.start(table["box"].move(0.36, 0.0))
        await table.sleep(0.8)
        orders.append(table["box"].pose)
        await table["box"].move(-0.35, -0.15)

    table = two_boxes(main=main)
    table.run_until(8.0, lambda: table.program.finished)
    assert away_m(orders[0], -0.38, 0.0) > 0.02
    assert away_m(table.pose("box"), -0.35, -0.15) < 0.003


def test_a_person_sets_another_goal_and_the_run_goes_on_until_the_parcel_is_there():
    table = two_boxes(main=go_east)
    table.run(0.5)
    table.program.set_goal("box", GoalPose(-0.3, -0.1, None))
    table.run_until(4.0, lambda: table.program.finished)
    assert table.program.finished
    assert away_m(table.pose("box"), -0.3, -0.1) < 0.003
    with pytest.raises(KeyError):
        table.program.set_goal("bag", GoalPose(0.0, 0.0))


def test_a_place_given_by_hand_that_has_no_way_is_said_and_asked_for_no_more():
    table = two_boxes(main=go_east)
    table.run(0.5)
    table.program.set_goal("box", GoalPose(5.0, 0.0, None))
    table.run_until(8.0, lambda: table.program.finished)
    assert table.program.finished
    assert "box" not in table.program.controllers
    said = [each for each in table.program.take_notices() if "given place" in each]
    assert len(said) == 1
    assert said[0].startswith("box is not taken to the given place: ")


def test_a_parcel_that_nothing_shows_stands_and_is_lost_to_the_program():
    seen = []

    async def main(table):
        try:
            await go_east(table)
        except ProgramError as error:
            seen.append(str(error))

    table = two_boxes(main=main)
    table.run(0.6)
    table.hidden.add("box")
    table.run(0.1)
    assert not table.references_m_s.any()
    table.run(5.0)
    assert not seen
    table.run_until(6.0, lambda: bool(seen))
    assert seen == ["box is lost: no sensor has shown it for 6 s"]


def test_a_doubtful_parcel_comes_to_rest_on_its_way_and_goes_on_when_it_is_sure_again():
    table = two_boxes(main=go_east)
    table.run(0.6)
    table.doubted.add("box")
    table.run(1.0)
    at_rest = table.pose("box")
    table.run(0.5)
    assert table.pose("box") == pytest.approx(at_rest, abs=1e-4)
    table.doubted.clear()
    table.run_until(8.0, lambda: table.program.finished)


def test_one_that_is_found_elsewhere_goes_on_from_there():
    table = two_boxes(main=go_east)
    table.run(0.6)
    table.hidden.add("box")
    table.run(0.5)
    table.put("box", -0.2, -0.2)
    table.hidden.clear()
    table.run_until(8.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.003


def test_where_there_is_no_way_that_is_said_before_anything_moves():
    async def go_late(table):
        # On an idle table nobody has waited.
        await table.sleep(5.0)
        await go_east(table)

    table = two_boxes("parcel.1.x_m=0.36", "parcel.1.y_m=0.0", main=go_late)
    start = table.pose("box")
    table.run(7.0)
    assert table.program.stuck is None
    assert any("box waits, for 5 s at most: " in each for each in table.program.take_notices())
    table.run_until(5.0, lambda: table.program.stuck is not None)
    assert "blocked by 'disc' at its place" in table.program.stuck
    assert np.array_equal(table.pose("box"), start)


def test_a_parcel_whose_task_is_broken_off_comes_to_rest_and_is_asked_for_no_more():
    async def main(table):
        going = table.start(go_east(table))
        await table.sleep(1.2)
        going.cancel()
        await table.sleep(1.0)

    table = two_boxes(main=main)
    table.run(1.7)
    at_rest = table.pose("box")
    table.run_until(1.0, lambda: table.program.finished)
    assert table.pose("box") == pytest.approx(at_rest, abs=1e-3)
    assert -0.35 < at_rest[0] < 0.2
    assert "box" not in table.program.controllers


def test_a_parcel_that_is_ordered_elsewhere_as_its_program_fails_has_not_arrived_there():
    async def main(table):
        await table["box"].move(-0.3, -0.1)
        table.start(go_east(table))
        raise ValueError("wrong")

    table = two_boxes(main=main)
    table.run_until(4.0, lambda: table.program.stuck is not None)
    shown = table.program.controllers["box"]
    assert (shown.goal.x_m, shown.arrived) == (0.36, False)


def test_a_parcel_whose_task_is_broken_off_over_its_exit_leaves_all_the_same():
    async def main(table):
        box = table["box"]
        leaving = table.start(box.leave("east"))
        await until(lambda: box.pose[0] > 0.40)
        leaving.cancel()
        await until(lambda: box.has_left)

    exit = 'exit=[{name="east", side="east"}]'
    table = two_boxes(exit, "parcel.0.x_m=0.2", "parcel.1.x_m=-0.3", main=main)
    table.run_until(6.0, lambda: table.program.finished)


def test_where_there_is_no_way_even_if_others_move_that_is_said_while_they_do():
    refused = []

    async def to_and_fro(table):
        while True:
            for x_m in (-0.1, -0.3):
                await table["box"].move(x_m, -0.2)

    async def main(table):
        table.start(to_and_fro(table))
        try:
            await table["disc"].move(0.0, 0.9)
        except ProgramError as error:
            refused.append(str(error))

    table = Rolling("swap2", "parcel.0.x_m=-0.3", "parcel.0.y_m=-0.2", main=main)
    table.run(2.0)
    assert len(refused) == 1
    assert "'disc' has no way" in refused[0]


@pytest.mark.parametrize("after_s", [0.0, 0.02], ids=["before", "while it is planned"])
def test_ways_lead_around_lost_cells_where_they_can(after_s):
    """The way straight on leads over this one."""
    table = two_boxes(*SMALL, "parcel.1.x_m=-0.4", "parcel.1.y_m=-0.28", main=go_east)
    table.run(after_s)
    table.lose(23)
    table.run_until(9.0, lambda: table.program.finished)
    assert 23 not in table.crossed


def test_ways_lead_over_lost_cells_where_they_must():
    table = two_boxes(main=go_east)
    table.lose(*range(5, 55, 9))
    table.run_until(6.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.003


def test_a_parcel_on_its_way_to_a_cell_that_dies_goes_around_it():
    table = two_boxes("parcel.1.y_m=-0.23", main=go_east)
    table.run(0.7)
    table.lose(24)
    table.run_until(9.0, lambda: table.program.finished)
    assert not table.crossed & {24}
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.003
    assert not table.events("touch")


def test_a_gate_is_where_the_last_wheels_are():
    gates = Rolling(SORT18).table.gates
    assert gates["east"] == Gate("east", (0, 1), pytest.approx(0.3475), -0.1905, 0.1905, ("box",))
    assert gates["south"].outward == (1, -1)
    assert gates["south"].last_m == pytest.approx(0.127)
    assert gates["south"].place_m(0.05, 0.2) == pytest.approx((0.2, -0.177))


def test_a_parcel_that_waits_for_one_without_a_way_is_planned_anew():
    refused = []

    async def main(table):
        table.start(table["disc"].move(0.36, 0.0))
        east = table.start(table["box"].move(0.0, 0.0))
        await table.sleep(0.5)
        for order in (table.start(table["disc"].move(0.0, 0.9)), east):
            try:
                await order
            except ProgramError as error:
                refused.append(str(error))

    table = two_boxes("parcel.1.y_m=0.0", main=main)
    table.run_until(8.0, lambda: table.program.finished)
    assert len(refused) == 2
    assert "'box' has no way" in refused[1]


def test_a_parcel_that_is_stopped_half_way_off_its_infeed_goes_on():
    table = Rolling("sort54", "task.0.count=1", "stream.0.start_s=0.1")
    table.run_until(3.0, lambda: len(table.table.parcels) == 1)
    name = table.table.parcels[0].name
    table.run_until(3.0, lambda: table.pose(name)[0] > -0.25)
    table.hidden.add(name)
    table.run(0.3)
    table.put(name, -0.12, 0.0)
    table.hidden.clear()
    table.run_until(8.0, lambda: table.program.finished)


def test_ways_and_tiles_that_are_left_can_be_shown():
    table = two_boxes(main=go_east)
    table.run(0.2)
    ways, before = table.program.traffic.ways, len(table.program.traffic.reserved)
    assert ways["box"][0] == pytest.approx(table.pose("box"), abs=0.01)
    assert ways["box"][-1] == pytest.approx((0.36, 0.0, 0.0), abs=0.01)
    assert {names for *_, names in table.program.traffic.reserved} == {("box",)}
    due_in_s = table.program.traffic.due_in_s["box"]
    assert len(due_in_s) == len(ways["box"])
    assert due_in_s[0] == pytest.approx(0.0, abs=0.2)
    assert (np.diff(due_in_s) > 0).all()
    assert table.program.traffic.under_way == ["box"]
    table.run(1.5)
    assert 0 < len(table.program.traffic.reserved) < before
    table.run_until(6.0, lambda: table.program.finished)
    assert (table.program.traffic.ways, table.program.traffic.reserved) == ({}, [])


def test_plans_are_kept_for_the_record_as_they_change_and_as_tiles_are_left():
    table = two_boxes(main=go_east)
    host = SimpleNamespace(program=table.program, goals={})
    log = PlanLog(host)
    for cycle in range(1, 301):
        table.run(0.02)
        host.goals = {name: one.goal for name, one in table.program.controllers.items()}
        log.look(0.02 * cycle)
    under_way = [plan for plan in log.plans if plan.ways]
    tiles = [len(plan.tiles) for plan in under_way]
    assert tiles == sorted(tiles, reverse=True)
    assert tiles[-1] < tiles[0]
    assert log.plans[-1].ways == {}
    # The goal, the way, twice a second of it, and its end.
    assert len(log.plans) < 12
    for plan in under_way:
        assert plan.goals["box"].tolist()[:2] == [0.36, 0.0]
        assert plan.due_s["box"][-1] > plan.time_s


def test_one_of_two_that_stand_on_the_same_tile_goes_first_and_then_the_other():
    async def main(table):
        box, disc = table["box"], table["disc"]
        await table.together(box.move(0.35, 0.0), disc.move(0.0, 0.0))

    near = "parcel.0.x_m=0.0", "parcel.0.y_m=0.0", "parcel.0.yaw_rad=0.0", "parcel.1.y_m=0.0"
    # They are 8 mm apart.
    table = Rolling("swap2", *near, "parcel.1.x_m=-0.338", main=main)
    table.run_until(6.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.35, 0.0) < 0.003
    assert away_m(table.pose("disc"), 0.0, 0.0) < 0.003
    assert not table.events("touch")


def test_a_parcel_waits_for_an_obstacle_that_passes():
    table = two_boxes("parcel.1.x_m=0.36", "parcel.1.y_m=0.0", main=go_east)
    table.run(3.0)
    table.put("disc", 0.0, 0.2)
    table.run_until(6.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.003


def test_something_unknown_at_the_goal_is_named_and_waited_for():
    table = two_boxes(
        *SMALL, "parcel.1.x_m=0.36", "parcel.1.y_m=0.0", main=go_east, unknown=["disc"]
    )
    table.run(7.0)
    (notice,) = table.program.take_notices()
    assert notice.startswith("box waits, for 60 s at most: ")
    assert "'disc'" in notice
    table.hidden.add("disc")
    table.put("disc", 0.0, 0.25)
    table.run_until(6.0, lambda: table.program.finished)


def test_a_lost_parcel_that_bars_the_way_is_said_to_be_lost():
    table = two_boxes(*SMALL, "parcel.1.x_m=0.36", "parcel.1.y_m=0.0", main=go_east)
    table.run(0.05)
    table.hidden.add("disc")
    table.run_until(9.0, lambda: table.program.stuck)
    assert "blocked by 'disc' at its place" in table.program.stuck
    assert "; no sensor shows disc now" in table.program.stuck


def test_a_parcel_that_does_not_get_on_is_tried_again_until_its_obstacle_is_gone():
    table = two_boxes(main=go_east)
    table.run(0.6)
    lift(table.world.scene, 0)
    table.run(2.5)
    (notice,) = (text for text in table.program.take_notices() if "get on" in text)
    assert re.fullmatch(r"box does not get on, \d+ mm from its goal: it is tried again", notice)
    set_down(table.world.scene, 0, None, None, None)
    table.run_until(8.0, lambda: table.program.finished)
    assert away_m(table.pose("box"), 0.36, 0.0) < 0.003


def test_a_parcel_that_never_gets_on_is_stopped_after_some_tries():
    table = two_boxes(main=go_east)
    table.run(0.6)
    lift(table.world.scene, 0)
    table.run_until(15.0, lambda: table.program.stuck is not None)
    assert "mm from its goal, tried 5 times: stopped" in table.program.stuck


def test_one_that_is_gone_at_its_exit_has_left_though_its_centre_was_still_before_it():
    table = Rolling("sort54", "task.0.count=1", "stream.0.start_s=0.1")
    table.run_until(3.0, lambda: len(table.table.parcels) == 1)
    name = table.table.parcels[0].name
    table.run_until(3.0, lambda: table.pose(name)[1] > 0.2)
    table.hidden.add(name)
    table.run_until(2.0, lambda: table.program.finished)


@pytest.mark.parametrize("to", ["another exit", "a place"])
def test_an_order_that_comes_when_a_parcel_is_nearly_out_is_not_for_the_next_of_its_name(to):
    said = []

    async def order_elsewhere(parcel):
        try:
            await (parcel.leave("east") if to == "another exit" else parcel.move(0.0, 0.0))
        except ProgramError as error:
            said.append(str(error))

    async def main(table):
        first = await table.arrival()
        table.start(first.leave("north"))
        await until(lambda: table.gates["north"].out_m(*first.pose[:2]) > -0.03)
        table.start(order_elsewhere(first))
        async for parcel in table.arrivals():
            if parcel.name == first.name:
                break
            table.start(parcel.leave("north"))
        await table.sleep(2.0)

    table = Rolling("sort54", "stream.0.start_s=0.1", main=main)
    table.run_until(12.0, lambda: table.program.finished or table.program.stuck)
    assert table.program.stuck is None
    assert said == ([] if to == "another exit" else ["small 1 has left the table"])
    assert [name for _, name in table.events("exit")].count("small 1") == 1
    assert table.pose("small 1")[0] == pytest.approx(-0.345, abs=0.01)


def test_one_that_is_believed_a_moment_longer_than_it_is_there_is_in_nobodys_way():
    table = Rolling("sort54", "task.0.count=2", "stream.0.start_s=0.1")
    step, seen, cycles = table.program.references_m_s, {}, {}

    def late(beliefs, step_s):
        for name, belief in seen.items():
            cycles[name] = 0 if name in beliefs else cycles.get(name, 0) + 1
            if 0 < cycles[name] < 20:
                out = belief.pose + np.array([0.0, 0.03, 0.0])
                beliefs[name] = replace(belief, pose=out, standing=Standing.DOUBTFUL)
        seen.update((name, one) for name, one in beliefs.items() if not one.doubtful)
        return step(beliefs, step_s)

    table.program.references_m_s = late
    table.run_until(8.0, lambda: table.program.finished)


class Everywhere:
    """A tracker that goes on seeking all parcels that there are."""

    def __init__(self, parcels):
        self.parcels = dict.fromkeys(parcels)
        self.is_clear = False

    def announce(self, parcel, region=None): ...

    def depart(self, name, gate=None): ...

    def stay(self, name): ...

    def lay_there(self, name):
        return True

    def take_withdrawn(self):
        return []


def test_a_parcel_that_sets_out_for_another_place_is_not_to_leave_any_more():
    async def main(table):
        first = await table.arrival()
        table.start(first.leave("north"))
        await until(lambda: first.pose[1] > 0.1)
        await first.move(0.0, 0.0)

    table = Rolling("sort54", "stream.0.start_s=0.1", main=main)
    told = []
    tracker = Everywhere(())
    tracker.depart = lambda name, _gate: told.append((name, "leaves"))
    tracker.stay = lambda name: told.append((name, "stays"))
    table.program.attend(tracker)
    table.run_until(8.0, lambda: table.program.finished)
    assert told == [("small 1", "leaves"), ("small 1", "stays")]


def test_a_parcel_that_a_person_takes_away_from_a_full_exit_does_not_leave_once_it_is_free():
    async def main(table):
        first = await table.arrival()
        await first.leave("north")

    table = Rolling("sort54", "stream.0.start_s=0.1", main=main)
    table.table.orders.full.add("north")
    table.run_until(4.0, lambda: len(table.table.parcels) == 1)
    table.run(2.5)
    assert table.table.orders.waiting == {"small 1"}
    table.program.set_goal("small 1", GoalPose(0.1, -0.1, None))
    table.run(0.1)
    table.table.orders.full.clear()
    table.run_until(4.0, lambda: table.program.finished)
    assert away_m(table.pose("small 1"), 0.1, -0.1) < 0.003


def test_a_parcel_that_is_doubtful_has_not_left_wherever_it_is_believed():
    table = Rolling("sort54", "task.0.count=1", "stream.0.start_s=0.1")
    tracker = Everywhere(parcel.name for parcel in table.parcels)
    table.program.attend(tracker)
    step, beyond_m = table.program.references_m_s, [0.0]

    def astray(beliefs, step_s):
        if beyond_m[0]:
            for name, belief in beliefs.items():
                pose = belief.pose + np.array([0.0, beyond_m[0], 0.0])
                beliefs[name] = replace(belief, pose=pose, standing=Standing.DOUBTFUL)
        return step(beliefs, step_s)

    table.program.references_m_s = astray
    table.run_until(3.0, lambda: len(table.table.parcels) == 1)
    name = table.table.parcels[0].name
    table.run_until(3.0, lambda: table.pose(name)[1] > 0.1)
    beyond_m[0] = 0.6
    table.run(0.3)
    assert not table.program.finished
    beyond_m[0] = 0.0
    tracker.parcels.clear()
    table.run_until(5.0, lambda: table.program.finished)
    assert table.events("exit") == [("exit", name)]
