"""How far a box runs on after an emergency stop, by the form of the stop.

A box on the prototype's cells runs along x at a speed at which its wheels roll with it. Then the
stop acts:

- coasting: a relay cuts the supply of the bridges, and the motors are open
- short: a contact of each motor cuts it off its bridge and shorts it
- category 1: the bridges short the motors for 1 s; then the supply is gone, and the wheels coast
- software: the cells brake with their speed loops, as when their host falls silent

`ours` is the way in mm until the box is slower than 1 mm/s, or for 8 s. `after_1_s` is its speed
after 1 s in mm/s, and `time_s` the time to 10 mm/s; of software, to 1 mm/s. The first three run the
physics alone, on a table of 42 x 3 cells; software runs the firmware on 6 x 3 cells.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from tests.system.trouble.test_fault_braking import Stop

from mdms_model.scenario.file import load_scenario
from mdms_sim.physics.plane.world import World

MASSES_KG = (2, 5, 10)
SPEEDS_M_S = (0.1, 0.2, 0.4)
#: The supply of category 1 is cut so long after the bridges are pulled low.
DELAY_S = 1.0
COLUMNS = 42
#: The speed loop's gain brings the box to speed, until it and its wheels differ by no more.
GAIN_VS_PER_M = 13.0
EVEN_M_S = 0.002
STEP_S = 1e-3
STANDS_M_S, SLOW_M_S, LIMIT_S = 0.001, 0.010, 8.0


@dataclass(frozen=True, slots=True)
class Way:
    """How far a box went on [m], its speed after 1 s [m/s], and the time to 10 mm/s [s]."""

    way_m: float
    after_1_s_m_s: float
    time_s: float


def hardware(form: str, mass_kg: float, speed_m_s: float) -> Way:
    """The way on after a stop in hardware, without the cells: coasting, short, category 1."""
    world = _running(mass_kg, speed_m_s)
    bridges, still = world.bridges, np.zeros((COLUMNS * 3, 2), np.int32)
    start_m, start_s = world.pose[0, 0], world.time_s
    after_1_s, slow_s = np.nan, np.nan
    bridges.supply_v[:] = 0.0
    while (gone_s := world.time_s - start_s) < LIMIT_S and world.twist[0, 0] > STANDS_M_S:
        bridges.shorted[:] = form == "short" or (form == "category 1" and gone_s < DELAY_S)
        world.step_cells(still, STEP_S)
        if np.isnan(after_1_s) and gone_s >= 1.0:
            after_1_s = world.twist[0, 0]
        if np.isnan(slow_s) and world.twist[0, 0] < SLOW_M_S:
            slow_s = gone_s
    return Way(world.pose[0, 0] - start_m, float(np.nan_to_num(after_1_s)), slow_s)


def software(mass_kg: float, speed_m_s: float) -> Way:
    """The way on where the cells brake by themselves."""
    stop = Stop(mass_kg, speed_m_s)
    return Way(stop.way_m, 0.0, stop.duration_s)


def _running(mass_kg: float, speed_m_s: float) -> World:
    """A world in which the box and its wheels run along x at that speed."""
    parcel = [f"parcel.0.mass_kg={mass_kg}", "parcel.0.x_m=-2.4", "parcel.0.y_m=0"]
    world = World(load_scenario("array18", [f"array.columns={COLUMNS}", *parcel]))
    first, along = world.wheels.first[:-1], np.zeros((COLUMNS * 3, 2))
    along[:, 0] = speed_m_s
    while True:
        wheels_m_s = world.wheel_speed_m_s[first]
        # The voltage that the speed loop asks for, with its droop made up for.
        along[:, 0] += 0.02 * (speed_m_s - wheels_m_s)
        volts = GAIN_VS_PER_M * (along[:, 0] - wheels_m_s)
        world.step_cells(np.column_stack((volts, 0 * volts)) * 1e6, STEP_S)
        covered = world.normal_n[first] > 0
        uneven_m_s = abs(world.wheel_speed_m_s[first][covered] - world.twist[0, 0])
        if abs(world.twist[0, 0] - speed_m_s) < EVEN_M_S and uneven_m_s.max() < EVEN_M_S:
            return world
        assert world.time_s < 10.0, "the box does not come to speed"


FORMS = {
    **{form: partial(hardware, form) for form in ("coasting", "short", "category 1")},
    "software": software,
}


def run() -> list[dict[str, Any]]:
    """A row for each form, mass and speed."""
    rows = []
    for mass_kg in MASSES_KG:
        for speed_m_s in SPEEDS_M_S:
            for form, stop in FORMS.items():
                way = stop(mass_kg, speed_m_s)
                rows.append(
                    {
                        "name": f"{mass_kg} kg, {speed_m_s} m/s, {form}",
                        "ours": way.way_m * 1e3,
                        "unit": "mm",
                        "after_1_s": way.after_1_s_m_s * 1e3,
                        "time_s": way.time_s,
                    }
                )
    return rows
