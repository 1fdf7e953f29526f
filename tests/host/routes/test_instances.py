"""Random well-formed instances, checked by outlines that share no code with the planner."""

import pytest
from tests.benchmarks.host._route_instances import TABLES, instance
from tests.benchmarks.host._route_outlines import faults
from tests.benchmarks.host.routes import held

COUNTS = (30, 4, 1)


@pytest.mark.parametrize("number", range(len(TABLES)))
def test_all_arrive_and_none_touch(number: int) -> None:
    table = TABLES[number]
    for seed in range(COUNTS[number]):
        tasks = instance(table, seed)
        plan = table.planner.plan(tasks)
        assert not faults(table.size_m, tasks, plan), f"seed {seed}"
        assert not held(plan), f"seed {seed}"


def test_others_pass_over_the_sweep_of_a_turn_while_the_turned_parcel_waits_beside_it() -> None:
    table = TABLES[2]
    assert not held(table.planner.plan(instance(table, 900_051)))


def test_instances_are_of_as_many_parcels_as_are_asked_for() -> None:
    assert [len(instance(TABLES[1], 1, parcels)) for parcels in (1, 8)] == [1, 8]
