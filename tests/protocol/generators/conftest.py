"""Frames that data sheet and database are read by."""

import random

import pytest

from mdms_protocol import pdo


@pytest.fixture
def recorded_log():
    """Frames of all default PDOs of three nodes: map, node, the values carried, data."""
    chance = random.Random(7)
    maps = (pdo.TARGET_VELOCITY, pdo.CONTROLWORD, pdo.ACTUAL_VELOCITY, pdo.STATUS)
    log = []
    for _ in range(500):
        carried = chance.choice(maps)
        node_id = chance.choice((1, 7, 18))
        values = tuple(chance.randint(entry.low, entry.high) for entry in carried.entries)
        log.append((carried, node_id, values, carried.encode(values)))
    return log
