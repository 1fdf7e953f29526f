"""How parcels rest on wheels: which carry each, where from its centre of mass, and how much."""

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled, inlined
from mdms_model.parcel import Place, cells_near, covers, place_of
from mdms_model.statics.supports import press
from mdms_model.symmetric3 import Vector
from mdms_sim.physics.plane.records import NOBODY, STANDS, TIPS, Scene, halfway


@inlined
def rest_parcels(scene: Scene, step_s: float) -> bool:
    """Find where each parcel rests half a step ahead; True when one begins to tip.

    A lifted parcel rests on nothing, and does not tip.
    """
    for w in range(scene.state.wheels.size):
        scene.scratch.wheels[w].parcel = NOBODY
        wheel = scene.state.wheels[w]
        wheel.contact = 0
        wheel.normal_n = 0.0
        wheel.force_n = 0.0
        wheel.slip_m_s = 0.0
    tipping = False
    end = 0
    for p in range(scene.model.parcels.size):
        share = scene.scratch.parcels[p]
        share.first = end
        if scene.state.parcels[p].lifted:
            share.supports = share.lines = 0
            continue
        pose = halfway(scene, p, step_s)
        share.supports = find_supports(scene, p, place_of(scene.model.parcels[p], pose))
        end += share.supports
        tipping |= not load_supports(scene, p, pose)
    return tipping


@compiled
def find_supports(scene: Scene, p: int, place: Place) -> int:
    """List the wheels under parcel p at this place; return how many."""
    model, body, first = scene.model, scene.model.parcels[p], scene.scratch.parcels[p].first
    end = first
    left, right, low, high = cells_near(body, model.grid, place)
    for row in range(low, high):
        for column in range(left, right):
            cell = row * model.grid.columns + column
            for w in range(model.first[cell], model.first[cell + 1]):
                wheel, taken = model.wheels[w], scene.scratch.wheels[w]
                if taken.parcel == NOBODY and covers(
                    body, model.edges, place, wheel.x_m, wheel.y_m
                ):
                    taken.parcel = p
                    scene.scratch.support[end] = w
                    end += 1
    return int(end - first)


@inlined
def load_supports(scene: Scene, p: int, pose: Vector) -> bool:
    """Levers and normal forces of a parcel's supports; False when it begins to tip."""
    scratch, share, state = scene.scratch, scene.scratch.parcels[p], scene.state.parcels[p]
    first, end = share.first, share.first + share.supports
    rollers = False
    for i in range(first, end):
        wheel = scene.model.wheels[scratch.support[i]]
        x, y = wheel.x_m - pose[0], wheel.y_m - pose[1]
        scratch.spot_m[i, 0], scratch.spot_m[i, 1] = x, y
        _aim(scratch.jacobian[first + i], x, y, wheel.direction_x, wheel.direction_y)
        rollers |= wheel.roller_friction > 0.0
    share.lines = share.supports
    if rollers:
        _aim_rollers(scene, p)
    weight_n = scene.model.parcels[p].mass_kg * scene.model.gravity_m_s2
    stands = press(scratch.spot_m[first:end], weight_n, scratch.normal_n[first:end])
    falls = not stands and state.tipped == STANDS
    if falls:
        state.tipped = TIPS
    return not falls


@compiled
def _aim_rollers(scene: Scene, p: int) -> None:
    """Lines across the drives' directions, in which the rollers run."""
    scratch, share = scene.scratch, scene.scratch.parcels[p]
    share.lines = 2 * share.supports
    for i in range(share.first, share.first + share.supports):
        wheel = scene.model.wheels[scratch.support[i]]
        row = scratch.jacobian[share.first + share.supports + i]
        _aim(row, scratch.spot_m[i, 0], scratch.spot_m[i, 1], -wheel.direction_y, wheel.direction_x)


@compiled
def _aim(row: Floats, x_m: float, y_m: float, direction_x: float, direction_y: float) -> None:
    """Row of the Jacobian of a push along a direction at a point seen from the centre of mass."""
    row[0] = direction_x
    row[1] = direction_y
    row[2] = x_m * direction_y - y_m * direction_x
