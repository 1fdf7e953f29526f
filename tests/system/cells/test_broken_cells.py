"""One cell is broken while a box is on its way: the motion of the box, and the named cell."""

import numpy as np
from tests.system.cells.neighbour_host import Box, run, scenario_of

BOX = Box((-0.10, 0.0, 0.0), (0.03, 0.01, 0.2), 0.36, 0.30)
START_S = 1.37
#: Cells and wheels of a cell.
CELLS, AXES = 18, 2


def broken(cell, fault, until_s=4.2, places=None):
    faults = [f"{{{fault}, cells=[{cell}], start_s={START_S}}}"] if fault else []
    return run(scenario_of([BOX], faults=faults), [BOX], until_s, places, still_after_s=2.0)


def voltage_v(finished, cell):
    return abs(finished.record.voltage_v.reshape(-1, CELLS, AXES)[:, cell - 1]).max(axis=1)


def test_box_stands_before_a_dead_cell_that_its_neighbours_name():
    finished = broken(11, "kind='off'")
    assert finished.stands()
    assert not finished.arrived()
    assert finished.is_held()
    assert not finished.claims_arrival()
    assert {*finished.suspected} == {11}
    # It braked at once, and the motors are off.
    after = finished.record.twist[round((START_S + 0.35) * 100) :, 0]
    assert np.hypot(after[:, 0], after[:, 1]).max() < 0.005
    assert all(voltage_v(finished, cell)[-1] == 0 for cell in range(1, CELLS + 1))


def test_cell_that_has_restarted_drives_nothing_and_the_box_stands():
    finished = broken(9, "kind='off', duration_s=0.05")
    assert finished.stands()
    assert not finished.claims_arrival()
    assert voltage_v(finished, 9)[round((START_S + 0.02) * 100) :].max() == 0


def test_box_arrives_over_a_cell_that_sees_nothing():
    finished = broken(9, "kind='sensor_stuck', covered=false")
    assert finished.arrived()
    assert {*finished.suspected} == {9}
    assert len(finished.suspected[9]) > 2


def test_box_stands_on_a_cell_that_has_been_given_the_place_of_its_neighbour():
    finished = broken(9, None, 2.8, {9: 10})
    assert abs(finished.record.pose[:, 0] - BOX.start).max() < 0.005
    assert {*finished.suspected} == {9}
