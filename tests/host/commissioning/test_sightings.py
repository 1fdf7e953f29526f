"""Which cell lies where, from what each saw of a plate that was moved over the table."""

from itertools import pairwise

import numpy as np
import pytest

from mdms_host.commissioning.sightings import SightingError, Sightings
from mdms_host.layout import Layout

STEP_M = 0.01


def presence(layout, plate, centre_m, turn_rad=0.0):
    """Presence bits of all cells under a rectangle, or a disc where `plate` is a diameter."""
    away = layout.sensor_positions_m - centre_m
    if np.isscalar(plate):
        covered = np.hypot(away[..., 0], away[..., 1]) < plate / 2
    else:
        along = away @ [np.cos(turn_rad), np.sin(turn_rad)]
        across = away @ [-np.sin(turn_rad), np.cos(turn_rad)]
        covered = (np.abs(along) < plate[0] / 2) & (np.abs(across) < plate[1] / 2)
    return (covered @ (1 << np.arange(layout.sensor_positions_m.shape[1]))).tolist()


def moved(layout, keys, plate, way, *, turn_rad=0.0, seen=None):
    """Sightings of a plate along a polyline; a cell reports when its bits change."""
    sightings = Sightings(layout.sensor_offsets_m)
    before = [0] * layout.cells
    for start, end in pairwise(way):
        start_m, end_m = np.array(start), np.array(end)
        steps = max(1, int(np.hypot(*(end_m - start_m)) / STEP_M))
        for share in np.linspace(0.0, 1.0, steps + 1):
            bits = presence(layout, plate, start_m + share * (end_m - start_m), turn_rad)
            for cell in range(layout.cells):
                new = bits[cell] if seen is None else seen(cell, bits[cell])
                if new != before[cell]:
                    sightings.on_presence(keys[cell], new)
                    before[cell] = new
    return sightings


def snake(layout, between=1):
    """Along every row, and between rows, there and back."""
    x_m, y_m = np.abs(layout.cell_positions_m).max(axis=0)
    rows = np.linspace(-y_m, y_m, (layout.rows - 1) * between + 1)
    way = []
    for number, row_m in enumerate(rows):
        ends = [(-x_m - 0.05, row_m), (x_m + 0.05, row_m)]
        way += ends[:: -1 if number % 2 else 1]
    return way


def truth(layout, keys):
    return {
        keys[cell]: (cell % layout.columns + 1, cell // layout.columns + 1)
        for cell in range(layout.cells)
    }


def keys_of(layout, seed=1):
    """Serial numbers in no order."""
    return np.random.default_rng(seed).permutation(1000)[: layout.cells].tolist()


@pytest.mark.parametrize("plate", [(0.15, 0.15), (0.18, 0.12), (0.10, 0.17), 0.16])
@pytest.mark.parametrize("turn_rad", [0.0, 0.2])
def test_all_places_are_found_from_one_way_over_rows_and_between_them(plate, turn_rad):
    layout = Layout(6, 3)
    keys = keys_of(layout)
    sightings = moved(layout, keys, plate, snake(layout, between=2), turn_rad=turn_rad)
    assert sightings.grid() == truth(layout, keys)


@pytest.mark.parametrize("seed", range(20))
def test_a_hand_that_goes_anywhere_shows_the_same(seed):
    layout = Layout(4, 3)
    keys = keys_of(layout, seed)
    random = np.random.default_rng(seed)
    way = random.uniform((-0.3, -0.2), (0.3, 0.2), (80, 2))
    sightings = moved(layout, keys, (0.16, 0.14), way, turn_rad=random.uniform(-0.3, 0.3))
    assert sightings.grid() == truth(layout, keys)


def test_a_row_alone_is_a_grid_of_one_row():
    layout = Layout(5, 1)
    keys = keys_of(layout)
    assert moved(layout, keys, (0.15, 0.15), snake(layout)).grid() == truth(layout, keys)


def test_a_cell_not_seen_with_another_is_left_out():
    layout = Layout(6, 3)
    keys = keys_of(layout)
    first_row = snake(layout)[:2]
    sightings = moved(layout, keys, (0.15, 0.08), first_row)
    assert sightings.seen == set(keys[:6])
    assert sightings.grid() == {key: (place + 1, 1) for place, key in enumerate(keys[:6])}


def test_a_cell_mounted_the_other_way_round_fits_no_grid():
    layout = Layout(3, 3)
    keys = keys_of(layout)

    def turned(cell, bits):
        if cell != 4:
            return bits
        around = bits >> 1
        return bits & 1 | ((around << 2 | around >> 2) & 0xF) << 1

    sightings = moved(layout, keys, (0.15, 0.15), snake(layout, between=2), seen=turned)
    with pytest.raises(SightingError, match="mounted the other way round"):
        sightings.grid()


def test_a_grid_of_nothing_is_empty():
    assert Sightings(Layout(1, 1).sensor_offsets_m).grid() == {}
