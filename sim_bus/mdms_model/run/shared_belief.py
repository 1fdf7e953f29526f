"""Where cells, and the host, believe a parcel to be, and how far that is off."""

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.run.record import Record
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_protocol.neighbours import frames as wire


def shared_belief(record: Record, number: int) -> Floats:
    """The mean pose that cells under parcel `number` (from 0) report, shape (T, 3).

    NaN where no cell under it reports one, and in a run without a neighbour layer.
    """
    if record.identity is None or record.state is None or record.belief is None:
        return np.full((len(record.time_s), 3), np.nan)
    under = (record.identity == number + 1) & (record.state == wire.UNDER)
    told = under & np.isfinite(record.belief).all(axis=2)
    count = np.count_nonzero(told, axis=1)
    x_m, y_m, yaw_rad = np.moveaxis(np.where(told[..., None], record.belief, 0.0), 2, 0)
    # Yaws are told within a turn: their mean is that of their directions.
    ahead, aside = (np.where(told, part(yaw_rad), 0.0).sum(axis=1) for part in (np.cos, np.sin))
    with np.errstate(invalid="ignore"):
        place_m = [part.sum(axis=1) / count for part in (x_m, y_m)]
    turned = np.where(count > 0, np.arctan2(aside, ahead), np.nan)
    return np.stack((*place_m, turned), axis=1)


def belief_error(record: Record, number: int, parcel: Parcel) -> Floats:
    """How far the shared belief is off: distance [m] and size of the turn [rad], shape (T, 2).

    A disc's turn cannot be seen: NaN.
    """
    return _error(shared_belief(record, number) - record.pose[:, number], parcel)


def host_error(scenario: Scenario, record: Record, number: int) -> Floats:
    """The same of the coordinator's belief; NaN without one.

    Parcels of one kind are alike: a belief is of that to which it is nearest, whatever its name.
    """
    parcel, samples = scenario.parcel[number], len(record.time_s)
    if record.estimate is None:
        return np.full((samples, 2), np.nan)
    alike = [
        other
        for other, each in enumerate(scenario.parcel)
        if other == number or (each.kind and each.kind == parcel.kind)
    ]
    believed, true = record.estimate[:, alike], record.pose[:, alike]
    apart_m = np.hypot(*np.moveaxis(believed[:, :, None, :2] - true[:, None, :, :2], 3, 0))
    apart_m = np.nan_to_num(apart_m, nan=np.inf)
    mine = alike.index(number)
    of_mine = np.argmin(apart_m, axis=2) == mine
    nearest = np.argmin(np.where(of_mine, apart_m[:, :, mine], np.inf), axis=1)
    every = np.arange(samples)
    away = believed[every, nearest] - record.pose[:, number]
    away[~of_mine[every, nearest]] = np.nan
    return _error(away, parcel)


def _error(away: Floats, parcel: Parcel) -> Floats:
    turn_rad = abs((away[:, 2] + np.pi) % (2 * np.pi) - np.pi)
    if parcel.shape == "disc":
        turn_rad[:] = np.nan
    return np.stack((np.hypot(away[:, 0], away[:, 1]), turn_rad), axis=1)


def cell_counts(record: Record) -> dict[int, Floats]:
    """How many cells are under parcels, promised and near, by the state's code, each (T,)."""
    if record.state is None:
        return {}
    return {
        state: np.count_nonzero(record.state == state, axis=1).astype(float)
        for state in (wire.UNDER, wire.PROMISED, wire.NEAR)
    }
