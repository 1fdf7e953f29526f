"""The calls of a table that programs use, and the times at which programs go on."""

from fractions import Fraction

import numpy as np
import pytest
from tests.host.programs.hands import Stage

from mdms_host.motion.goal import GoalPose
from mdms_host.programs.table import ProgramError
from mdms_host.programs.tasks import singulate


def test_a_program_begins_when_its_parcels_are_found_and_ends_when_they_are_there():
    async def main(table):
        await table["box 1"].move(0.1, 0.0)

    stage = Stage(main, lying=["box 1"])
    lying = stage.beliefs.pop("box 1")
    stage.run(1.0)
    assert stage.log == []
    stage.beliefs["box 1"] = lying
    stage.run()
    assert stage.log == [("box 1", 0.1)]
    assert not stage.program.finished
    stage.arrive("box 1")
    assert stage.program.finished
    assert stage.program.stuck is None


def test_a_parcel_that_comes_is_returned_once_and_one_that_leaves_is_gone():
    seen = []

    async def main(table):
        async for parcel in table.arrivals():
            seen.append((parcel.name, parcel.kind, parcel.pose[0]))
            await parcel.leave()
            seen.append((parcel.name, parcel.has_left, len(table.parcels)))

    stage = Stage(main, coming=["box 1", "disc 1"])
    stage.run()
    assert stage.program.endless
    stage.come("disc 1")
    assert stage.log == [("disc 1", "north")]
    stage.leave("disc 1")
    stage.come("disc 1")
    stage.leave("disc 1")
    assert seen == [("disc 1", "disc", -0.3), ("disc 1", True, 0)] * 2
    assert not stage.program.finished


def test_a_job_is_endless_by_what_it_waits_for_and_not_by_what_waits_beside_it():
    async def listener(table):
        await table.signal("button")

    async def beside(table):
        table.start(listener(table))
        await table["box 1"].move(0.1, 0.0)

    async def awaited(table):
        await table.together(listener(table), table["box 1"].move(0.1, 0.0))

    for main, endless in ((beside, False), (awaited, True)):
        stage = Stage(main, lying=["box 1"])
        stage.run(0.1)
        assert stage.program.endless == endless
        assert not stage.program.finished


def test_tasks_that_await_each_other_wait_for_nothing_outside():
    async def main(table):
        tasks = {}

        async def awaits(name):
            await tasks[name]

        tasks["a"], tasks["b"] = table.start(awaits("b")), table.start(awaits("a"))
        await tasks["a"]

    stage = Stage(main, lying=["box 1"])
    stage.run(0.1)
    assert not stage.program.endless


def test_time_is_the_cycles_own():
    times = []

    async def main(table):
        await table.sleep(0.5)
        times.append(table.now_s)

    stage = Stage(main)
    stage.run(2.0)
    assert times == [pytest.approx(0.51)]


def test_a_new_order_takes_the_place_of_the_last():
    async def main(table):
        one = table.start(table["box 1"].move(0.1, 0.0))
        await table.sleep(0.1)
        await table["box 1"].move(0.2, 0.0)
        assert one.done

    stage = Stage(main, lying=["box 1"])
    stage.run(0.2)
    assert stage.log == [("box 1", 0.1), ("box 1", 0.2)]
    stage.arrive("box 1")
    assert stage.program.finished


def test_a_refusal_can_be_caught_or_ends_the_program_in_order():
    async def careful(table):
        with pytest.raises(ProgramError, match="is lost"):
            await table["box 1"].move(0.1, 0.0)

    async def careless(table):
        await table["box 1"].move(0.1, 0.0)

    stages = [Stage(main, lying=["box 1"]) for main in (careful, careless)]
    for stage in stages:
        stage.run()
        stage.refuse("box 1", "box 1 is lost")
        stage.run(0.3)
    assert stages[0].program.finished
    line = careless.__code__.co_firstlineno + 1
    told = f"the program was broken off: box 1 is lost, in careless (test_table.py, line {line})"
    assert stages[1].program.stuck == told
    assert stages[1].hands.stopped
    assert stages[1].program.take_notices() == [told]


@pytest.mark.parametrize(
    ("wish", "text"),
    [
        (lambda table: table["box 9"].move(0.0, 0.0), "no parcel 'box 9'.* are: box 1"),
        (lambda table: table["box 1"].leave("west"), "no exit 'west'; there are: east, no"),
        (lambda table: singulate(table, "west"), "no exit 'west'; there are: east, no"),
        (lambda table: table["can 1"].leave(), "no exit is for parcels of the kind 'can'"),
    ],
)
def test_a_missing_parcel_is_named(wish, text):
    async def main(table):
        await wish(table)

    stage = Stage(main, lying=["box 1", "can 1"])
    stage.run(0.3)
    with pytest.raises(AssertionError, match=text):
        raise AssertionError(stage.program.stuck)


@pytest.mark.parametrize(
    "place",
    [
        (float("nan"), 0.0),
        ("0.1", 0.0),
        (0.0, 0.0, float("inf")),
        (0.0, 0.0, ""),
        (0.0, 0.0, []),
        (10**400, 0.0),
        (0.0, 1e308),
        (np.timedelta64(1, "s"), 0.0),
    ],
)
def test_a_place_that_is_no_number_is_refused_before_the_cycle_reckons_with_it(place):
    refused = []

    async def main(table):
        try:
            await table["box 1"].move(*place)
        except ProgramError as error:
            refused.append(str(error))

    stage = Stage(main, lying=["box 1"])
    stage.run()
    assert stage.log == []
    assert "must be a number" in refused[0]


def test_a_time_to_sleep_that_is_negative_is_refused():
    async def main(table):
        await table.sleep(-1)

    stage = Stage(main)
    stage.run(0.3)
    assert "the time to sleep [s] is -1, but must be at least 0" in stage.program.stuck


def test_a_number_of_any_type_is_a_float_in_the_cycle():
    async def main(table):
        await table["box 1"].move(Fraction(1, 10), np.float32(0.5), Fraction(1, 4))

    stage = Stage(main, lying=["box 1"])
    stage.run()
    goal = stage.hands.orders["box 1"].goal
    assert [type(each) for each in (goal.x_m, goal.y_m, goal.yaw_rad)] == [float] * 3
    assert (goal.x_m, goal.y_m, goal.yaw_rad) == (0.1, 0.5, 0.25)


def test_an_error_of_the_programs_own_ends_it_and_is_named_with_its_place():
    async def main(table):
        await table.sleep(0.05)
        table.parcels[7]

    stage = Stage(main, lying=["box 1"])
    stage.hands.at_rest = False
    stage.run(0.1)
    (notice,) = stage.program.take_notices()
    assert "the program failed: IndexError: tuple index out of range, in main (test_t" in notice
    assert (stage.program.failed, stage.program.stuck) == (True, None)
    assert stage.hands.stopped
    stage.hands.at_rest = True
    stage.run(0.3)
    assert stage.program.stuck == notice
    assert not stage.program.finished


def test_an_error_of_the_programs_own_ends_what_goes_on_together_with_it_at_once():
    async def fails(table):
        await table.sleep(0.05)
        table.parcels[7]

    async def main(table):
        await table.together(table["box 1"].move(0.1, 0.0), fails(table))

    stage = Stage(main, lying=["box 1"])
    stage.run(0.5)
    assert "the program failed: IndexError" in (stage.program.stuck or "")


def test_what_goes_on_together_is_broken_off_with_the_task_that_waits_for_it():
    async def main(table):
        parcels = table["box 1"], table["box 2"]
        together = table.start(table.together(*(parcel.move(0.1, 0.0) for parcel in parcels)))
        await table.sleep(0.1)
        together.cancel()

    stage = Stage(main, lying=["box 1", "box 2"])
    stage.run(0.05)
    assert [*stage.hands.orders] == ["box 1", "box 2"]
    stage.run(0.2)
    assert not stage.hands.orders
    assert stage.program.finished


async def awaits_in_finally(table):
    try:
        await table.sleep(100.0)
    finally:
        await table.sleep(0.1)


async def catches_all(table):
    while True:
        try:
            await table.sleep(100.0)
        except:  # noqa: E722
            await table.sleep(0.1)
            return


async def fails_in_finally(table):
    try:
        await table.sleep(100.0)
    finally:
        raise ValueError


@pytest.mark.parametrize("beside", [awaits_in_finally, catches_all, fails_in_finally])
def test_a_program_is_broken_off_whatever_its_other_tasks_do_then(beside):
    async def main(table):
        table.start(beside(table))
        await table.sleep(0.05)
        raise ProgramError("there is no way")

    stage = Stage(main, lying=["box 1"])
    stage.run(1.0)
    assert stage.hands.stopped
    assert stage.program.stuck.startswith("the program was broken off: there is no way")
    assert not stage.program.failed


def test_a_program_that_goes_round_without_waiting_fails_and_to_sleep_is_to_wait():
    async def round_and_round(table):
        while True:
            await table.start(nothing())

    async def nothing():
        pass

    async def sleepless(table):
        while True:
            await table.sleep(0.0)

    stages = [Stage(main) for main in (round_and_round, sleepless)]
    for stage in stages:
        stage.run(0.3)
    assert "goes round without waiting for anything" in stages[0].program.stuck
    assert stages[1].program.stuck is None


def test_it_is_said_where_a_program_waits():
    async def main(table):
        await table["box 1"].move(0.1, 0.0)

    stage = Stage(main, lying=["box 1"])
    stage.run(0.1)
    (where,) = stage.program.waits_at
    line = main.__code__.co_firstlineno + 1
    assert where == f"main (test_table.py, line {line})"


def test_nobody_waits_for_an_arrival_where_none_may_come():
    async def main(table):
        await table.arrival()

    stage = Stage(main, lying=["box 1"])
    stage.run(0.3)
    assert "no parcel is to come" in stage.program.stuck


def test_a_parcel_that_has_left_takes_no_goal_from_a_person():
    async def main(table):
        async for parcel in table.arrivals():
            await table.sleep(0.2)
            await parcel.leave("east")

    stage = Stage(main, coming=["box 1"])
    stage.come("box 1")
    stage.program.set_goal("box 1", GoalPose(0.1, 0.0))
    stage.run()
    stage.arrive("box 1")
    stage.run(0.3)
    stage.leave("box 1")
    stage.log.clear()
    with pytest.raises(KeyError):
        stage.program.set_goal("box 1", GoalPose(-0.1, 0.0))
    stage.come("box 1")
    assert stage.log == []
