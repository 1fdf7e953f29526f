"""The order in which parcels are planned, so that each has a way that it only needs to wait on."""

from dataclasses import replace

import numpy as np
from tests.benchmarks.host._route_instances import TABLES, instance
from tests.host.routes.parcels import task

from mdms_host.layout import Layout
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Planner


def test_each_of_twenty_has_a_way_past_goals_before_it_and_starts_after_it() -> None:
    table = TABLES[2]
    tasks = {each.parcel: each for each in instance(table, 23)}
    order = table.planner.plan(list(tasks.values())).order
    assert sorted(order) == sorted(tasks)
    for index, name in enumerate(order):
        taken = np.zeros(table.planner.tiles.count, dtype=bool)
        for place, other in enumerate(order):
            each = tasks[other]
            if place != index:
                pose = each.goal if place < index else each.start
                taken[table.planner.stand(each.shape, pose)] = True
        assert not table.planner.plan([tasks[name]], closed=taken).blocked


def test_first_ones_are_planned_first_where_that_does() -> None:
    planner = Planner(Tiles(Layout(9, 6)))
    one = task("one", (-0.4, 0.2, 0.0), (0.4, 0.2, 0.0))
    other = task("other", (-0.4, -0.2, 0.0), (0.4, -0.2, 0.0))
    assert planner.plan([one, other]).order == ("one", "other")
    assert planner.plan([other, one]).order == ("other", "one")


def test_a_parcel_in_the_way_at_its_start_goes_before_the_first_one() -> None:
    planner = Planner(Tiles(Layout(9, 3)))
    behind = task("behind", (-0.4, 0.0, 0.0), (0.0, 0.0, 0.0))
    ahead = task("ahead", (0.05, 0.0, 0.0), (0.4, 0.0, 0.0))
    assert planner.plan([behind, ahead]).order == ("ahead", "behind")


def test_nobody_is_blocked_but_by_those_that_cannot_come_to_their_goals() -> None:
    table = TABLES[1]
    stays, lost, *others = instance(table, 58)
    tasks = [replace(stays, goal=None), replace(lost, goal=stays.start), *others]
    plan = table.planner.plan(tasks)
    assert lost.parcel in plan.blocked
    standing = {each.parcel: each for each in tasks if each.parcel not in plan.order}
    assert len(standing) < len(tasks)
    for name in plan.blocked:
        taken = np.zeros(table.planner.tiles.count, dtype=bool)
        for other in standing.keys() - {name}:
            taken[table.planner.stand(standing[other].shape, standing[other].start)] = True
        assert table.planner.plan([standing[name]], closed=taken).blocked
