"""Tasks give the orders that they are for, in their order."""

import numpy as np
import pytest
from tests.host.programs.hands import Stage

from mdms_host.programs import tasks
from mdms_host.programs.order import Gate
from mdms_host.programs.table import ProgramError
from mdms_host.programs.table_orders import LineOrder
from mdms_host.programs.tasks import main_of
from mdms_model.scenario.scenario import Task


def test_two_parcels_that_change_places_are_ordered_at_once():
    stage = Stage(main_of([Task("swap", parcels=("box 1", "box 2"))]), lying=["box 1", "box 2"])
    stage.run()
    assert stage.log == [("box 1", -0.1), ("box 2", -0.3)]
    stage.arrive("box 2")
    stage.arrive("box 1")
    assert stage.program.finished


def test_each_parcel_that_comes_leaves_by_the_exit_for_its_kind_before_others_have():
    stage = Stage(main_of([Task("sort", count=3)]), coming=["box 1", "disc 1", "box 2"])
    stage.come("box 1")
    stage.come("disc 1")
    stage.leave("disc 1")
    stage.come("box 2")
    assert stage.log == [("box 1", "east"), ("disc 1", "north"), ("box 2", "east")]
    stage.leave("box 1")
    assert not stage.program.finished
    stage.leave("box 2")
    assert stage.program.finished


def test_merging_sends_whatever_comes_to_one_exit():
    stage = Stage(main_of([Task("merge", exit="east", count=2)]), coming=["box 1", "disc 1"])
    stage.come("box 1", "disc 1")
    assert stage.log == [("box 1", "east"), ("disc 1", "east")]


def test_singulating_sends_the_nearest_first_and_one_at_a_time():
    task = Task("singulate", exit="east", period_s=1.0, count=3)
    stage = Stage(main_of([task]), lying=["box 1", "box 2"], coming=["box 3"])
    stage.run(0.1)
    stage.come("box 3")
    assert stage.log == [("box 2", "east")]
    stage.leave("box 2")
    assert stage.log == []
    stage.run(1.0)
    assert stage.log == [("box 1", "east")]
    stage.run(2.0)
    stage.leave("box 1")
    assert stage.log == [("box 3", "east")]
    stage.leave("box 3")
    stage.run(1.0)
    assert stage.program.finished


PLACES = ((0.0, 0.1), (0.2, 0.1))


def test_a_buffer_lets_the_first_out_first_once_it_is_full():
    task = Task("buffer", exit="east", places=PLACES, count=3)
    stage = Stage(main_of([task]), coming=["box 1", "box 2", "box 3"])
    stage.come("box 1")
    stage.come("box 2")
    assert stage.log == [("box 1", 0.0), ("box 2", 0.2)]
    stage.arrive("box 1")
    stage.come("box 3")
    assert stage.log == [("box 1", "east")]
    stage.leave("box 1")
    assert stage.log == [("box 2", "east"), ("box 3", 0.0)]
    stage.leave("box 2")
    assert stage.log == [("box 3", "east")]
    stage.leave("box 3")
    assert stage.program.finished


def test_a_buffer_lets_out_by_name_or_kind():
    task = Task("buffer", exit="east", places=PLACES, order=("disc", "box 1"))
    stage = Stage(main_of([task]), coming=["box 1", "disc 1", "box 2"])
    stage.come("box 1")
    stage.run(1.0)
    assert stage.log == [("box 1", 0.0)]
    stage.come("disc 1")
    assert stage.log == [("disc 1", 0.2), ("disc 1", "east")]
    stage.leave("disc 1")
    assert stage.log == [("box 1", "east")]
    stage.come("box 2")
    assert "box 2" in stage.hands.orders
    stage.leave("box 1")
    assert stage.program.finished
    # It ends with its order: nobody waits for the others any more.
    assert "box 2" not in stage.hands.orders


def test_a_parcel_waits_where_it_came_until_a_place_in_the_buffer_is_free():
    async def main(table):
        store = tasks.Buffer(table, PLACES[:1])
        await table.together(*(fill(table, store) for _ in range(2)), empty(table, store))

    async def fill(table, store):
        await store.put(await table.arrival())

    async def empty(table, store):
        await table.sleep(1.0)
        await store.take("east")

    stage = Stage(main, coming=["box 1", "box 2"])
    stage.come("box 1", "box 2")
    stage.run(0.5)
    assert stage.log == [("box 1", 0.0)]
    stage.run(0.6)
    assert stage.log == [("box 1", "east"), ("box 2", 0.0)]


def test_a_parcel_that_is_refused_its_way_out_of_a_buffer_keeps_its_place():
    async def main(table):
        store = tasks.Buffer(table, np.array(PLACES))
        first, second = table["box 1"], table["box 2"]
        await store.put(first)
        await store.put(second)
        with pytest.raises(ProgramError):
            await store.take("east")
        assert store.parcels == (first, second)
        assert store.is_full
        await store.take("north")

    stage = Stage(main, lying=["box 1", "box 2"])
    stage.run()
    stage.arrive("box 1")
    stage.arrive("box 2")
    stage.refuse("box 1", "box 1 has no way to east")
    assert stage.log[-2:] == [("box 1", "east"), ("box 1", "north")]


def test_a_task_that_is_broken_off_leaves_a_buffer_as_one_that_is_refused():
    async def main(table):
        store = tasks.Buffer(table, PLACES[:1])
        put = table.start(store.put(table["box 1"]))
        await table.sleep(0.1)
        put.cancel()
        assert store.parcels == ()
        await store.put(table["box 2"])
        take = table.start(store.take("east"))
        await table.sleep(0.1)
        take.cancel()
        assert store.parcels == (table["box 2"],)

    stage = Stage(main, lying=["box 1", "box 2"])
    stage.run(0.2)
    stage.arrive("box 2")
    stage.run(0.2)
    assert stage.program.finished


def test_a_parcel_that_is_refused_its_way_into_a_buffer_has_no_place_there():
    async def main(table):
        store = tasks.Buffer(table, PLACES)
        with pytest.raises(ProgramError):
            await store.put(table["box 1"])
        assert store.parcels == ()
        await store.put(table["box 1"])
        assert not store.is_full

    stage = Stage(main, lying=["box 1"])
    stage.run()
    stage.refuse("box 1", "box 1 has no way")
    stage.arrive("box 1")
    assert stage.program.finished


def test_a_parcel_that_is_put_into_a_buffer_twice_has_one_place_there():
    async def main(table):
        store = tasks.Buffer(table, PLACES)
        await store.put(table["box 1"])
        await store.put(table["box 1"])
        assert not store.is_full

    stage = Stage(main, lying=["box 1"])
    stage.run()
    stage.arrive("box 1")
    stage.arrive("box 1")
    assert stage.log == [("box 1", 0.0), ("box 1", 0.0)]
    assert stage.program.finished


def test_tasks_follow_one_another_unless_they_are_beside():
    listed = [
        Task("transport", parcel="box 1", x_m=0.1, y_m=0.0, yaw_rad=0.5),
        Task("transport", parcel="box 2", x_m=0.2, y_m=0.0, beside=True),
        Task("wait", period_s=0.5),
        Task("transport", parcel="box 1", x_m=0.3, y_m=0.0),
    ]
    stage = Stage(main_of(listed), lying=["box 1", "box 2"])
    stage.run()
    assert stage.log == [("box 1", 0.1), ("box 2", 0.2)]
    stage.arrive("box 2")
    stage.run(1.0)
    assert stage.log == []
    stage.arrive("box 1")
    stage.run(0.4)
    assert stage.log == []
    stage.run(0.2)
    assert stage.log == [("box 1", 0.3)]


def carry_out_all(stage):
    """Carry out all orders; the parcels that have left."""
    left = []
    for _ in range(8):
        for name in list(stage.hands.orders):
            if isinstance(stage.hands.orders[name].goal, Gate):
                stage.leave(name)
                left.append(name)
            else:
                stage.arrive(name)
        stage.run(0.1)
    return left


def test_a_buffer_lets_the_only_parcel_out():
    task = Task("buffer", exit="east", places=PLACES, count=1)
    stage = Stage(main_of([task]), coming=["box 1"])
    stage.come("box 1")
    assert not stage.program.finished
    assert carry_out_all(stage) == ["box 1"]
    assert stage.program.finished


@pytest.mark.parametrize(
    "task",
    [
        Task("sort", count=2),
        Task("singulate", exit="east", count=2),
        Task("buffer", exit="east", places=PLACES, count=2),
        Task("buffer", exit="east", places=PLACES, order=("box 2", "box 1")),
        Task("buffer", exit="east", places=PLACES, order=("box 2", "box 1"), count=2),
    ],
    ids=["sort", "singulate", "buffer", "buffer in order", "so many in order"],
)
@pytest.mark.parametrize("first", ["box 1", "box 2"])
def test_a_parcel_that_was_found_by_mistake_does_not_count(task, first):
    stage = Stage(main_of([task]), coming=["box 1", "box 2"])
    second = "box 2" if first == "box 1" else "box 1"
    stage.come(first)
    stage.withdraw(first)
    stage.come(second)
    stage.come(first)
    left = carry_out_all(stage)
    assert stage.program.stuck is None
    assert stage.program.finished
    assert sorted(left) == ["box 1", "box 2"]


def test_a_buffer_goes_on_without_a_parcel_that_an_order_of_the_plant_has_taken_out():
    stage = Stage(
        main_of([Task("buffer", exit="east", places=PLACES, count=2)]), coming=["box 1", "box 2"]
    )
    stage.program.table.orders.begin_run()
    stage.program.serve_orders()
    stage.come("box 1")
    stage.arrive("box 1")
    stage.program.table.orders.give(LineOrder("o1", "box 1", "north"))
    stage.run(0.1)
    stage.leave("box 1")
    stage.come("box 2")
    assert carry_out_all(stage) == ["box 2"]
    assert stage.program.stuck is None
