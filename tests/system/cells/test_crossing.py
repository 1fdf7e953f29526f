"""Boxes whose ways cross: two while a tenth of all frames is lost, four on full buses."""

import numpy as np
from tests.benchmarks.cells.crossing import TABLES, boxes_of
from tests.system.cells.neighbour_host import Box, run, scenario_of

from mdms_protocol.neighbours import frames as wire

LOSS = "{kind='loss', probability=0.1, start_s=1.5}"


def test_boxes_that_brake_for_each_other_on_a_bad_bus_do_not_touch():
    # In this case of the benchmark one box turned as it braked, by a wheel that had just joined.
    boxes = boxes_of(2, 1)
    finished = run(scenario_of(boxes, *TABLES[2], seed=1, faults=[LOSS]), boxes, 3.8)
    assert not finished.touches


def test_boxes_that_meet_where_buses_are_full_do_not_touch():
    # Cells of the next bus had stayed off under a box, which the others turned into another.
    boxes = boxes_of(4, 1)
    finished = run(scenario_of(boxes, *TABLES[4], seed=1), boxes, 6.5)
    assert not finished.touches


def test_a_box_at_the_highest_speed_of_the_wire_stands_before_another():
    # Its cells ask for those a pitch away. The other lies 12 mm behind the next square.
    fast = Box((-0.42, 0.0, 0.0), (0.55, 0.0, 0.0), speed_m_s=1.27)
    other = Box((0.3425, 0.0, 0.0), (0.3425, 0.0, 0.0))
    finished = run(scenario_of([fast, other], 9, 3), [fast, other], 5.0, still_after_s=1.5)
    assert not finished.touches
    assert finished.is_held()


def test_a_box_that_an_emergency_stop_has_held_begins_anew_and_stands_before_another():
    # Its cells had gone on to reckon with the speed that they would have had by then.
    box = Box((0.006, 0.0, 0.0), (0.42, 0.0, 0.0), speed_m_s=0.25, acceleration_m_s2=0.44)
    other = Box((0.335, 0.0, 0.0), (0.335, 0.0, 0.0))
    pressed = "{kind='supply', start_s=1.0, duration_s=1.0, brake=true}"
    table = scenario_of([box, other], 9, 3, faults=[pressed])
    finished = run(table, [box, other], 5.0, reset_s=2.5)
    assert not finished.touches
    assert finished.record.pose[-1, 0, 0] > box.start[0] + 0.02


def test_a_box_that_waits_without_a_host_stays_clear_of_the_cell_that_it_waits_for():
    # It had come over that by a hair, and so had it before its turn.
    box = Box((-0.23, 0.0, 0.0), (0.2, 0.0, 0.0), speed_m_s=0.2, flags=wire.GO_ON)
    other = Box((0.2425, 0.0, 0.0), (0.2425, 0.0, 0.0), flags=wire.GO_ON)
    table = scenario_of([box, other], 6, 1, faults=["{kind='host', start_s=1.2}"])
    finished = run(table, [box, other], 4.0, still_after_s=1.4)
    assert finished.is_held()
    apart_m = np.diff(finished.record.pose[-1, :, 0]) - box.length_m
    assert 0.02 < apart_m < 0.04
