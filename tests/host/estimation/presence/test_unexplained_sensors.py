"""Which covered sensors are judged together as something new."""

import numpy as np

from mdms_host.estimation.parcel_search import Coverage, UnexplainedSensors
from mdms_host.estimation.presence import Surroundings
from mdms_host.estimation.unknowns import containing_outline_m
from mdms_host.layout import Layout

LAYOUT = Layout(9, 6)
SENSORS = len(LAYOUT.sensors_m)


def test_a_group_is_judged_once_it_is_known_what_a_parcel_left_behind() -> None:
    """A cell told of covered sensors while a parcel might reach there; that has gone on."""
    unexplained = UnexplainedSensors(LAYOUT, Surroundings(LAYOUT))
    away_m = np.hypot(*(LAYOUT.sensors_m - (-0.35, 0.0)).T)
    covered, valid, changed_s = away_m < 0.2, np.ones(SENSORS, dtype=bool), np.zeros(SENSORS)
    edge = covered & (LAYOUT.sensors_m[:, 0] > -0.23)

    def judged(now_s: float, silent_s: float, reached: np.ndarray) -> list[set[int]]:
        coverage = Coverage(SENSORS, {}, {})
        coverage.explained |= reached
        silent = np.full(SENSORS, silent_s)
        groups = unexplained.groups(now_s, covered, valid, coverage, silent)
        return [
            {*group.tolist()}
            for group in unexplained.still(now_s, groups, changed_s, at_once=False)
        ]

    nowhere = np.zeros(SENSORS, dtype=bool)
    assert judged(1.0, 0.0, edge) == [{*np.flatnonzero(covered & ~edge).tolist()}]
    assert judged(1.1, 0.15, nowhere) == []
    assert judged(1.2, 0.05, nowhere) == [{*np.flatnonzero(covered).tolist()}]


def test_what_is_judged_at_once_is_judged_while_a_parcel_moves_beside_it() -> None:
    unexplained = UnexplainedSensors(LAYOUT, Surroundings(LAYOUT))
    away_m = np.hypot(*(LAYOUT.sensors_m - (-0.35, 0.0)).T)
    thing, valid = away_m < 0.2, np.ones(SENSORS, dtype=bool)
    moving = (np.abs(LAYOUT.sensors_m - (0.02, 0.0)) < 0.15).all(axis=1)
    assert not (moving & thing).any()
    coverage = Coverage(SENSORS, {}, {})
    coverage.explained |= moving
    for changing, at_once, seen in (
        (moving, True, 1),
        (moving, False, 0),
        (~moving & ~thing, True, 0),
    ):
        changed_s = np.where(changing, 0.99, 0.0)
        groups = unexplained.groups(1.0, thing | moving, valid, coverage, np.zeros(SENSORS))
        still = unexplained.still(1.0, groups, changed_s, at_once=at_once)
        assert [group.tolist() for group in still] == [np.flatnonzero(thing).tolist()] * seen


def test_free_sensors_beside_covered_ones_bound_what_may_lie_there() -> None:
    """A convex outline that reached far behind a free sensor would cover it."""
    covered_m, above_m = np.array([[-0.05, 0.0], [0.05, 0.0]]), np.array([[0.0, 0.06]])
    alone_m = containing_outline_m(covered_m, np.empty((0, 2)), 0.3)
    bounded_m = containing_outline_m(covered_m, above_m, 0.3)
    assert bounded_m[:, 1].max() < alone_m[:, 1].max() - 0.03
    assert bounded_m[:, 1].min() == alone_m[:, 1].min()
