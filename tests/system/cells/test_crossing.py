"""Two boxes whose ways cross, while a tenth of all frames is lost."""

from tests.benchmarks.cells.crossing import TABLES, boxes_of
from tests.system.cells.neighbour_host import run, scenario_of

LOSS = "{kind='loss', probability=0.1, start_s=1.5}"


def test_boxes_that_brake_for_each_other_on_a_bad_bus_do_not_touch():
    # In this case of the benchmark one box turned as it braked, by a wheel that had just joined.
    boxes = boxes_of(2, 1)
    finished = run(scenario_of(boxes, *TABLES[2], seed=1, faults=[LOSS]), boxes, 3.8)
    assert not finished.touches
