"""The arrays that the compiled steps work on, and how a parcel comes to rest on wheels in them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.parcel import cells_near, covers, place_of
from mdms_sim.physics.supports import press
from mdms_sim.physics.symmetric3 import Vector
from mdms_sim.physics.wheels import Grid, Records
from mdms_sim.record import Floats


class Scene(NamedTuple):
    """All that a step reads and writes; the last five are room for one parcel's supports."""

    grid: Grid
    first: NDArray[np.int64]
    wheels: Records
    parcels: Records
    edges: Floats
    gravity_m_s2: float
    support: NDArray[np.int64]
    piece: NDArray[np.int8]
    spot_m: Floats
    jacobian: Floats
    line: Floats
    normal_n: Floats


@compiled
def find_supports(scene: Scene, body: Records, pose: Vector) -> int:
    """Note the wheels under a parcel whose centre of mass has this pose; return how many."""
    place = place_of(body, pose)
    left, right, low, high = cells_near(body, scene.grid, place)
    count = 0
    for row in range(low, high):
        for column in range(left, right):
            cell = row * scene.grid.columns + column
            for w in range(scene.first[cell], scene.first[cell + 1]):
                if covers(body, scene.edges, place, scene.wheels[w].x_m, scene.wheels[w].y_m):
                    scene.support[count] = w
                    count += 1
    return count


@compiled
def rest(scene: Scene, body: Records, pose: Vector) -> tuple[int, bool]:
    """Find a parcel's supports, levers and normal forces; tell how many and if they balance."""
    count = find_supports(scene, body, pose)
    for i in range(count):
        wheel = scene.wheels[scene.support[i]]
        x, y = wheel.x_m - pose[0], wheel.y_m - pose[1]
        scene.spot_m[i, 0], scene.spot_m[i, 1] = x, y
        scene.jacobian[i, 0] = wheel.direction_x
        scene.jacobian[i, 1] = wheel.direction_y
        scene.jacobian[i, 2] = x * wheel.direction_y - y * wheel.direction_x
    weight_n = body.mass_kg * scene.gravity_m_s2
    return count, press(scene.spot_m[:count], weight_n, scene.normal_n[:count])
