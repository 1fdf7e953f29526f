"""The arrays that the compiled steps work on, and how parcels come to rest on wheels in them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Grid
from mdms_model.arrays import Floats, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import Place, cells_near, covers, halfway, place_of
from mdms_model.supports import press
from mdms_model.symmetric3 import Vector
from mdms_sim.physics.plane.contact import Pushes
from mdms_sim.physics.plane.wheels import NOBODY


class Scene(NamedTuple):
    """All that a step reads and writes.

    The lists from `support` on hold the supports of all parcels, one parcel after the other: each
    one's wheel, place from the centre of mass and normal force (W,); and their lines (2 W,), for
    each parcel first those of the drives, then of the rollers.
    """

    grid: Grid
    first: NDArray[np.int64]
    wheels: Records
    parcels: Records
    edges: Floats
    gravity_m_s2: float
    order: NDArray[np.int64]
    """Parcels by their left end."""
    touches: Records
    """Where parcels may touch in this step: records of type TOUCH."""
    tally: NDArray[np.int64]
    """How many touches are listed, and how many pairs touched in the last step."""
    partners: NDArray[np.int64]
    """The pairs that touched in the last step."""
    support: NDArray[np.int64]
    spot_m: Floats
    normal_n: Floats
    jacobian: Floats
    line: Floats
    piece: NDArray[np.int8]


@compiled
def rest_parcels(scene: Scene, step_s: float) -> bool:
    """Find where each parcel rests half a step ahead; True when one begins to tip."""
    for w in range(scene.wheels.size):
        wheel = scene.wheels[w]
        wheel.parcel = NOBODY
        wheel.contact = 0
        wheel.normal_n = 0.0
        wheel.force_n = 0.0
        wheel.slip_m_s = 0.0
    tipping = False
    end = 0
    for p in range(scene.parcels.size):
        body = scene.parcels[p]
        pose = halfway(body, step_s)
        body.first = end
        body.supports = find_supports(scene, p, place_of(body, pose))
        end += body.supports
        tipping |= not load_supports(scene, body, pose)
    return tipping


@compiled
def find_supports(scene: Scene, p: int, place: Place) -> int:
    """List the wheels under parcel p at this place; return how many."""
    body, end = scene.parcels[p], scene.parcels[p].first
    left, right, low, high = cells_near(body, scene.grid, place)
    for row in range(low, high):
        for column in range(left, right):
            cell = row * scene.grid.columns + column
            for w in range(scene.first[cell], scene.first[cell + 1]):
                wheel = scene.wheels[w]
                if wheel.parcel == NOBODY and covers(
                    body, scene.edges, place, wheel.x_m, wheel.y_m
                ):
                    wheel.parcel = p
                    scene.support[end] = w
                    end += 1
    return int(end - body.first)


@compiled
def load_supports(scene: Scene, body: Records, pose: Vector) -> bool:
    """Levers and normal forces of a parcel's supports; False when it begins to tip."""
    first, end = body.first, body.first + body.supports
    rollers = False
    for i in range(first, end):
        wheel = scene.wheels[scene.support[i]]
        x, y = wheel.x_m - pose[0], wheel.y_m - pose[1]
        scene.spot_m[i, 0], scene.spot_m[i, 1] = x, y
        _aim(scene.jacobian[first + i], x, y, wheel.direction_x, wheel.direction_y)
        rollers |= wheel.roller_friction > 0.0
    body.lines = body.supports
    if rollers:
        _aim_rollers(scene, body)
    stands = press(
        scene.spot_m[first:end], body.mass_kg * scene.gravity_m_s2, scene.normal_n[first:end]
    )
    falls = not stands and body.tipped == 0
    if falls:
        body.tipped = 1
    return not falls


@compiled
def _aim_rollers(scene: Scene, body: Records) -> None:
    """Lines across the drives' directions, in which the rollers run."""
    body.lines = 2 * body.supports
    for i in range(body.first, body.first + body.supports):
        wheel = scene.wheels[scene.support[i]]
        row = scene.jacobian[body.first + body.supports + i]
        _aim(row, scene.spot_m[i, 0], scene.spot_m[i, 1], -wheel.direction_y, wheel.direction_x)


@compiled
def _aim(row: Floats, x_m: float, y_m: float, direction_x: float, direction_y: float) -> None:
    """Row of the Jacobian of a push along a direction at a point seen from the centre of mass."""
    row[0] = direction_x
    row[1] = direction_y
    row[2] = x_m * direction_y - y_m * direction_x


@compiled
def pushes_on(scene: Scene, body: Records) -> Pushes:
    """The lines of one parcel's supports."""
    first = 2 * body.first
    end = first + body.lines
    return Pushes(scene.jacobian[first:end], scene.line[first:end], scene.piece[first:end])
