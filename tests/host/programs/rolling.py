"""A table of ideal wheels on which all is known as it is: programs and motion without a bus."""

from dataclasses import replace

import numpy as np

from mdms_array.host import layout_of, masses_of, parcels_of, table_program, traction_of
from mdms_host.estimation.belief import Belief, BeliefKind, Standing
from mdms_host.estimation.presence import SensorGroups
from mdms_model.scenario.file import load_scenario
from mdms_sim.physics.plane.handling import lift, set_down
from mdms_sim.physics.plane.world import World

CYCLE_S = 0.01
STEPS = 5
#: Wheels of the ideal law have no inertia.
IDEAL = (
    "cell.rotor_inertia_kg_m2=0.0",
    "cell.wheel_inertia_kg_m2=0.0",
    "cell.motor_spread=0.0",
    "cell.friction_spread=0.0",
)


class Rolling:
    """A scenario with a program, in cycles of 10 ms; beliefs are the truth, as of a SYNC.

    Parcels named in `unknown` are believed to be something unknown, which reaches as far as the
    next sensors that may be free; those in `hidden` are not believed to be anywhere, and those in
    `doubted` only with a doubt. Cells that are lost get no reference, and their wheels drag as much
    as any can: those of a real one coast. Left out are noise, delays, and beliefs that are wrong.
    """

    def __init__(self, scenario, *overrides, main=None, unknown=()):
        scenario = load_scenario(scenario, [*IDEAL, *overrides])
        layout = layout_of(scenario)
        self.parcels = parcels_of(scenario)
        self.world = World(scenario)
        known = replace(scenario, parcel=tuple(p for p in scenario.parcel if p.name not in unknown))
        self.program = table_program(
            known,
            tuple(parcel for parcel in self.parcels if parcel.name not in unknown),
            masses_of(known),
            traction_of(scenario, layout),
            main=main,
        )
        self.unknown, self.hidden, self.doubted = set(unknown), set(), set()
        self.references_m_s = np.zeros(len(layout.wheel_cells))
        #: Cells (from 1) that a parcel has been over.
        self.crossed = set()
        self._cells_m = layout.cell_positions_m
        self._cell_of_wheel = layout.wheel_cells
        self._lost = frozenset()
        link_m = SensorGroups(layout).link_m
        self._believed = {
            parcel.name: parcel.footprint.grown(link_m, link_m)
            if parcel.name in unknown
            else parcel.footprint
            for parcel in self.parcels
        }
        self._twist = np.zeros((len(self.parcels), 3))

    @property
    def table(self):
        return self.program.table

    def pose(self, name):
        names = [parcel.name for parcel in self.parcels]
        return self.world.pose[names.index(name)]

    def lose(self, *cells):
        """These cells (from 1) are dead from now on, and no others; the program is told."""
        self._lost = frozenset(cells)
        self.program.on_lost_cells(self._lost)

    def put(self, name, x_m, y_m):
        """Lift a parcel, and set it down elsewhere."""
        number = [parcel.name for parcel in self.parcels].index(name)
        lift(self.world.scene, number)
        set_down(self.world.scene, number, x_m, y_m, None)

    def events(self, *kinds):
        return [(each.kind, each.parcel) for each in self.world.events if each.kind in kinds]

    def run(self, seconds, until=lambda: False):
        for _ in range(round(seconds / CYCLE_S)):
            if until():
                break
            self._cycle()

    def run_until(self, limit_s, until):
        self.run(limit_s, until)
        assert until()

    def _cycle(self):
        pose, twist = self.world.motion
        beliefs = {
            parcel.name: Belief(
                parcel.name,
                self._believed[parcel.name],
                pose[number],
                self._twist[number],
                np.zeros((3, 3)),
                Standing.DOUBTFUL if parcel.name in self.doubted else Standing.FOUND,
                kind=BeliefKind.UNKNOWN if parcel.name in self.unknown else BeliefKind.PARCEL,
            )
            for number, parcel in enumerate(self.parcels)
            if np.isfinite(pose[number]).all() and parcel.name not in self.hidden
        }
        self._twist = np.nan_to_num(twist)
        dead = np.isin(self._cell_of_wheel, [*self._lost])
        commanded_m_s = self.program.references_m_s(beliefs, CYCLE_S)
        self.references_m_s = np.where(dead, 0.0, commanded_m_s)
        for parcel in self.parcels:
            if parcel.name in beliefs:
                pose = beliefs[parcel.name].pose
                under = parcel.footprint.distance_m(self._cells_m, pose) < 0.0
                self.crossed |= set((np.flatnonzero(under) + 1).tolist())
        for _ in range(STEPS):
            self.world.step_ideal(self.references_m_s, CYCLE_S / STEPS)
