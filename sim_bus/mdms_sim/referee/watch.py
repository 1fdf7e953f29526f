"""The referee's memory of cells and wheels, and its checks in every tick.

Cells are those of nodes, not of places. All times are of the simulation [ns].
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats, Ints, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import Place, place_of
from mdms_sim.physics.motor import applied_voltage
from mdms_sim.physics.plane.control_step import BRIDGE_SUPPLY_MIN_V, UV_PER_V, Registers

#: In place of the number of a parcel: none, and more than one.
NOBODY, SEVERAL = -1, -2


class Shapes(NamedTuple):
    """The parcels, their states and edges, and the middles of the squares (cells, 2)."""

    parcels: Records
    bodies: Records
    edges: Floats
    centres_m: Floats


@compiled
def lies_over(body: Records, edges: Floats, place: Place, middle_m: Floats, half_m: float) -> bool:
    """Whether a parcel overlaps a square about a point, by the theorem of separating axes."""
    from_x, from_y = middle_m[0] - place.x_m, middle_m[1] - place.y_m
    reach_m = body.radius_m + half_m * 1.4143
    if from_x * from_x + from_y * from_y > reach_m * reach_m:
        return False
    if body.edges == 0:
        beside_x, beside_y = max(abs(from_x) - half_m, 0.0), max(abs(from_y) - half_m, 0.0)
        return bool(beside_x**2 + beside_y**2 <= body.radius_m**2)
    left, right, low, high = np.inf, -np.inf, np.inf, -np.inf
    for e in range(body.first_edge, body.first_edge + body.edges):
        normal_x = place.cosine * edges[e, 0] - place.sine * edges[e, 1]
        normal_y = place.sine * edges[e, 0] + place.cosine * edges[e, 1]
        nearest = normal_x * from_x + normal_y * from_y
        nearest -= half_m * (abs(normal_x) + abs(normal_y))
        if nearest > edges[e, 2]:
            return False
        corner_x = place.cosine * edges[e, 3] - place.sine * edges[e, 4]
        corner_y = place.sine * edges[e, 3] + place.cosine * edges[e, 4]
        left, right = min(left, corner_x), max(right, corner_x)
        low, high = min(low, corner_y), max(high, corner_y)
    beside = left > from_x + half_m or right < from_x - half_m
    return not (beside or low > from_y + half_m or high < from_y - half_m)


@compiled
def find_parcels(shapes: Shapes, half_m: float, found: Ints) -> None:
    """Set for each place the parcel that overlaps the square about it, `NOBODY` or `SEVERAL`."""
    found[:] = NOBODY
    for p in range(shapes.parcels.size):
        constants, body = shapes.parcels[p], shapes.bodies[p]
        if body.lifted or body.away:
            continue
        place = place_of(constants, (body.x_m, body.y_m, body.yaw_rad))
        for cell in range(found.size):
            if lies_over(constants, shapes.edges, place, shapes.centres_m[cell], half_m):
                found[cell] = p if found[cell] == NOBODY else SEVERAL


NS_PER_MS = 1_000_000
#: A time that does not come.
NEVER = 1 << 62

# The last order of a controlword.
OFF, SWITCHED_ON, ENABLED = range(3)
# How a wheel that is not to be driven stops: voltage 0, quick stop, or the reaction to silence.
CUT, RAMP, REACTION = range(3)

# Bits of observations of a cell ...
NO_SETPOINT, NO_HEARTBEAT, NO_SYNC, LOW_SUPPLY, SHUT_OFF = (1 << bit for bit in range(5))
# ... and of a wheel.
DRIVEN, SPINS, COASTS, PUSHED_ALONE, PUSHED_AFTER_LEASE, PUSHED_AFTER_END, PUSHED_HUNG = (
    1 << bit for bit in range(7)
)

#: A supply below the limit for more ticks than this is a fault.
LOW_TICKS = 5
#: The same where its measurement is stuck: the host hears of it from others, and ends the run.
UNSEEN_TICKS = 50
#: A wheel that got no voltage for so many ticks has stopped.
REST_TICKS = 20
#: Bridges may sleep when their wheels have stood for 0.8 s; below this [m/s] a wheel stands.
STOOD_TICKS, STOOD_M_S = 780, 0.02
#: A push onward counts when it lasts this long: encoder steps and the loop's lag make shorter ones.
ONWARD_TICKS = 10
#: A wheel is about to stand below this [m/s], and a voltage up to the next holds it.
SLOW_M_S = 0.01
HOLD_V = 1.3
#: Share of the back-EMF, and rounding of voltages [V].
SHARE, LEAST_V = 0.5, 0.02
#: A wheel that is slower hardly turns [m/s].
TURNS_M_S = 0.05
#: From then on a wheel without a parcel rests.
QUIET_NS = 500 * NS_PER_MS
#: A voltage that turns a wheel which is to rest [V].
QUIET_V = 0.3

CELL = np.dtype(
    [
        ("setpoint_ns", "i8"),  # the last valid one, NEVER where none is due
        ("timeout_ns", "i8"),
        ("heartbeat_ns", "i8"),  # the host's last, NEVER where none is due
        ("consumer_ns", "i8"),
        ("sync_ns", "i8"),
        ("sync_limit_ns", "i8"),
        ("supply_min_v", "f8"),
        ("low_ticks", "i8"),
        ("low_limit", "i8"),
        ("shut_ticks", "i8"),
        ("shut_limit", "i8"),
        ("slow", "f8"),  # how much longer its milliseconds are
        ("steers", "i8"),  # 0x3013
        ("hung", "i8"),
        ("watchdog_ns", "i8"),
        ("lease_ns", "i8"),  # from then on no push onward, for want of estimates
        ("ended_ns", "i8"),  # from then on no voltage, for its program has ended
        ("noticed", "i8"),
    ],
    align=True,
)
WHEEL = np.dtype(
    [
        ("asked", "i8"),  # OFF, SWITCHED_ON or ENABLED
        ("stop", "i8"),  # CUT, RAMP or REACTION
        ("drove", "i8"),  # 1: it had voltage when it was stopped
        ("loose_ns", "i8"),  # any voltage is allowed until then
        ("braking_ns", "i8"),  # and braking until then
        ("awake_ns", "i8"),  # its bridge is to be awake until then
        ("idle_ns", "i8"),  # since when the target is 0
        ("from_m", "f8"),  # its travel when it was stopped
        ("way_m", "f8"),  # how far it may go on, if it carries nothing
        ("loaded", "i8"),  # 1: it has carried something since
        ("applied_v", "f8"),
        ("rest_ticks", "i8"),
        ("stood_ticks", "i8"),  # it has stood for so long since it was stopped
        ("onward_ticks", "i8"),
        ("rested", "i8"),  # 1: it has had no voltage for a while since it was stopped
        ("noted", "i8"),  # bits that are noted already
        ("noticed", "i8"),
    ],
    align=True,
)


class WatchedCells(NamedTuple):
    """Arrays of all cells (cells,), and of their axes (cells, 2)."""

    cells: Records
    wheels: Records


class Truths(NamedTuple):
    """The truth by node and by place: the parcel there and since when, bridges and wheels."""

    places: NDArray[np.intp]
    parcel: Ints
    free_ns: Ints
    awake: Registers
    shut_off: Registers
    supply_v: Floats
    first: Ints
    model: Records
    state: Records


@compiled
def look_at_tick(watched: WatchedCells, truths: Truths, now_ns: int, voltage_uv: Registers) -> int:
    """Take in the voltages (cells, 2), by places, of a tick; returns whether anything is noticed.

    `noticed` of cells and wheels has the findings.
    """
    noticed = 0
    for c in range(watched.cells.size):
        cell, p = watched.cells[c], truths.places[c]
        cell.noticed = 0
        if not cell.hung:
            _look_at_cell(cell, truths.supply_v[c], truths.shut_off[c], now_ns)
            if cell.noticed and not (watched.wheels[c, 0].asked or watched.wheels[c, 1].asked):
                cell.noticed &= ~(LOW_SUPPLY | SHUT_OFF | NO_SYNC)
        noticed |= cell.noticed
        closed = truths.awake[p] != 0 and truths.shut_off[p] == 0
        closed = closed and truths.supply_v[p] >= BRIDGE_SUPPLY_MIN_V
        for axis in range(truths.first[p + 1] - truths.first[p]):
            wheel, w = watched.wheels[c, axis], truths.first[p] + axis
            constants, now = truths.model[w], truths.state[w]
            volts = 0.0
            if closed and voltage_uv[p, axis] != 0:
                volts = voltage_uv[p, axis] / UV_PER_V
                volts = applied_voltage(volts, truths.supply_v[p], constants.pwm_steps)
            _take_in(wheel, volts, constants, now.speed_m_s)
            if cell.hung:
                if now_ns > cell.watchdog_ns and wheel.onward_ticks >= ONWARD_TICKS:
                    wheel.noticed |= PUSHED_HUNG
            elif wheel.asked == ENABLED or (wheel.asked == SWITCHED_ON and cell.steers):
                # A cell in another's place cannot know: it goes by what its neighbours tell it.
                free_ns = max(truths.free_ns[p], truths.free_ns[c])
                _look_at_driven(cell, wheel, free_ns, now_ns)
            else:
                _look_at_stopped(wheel, now_ns)
                _look_at_stopping(wheel, now, closed, truths.awake[p] != 0, now_ns)
            if wheel.noticed == 0 and wheel.rest_ticks >= REST_TICKS:
                wheel.noted = 0
            wheel.noticed &= ~wheel.noted
            noticed |= wheel.noticed
    return noticed


@compiled
def _take_in(wheel: Records, volts: float, constants: Records, speed_m_s: float) -> None:
    """Count for how long a wheel has had no voltage, or has been pushed onward.

    A motor of swapped leads is judged by the intent of its cell, which has a time to notice it.
    """
    wheel.applied_v, wheel.noticed = volts, 0
    wheel.rest_ticks = 0 if volts != 0.0 else wheel.rest_ticks + 1
    if wheel.rest_ticks >= REST_TICKS:
        wheel.rested = 1
    ke = (constants.loss - constants.damping) / constants.force_per_volt
    onward = _pushes_onward(volts, speed_m_s, ke)
    wheel.onward_ticks = wheel.onward_ticks + 1 if onward else 0


@compiled
def _look_at_cell(cell: Records, supply_v: float, shut_off: int, now_ns: int) -> None:
    """Find the faults that the cell itself must notice."""
    if now_ns - cell.setpoint_ns > cell.timeout_ns and not cell.steers:
        cell.noticed |= NO_SETPOINT
    if now_ns - cell.heartbeat_ns > cell.consumer_ns:
        cell.noticed |= NO_HEARTBEAT
    if cell.steers and now_ns - cell.sync_ns > cell.sync_limit_ns:
        cell.noticed |= NO_SYNC
    cell.low_ticks = cell.low_ticks + 1 if supply_v < cell.supply_min_v else 0
    if cell.low_ticks > cell.low_limit * cell.slow:
        cell.noticed |= LOW_SUPPLY
    cell.shut_ticks = cell.shut_ticks + 1 if shut_off else 0
    if cell.shut_ticks > cell.shut_limit * cell.slow:
        cell.noticed |= SHUT_OFF


@compiled
def _pushes_onward(volts: float, speed_m_s: float, ke: float) -> bool:
    """Whether a motor is driven on in the direction in which it turns, or out of standstill.

    Its current is against its motion while its voltage is below its back-EMF. A free wheel that is
    driven needs no more than that. So a voltage counts if it keeps the wheel going at half the
    speed. A braked wheel gets less, even if a parcel drags it.
    """
    if abs(speed_m_s) > SLOW_M_S:
        along_v = volts if speed_m_s > 0.0 else -volts
        return bool(along_v > SHARE * ke * abs(speed_m_s) + LEAST_V)
    return bool(abs(volts) > HOLD_V and volts * speed_m_s >= 0.0)


@compiled
def _look_at_driven(cell: Records, wheel: Records, free_ns: int, now_ns: int) -> None:
    """Find out whether a wheel that may be driven is driven for no reason."""
    volts, onward = abs(wheel.applied_v), wheel.onward_ticks >= ONWARD_TICKS
    if cell.steers:
        if volts > QUIET_V and now_ns - free_ns > QUIET_NS:
            wheel.noticed |= PUSHED_ALONE
        if onward and now_ns > cell.lease_ns:
            wheel.noticed |= PUSHED_AFTER_LEASE
        if volts > 0.0 and now_ns > cell.ended_ns:
            wheel.noticed |= PUSHED_AFTER_END
    elif onward and now_ns - max(free_ns, wheel.idle_ns) > QUIET_NS:
        wheel.noticed |= PUSHED_ALONE


@compiled
def _look_at_stopped(wheel: Records, now_ns: int) -> None:
    """Find out whether a wheel that must have no voltage has more than a braking one."""
    if wheel.applied_v == 0.0 or now_ns <= wheel.loose_ns:
        return
    braking = wheel.stop != CUT and now_ns <= wheel.braking_ns
    if not braking or wheel.onward_ticks >= ONWARD_TICKS:
        wheel.noticed |= DRIVEN


@compiled
def _look_at_stopping(wheel: Records, now: Records, closed: bool, awake: bool, now_ns: int) -> None:
    """Find out whether a wheel that must stop is braked, and does stop."""
    wheel.stood_ticks = wheel.stood_ticks + 1 if abs(now.speed_m_s) < STOOD_M_S else 0
    if wheel.stood_ticks >= STOOD_TICKS:
        wheel.awake_ns = 0
    if not awake and now_ns < wheel.awake_ns and abs(now.speed_m_s) > TURNS_M_S:
        wheel.noticed |= COASTS
    # A parcel that carries another goes as far as that slides, or others push it. A reversed motor
    # speeds up where its cell brakes, until the cell finds it (0x7302).
    if now.normal_n > 0.0 or not closed or now.reversed:
        wheel.loaded = 1
    ramped = wheel.stop != CUT and not (wheel.loaded or wheel.rested)
    if ramped and abs(now.travel_m - wheel.from_m) > wheel.way_m:
        wheel.noticed |= SPINS


class Lease(NamedTuple):
    """A lease ends `limit_ns` after the last estimate; then the parcel's twist ramps to 0.

    The speed of its fastest corner changes by the acceleration. Other points change more slowly.
    `said_ns` (cells,) has when each cell has sent its last estimate.
    """

    said_ns: Ints
    columns: int
    limit_ns: int
    gain_vs_per_m: float
    acceleration_m_s2: float


@compiled
def find_lapsed(
    watched: WatchedCells, truths: Truths, shapes: Shapes, lease: Lease, now_ns: int
) -> None:
    """Set from when on a cell may push no more, for it has no lease of another under its parcel.

    A cell hears those about its believed place, even if it stands in another. One under several
    parcels may serve any of them.
    """
    rows = lease.said_ns.size // lease.columns
    for c in range(watched.cells.size):
        cell, p = watched.cells[c], truths.places[c]
        silent = False
        if truths.parcel[c] >= 0:
            row, column = c // lease.columns, c % lease.columns
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for k in range(max(column - 1, 0), min(column + 2, lease.columns)):
                    q = r * lease.columns + k
                    same = q != c and truths.parcel[q] == truths.parcel[c]
                    silent = silent or (same and now_ns - lease.said_ns[q] > lease.limit_ns)
        if not silent:
            cell.lease_ns = NEVER
        elif cell.lease_ns == NEVER:
            body = shapes.bodies[truths.parcel[c]]
            turn_m_s = body.yaw_rate_rad_s * shapes.parcels[truths.parcel[c]].radius_m
            corner_m_s = np.hypot(np.hypot(body.vx_m_s, body.vy_m_s), turn_m_s)
            ramp_m_s = 0.0
            for axis in range(truths.first[p + 1] - truths.first[p]):
                speed_m_s = abs(truths.state[truths.first[p] + axis].speed_m_s)
                error_m_s = abs(watched.wheels[c, axis].applied_v) / lease.gain_vs_per_m
                ramp_m_s = max(ramp_m_s, max(speed_m_s, corner_m_s) + error_m_s)
            cell.lease_ns = now_ns + int(ramp_m_s / lease.acceleration_m_s2 * 1e9)
