"""Places where a parcel can stand aside while others pass."""

from collections.abc import Iterator

import numpy as np

from mdms_host.routes.errand import Errand
from mdms_model.arrays import Bools, Floats

#: So many places are tried, the nearest first.
_TRIES = 16


def places_aside(errand: Errand, blocked: Bools) -> Iterator[tuple[int, Floats]]:
    """Nodes of the lattice and their poses, turned about as the parcel is, free of these tiles.

    They are more than a step from each other, so that few are tried.
    """
    lattice, tiles = errand.ways.lattice, errand.ground.tiles
    start = errand.roadmap.start
    apart_m = 2 * lattice.step * tiles.side_m
    yaw = int(np.argmin(np.abs(np.array(lattice.yaws_rad) - start[2])))
    own = yaw * lattice.places + np.arange(lattice.places)
    own = own[errand.ways.on_table[own]]
    stand = errand.ways.stand_tile[errand.ways.stand[yaw] : errand.ways.stand[yaw + 1]]
    own = own[~blocked[lattice.bases[own][:, None] + stand].any(axis=1)]
    poses = lattice.poses[own]
    away_m = np.hypot(*(poses[:, :2] - start[:2]).T)
    tried: list[Floats] = []
    for index in np.argsort(away_m, kind="stable").tolist():
        pose = poses[index]
        if all(np.hypot(*(pose - other)[:2]) > apart_m for other in tried):
            tried.append(pose)
            yield int(own[index]), pose + np.array([0.0, 0.0, errand.turned_rad])
        if len(tried) == _TRIES:
            return
