"""Random well-formed instances, checked by outlines that share no code with the planner."""

import pytest
from tests.benchmarks.host.routes import TABLES, faults, instance

COUNTS = (30, 4, 1)
DRAWS = 6


@pytest.mark.parametrize("number", range(len(TABLES)))
def test_all_arrive_and_none_touch(number: int) -> None:
    table, parcels = TABLES[number], 0
    for seed in range(COUNTS[number]):
        tasks = instance(table, seed, DRAWS, 1)
        parcels += len(tasks)
        assert not faults(table, tasks, table.planner.plan(tasks)), f"seed {seed}"
    assert parcels >= COUNTS[number]
