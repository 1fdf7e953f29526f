"""Random well-formed instances, checked by outlines that share no code with the planner."""

import pytest
from tests.benchmarks.host._route_instances import TABLES, instance
from tests.benchmarks.host._route_outlines import faults

COUNTS = (30, 4, 1)


@pytest.mark.parametrize("number", range(len(TABLES)))
def test_all_arrive_and_none_touch(number: int) -> None:
    table = TABLES[number]
    for seed in range(COUNTS[number]):
        tasks = instance(table, seed)
        assert not faults(table.size_m, tasks, table.planner.plan(tasks)), f"seed {seed}"


def test_instances_are_of_as_many_parcels_as_are_asked_for() -> None:
    assert [len(instance(TABLES[1], 1, parcels)) for parcels in (1, 8)] == [1, 8]
