"""Many tables at once: their arrays lie side by side, and one compiled call moves them all.

Each table does the same as a `World` that is stepped alone, to the last bit. Tables have in common
the grid, the wheels and sensors of each cell, and the number of parcels. All else may differ.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Grid, build_cells, reach_m
from mdms_model.arrays import Bits, Floats, Ints, Records
from mdms_model.compiled import (
    borrowed,
    compiled,
    compiled_parallel,
    for_types_of,
    inlined,
    prange,
    threads_used,
)
from mdms_model.errors import InputError
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.plane.control_step import SensorPlaces, presence_bits
from mdms_sim.physics.plane.records import Model, Scene, Scratch, StepState, read_poses
from mdms_sim.physics.plane.step import step_ideal
from mdms_sim.physics.plane.world import World

#: Shares of the tables that a thread takes one after the other.
SHARES = 8


class SceneBatch(NamedTuple):
    """The arrays of a `Scene` for N tables, each with N in front of its shape.

    It has plain arrays and numbers only: a loop on several threads takes no tuple in a tuple.
    """

    columns: int
    rows: int
    pitch_m: float
    wheel_reach_m: float
    sensor_reach_m: float
    sensor_offset_m: Floats
    first: Ints
    """First wheel of each cell, the same for all tables."""
    gravity_m_s2: Floats
    wheels: Records
    parcels: Records
    edges: Floats
    wheel_states: Records
    parcel_states: Records
    order: Ints
    partners: Ints
    pairs: Ints
    piece: NDArray[np.int8]
    wheel_scratch: Records
    parcel_scratch: Records
    touches: Records
    tally: Ints
    support: Ints
    spot_m: Floats
    normal_n: Floats
    jacobian: Floats
    line: Floats


class BatchCall(NamedTuple):
    """The work of one call and its results, for N tables."""

    steps: int
    sensed: int
    """The step after which sensors are read, from 1; 0 for none."""
    step_s: float
    reference_m_s: Floats
    """References of the wheels, (N, W)."""
    done: Ints
    """Steps that are done, (N,)."""
    report: Ints
    """Report of the last step, 0 while nothing has happened, (N,)."""
    presence: Bits
    """Presence bits as last read, (N, cells)."""


@compiled
def scene_of(tables: SceneBatch, k: int) -> Scene:
    """The arrays of table k."""
    grid = Grid(tables.columns, tables.rows, tables.pitch_m, tables.wheel_reach_m)
    return Scene(
        Model(
            grid,
            tables.first,
            tables.wheels[k],
            tables.parcels[k],
            tables.edges[k],
            tables.gravity_m_s2[k],
        ),
        StepState(
            tables.wheel_states[k],
            tables.parcel_states[k],
            tables.order[k],
            tables.partners[k],
            tables.pairs[k],
            tables.piece[k],
        ),
        Scratch(
            tables.wheel_scratch[k],
            tables.parcel_scratch[k],
            tables.touches[k],
            tables.tally[k],
            tables.support[k],
            tables.spot_m[k],
            tables.normal_n[k],
            tables.jacobian[k],
            tables.line[k],
        ),
    )


@inlined
def go_on(tables: SceneBatch, k: int, moves: BatchCall) -> None:
    """Move table k on until its steps are done, or until a step has something to report."""
    scene, reference_m_s = scene_of(borrowed(tables), k), moves.reference_m_s[k]
    done, report = moves.done[k], 0
    while done < moves.steps and report == 0:
        report = step_ideal(scene, reference_m_s, moves.step_s)
        done += 1
        if done == moves.sensed:
            sense(tables, k, moves.presence)
    moves.done[k], moves.report[k] = done, report


@compiled
def sense(tables: SceneBatch, k: int, presence: Bits) -> None:
    """Read all presence sensors of table k."""
    places = SensorPlaces(
        Grid(tables.columns, tables.rows, tables.pitch_m, tables.sensor_reach_m),
        tables.sensor_offset_m,
    )
    presence[k] = 0
    presence_bits(places, tables.parcels[k], tables.parcel_states[k], tables.edges[k], presence[k])


@compiled
def move_in_turn(tables: SceneBatch, moves: BatchCall) -> None:
    """Move one table after the other."""
    for k in range(moves.done.size):
        if moves.done[k] < moves.steps:
            go_on(tables, k, moves)


@compiled_parallel
def move_on_threads(tables: SceneBatch, moves: BatchCall) -> None:
    """Move the tables on several threads; each has a share of them."""
    for k in prange(moves.done.size):
        if moves.done[k] < moves.steps:
            go_on(tables, k, moves)


@compiled
def read_all_poses(tables: SceneBatch, pose: Floats, twist: Floats) -> None:
    """Poses and twists (N, P, 3) of the parcels' origins."""
    for k in range(pose.shape[0]):
        read_poses(tables.parcels[k], tables.parcel_states[k], pose[k], twist[k])


class Batch:
    """N tables that move together, each as a `World` of `worlds` does alone.

    The worlds keep their arrays in those of the batch: their properties, `state` and `restore` go
    on as before, and so do acts of hands. Events, exits and the solver's limits are noted in them.
    Streams bring parcels at the end of a call. `threads` share the tables; 1 starts none.

    Raises `InputError` for tables of different shapes, and `ScenarioError` for impossible outlines.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], *, threads: int = 1, most_edges: int = 0
    ) -> None:
        if not scenarios:
            raise InputError("scenarios: there are none; a batch has one table or more")
        self.threads = threads
        self.worlds = [World(scenario) for scenario in scenarios]
        self._first = scenarios[0]
        edges = max(len(world.scene.model.edges) for world in self.worlds)
        self.tables = _room(self.worlds[0], len(self.worlds), max(edges, most_edges))
        for k, world in enumerate(self.worlds):
            self._settle(k, world)
        tables, wheels = len(self.worlds), len(self.worlds[0].wheels.cell)
        done, report = np.zeros((2, tables), np.int64)
        presence = np.zeros((tables, len(self.tables.first) - 1), np.uint8)
        self._moves = BatchCall(0, 0, 0.0, np.zeros((tables, wheels)), done, report, presence)
        move = move_in_turn if threads == 1 else move_on_threads
        # Sorting out the types of so many arrays would take as long as the steps of a table.
        self._move = for_types_of(move, self.tables, self._moves)
        self._sense = for_types_of(sense, self.tables, 0, presence)
        self._pose, self._twist = np.zeros((2, tables, len(scenarios[0].parcel), 3))
        # Fields of record arrays are slow to come by, and these stay where they are.
        self._tipped = np.asarray(self.tables.parcel_states["tipped"])
        self._speed = np.asarray(self.tables.wheel_states["speed_m_s"])
        self._read = for_types_of(read_all_poses, self.tables, self._pose, self._twist)

    def replace(self, k: int, scenario: Scenario) -> World:
        """Put another table in place k. Raises `InputError` for one of another shape."""
        world = World(scenario)
        self._settle(k, world)
        self.worlds[k] = world
        return world

    def _settle(self, k: int, world: World) -> None:
        """Move the arrays of a world to place k."""
        check_alike(self._first, world.scenario, k)
        scene: Scene = _plain(scene_of)(self.tables, k)
        room, edges = len(scene.model.edges), world.scene.model.edges
        if len(edges) > room:
            raise InputError(
                f"table {k}: the outlines have {len(edges)} edges, but the batch has room for "
                f"{room}; give most_edges={len(edges)}"
            )
        self.tables.gravity_m_s2[k] = world.scene.model.gravity_m_s2
        scene.model.edges[: len(edges)] = edges
        own = world.scene.model
        pairs = [(scene.model.wheels, own.wheels), (scene.model.parcels, own.parcels)]
        pairs += [*zip(scene.state, world.scene.state, strict=True)]
        pairs += [*zip(scene.scratch, world.scene.scratch, strict=True)]
        for here, there in pairs:
            here[...] = there
        world.scene = _plain(scene_of)(self.tables, k)

    # Motion -------------------------------------------------------------------------------------

    def step_ideal(
        self, reference_m_s: Floats, step_s: float, steps: int = 1, sensed: int = 0
    ) -> None:
        """Move all tables by so many steps under the continuous law; references (N, W).

        `presence` is read after step `sensed`, 0: never.
        """
        moves = self._moves._replace(steps=steps, sensed=sensed, step_s=step_s)
        moves.reference_m_s[...] = reference_m_s
        moves.done[:] = 0
        before = [0] * len(self.worlds)
        while True:
            self._run(moves)
            done = moves.done.tolist()
            for world, was, now, report in zip(
                self.worlds, before, done, moves.report.tolist(), strict=True
            ):
                if now > was:
                    world.pass_time((now - was) * step_s, report)
            if min(done) == steps:
                return
            before = done

    def _run(self, moves: BatchCall) -> None:
        if self.threads == 1:
            self._move(self.tables, moves)
        else:
            share = max(1, len(self.worlds) // (SHARES * self.threads))
            with threads_used(self.threads, share):
                self._move(self.tables, moves)

    # Results ------------------------------------------------------------------------------------

    @property
    def presence(self) -> Bits:
        """Presence bits (N, cells) as last read: without delay, noise and faults."""
        return self._moves.presence

    def sense(self, k: int | None = None) -> None:
        """Read the presence sensors of table k now; None: of all."""
        for each in range(len(self.worlds)) if k is None else (k,):
            self._sense(self.tables, each, self._moves.presence)

    @property
    def motion(self) -> tuple[Floats, Floats]:
        """Poses and twists (N, P, 3) of the parcels [m, rad, s]; NaN for those that are away.

        The arrays are filled anew by the next call.
        """
        self._read(self.tables, self._pose, self._twist)
        return self._pose, self._twist

    @property
    def wheel_speed_m_s(self) -> Floats:
        """Surface speeds of the wheels (N, W)."""
        return np.array(self._speed)

    @property
    def tipped(self) -> NDArray[np.bool_]:
        """Which tables (N,) have a parcel that has tipped off its supports."""
        return np.asarray(self._tipped.any(axis=1))


def _room(world: World, tables: int, edges: int) -> SceneBatch:
    """Empty arrays for so many tables like this one."""
    scene, cell = world.scene, world.scenario.cell
    grid = scene.model.grid

    def rows(array: Any) -> Any:
        stacked = np.zeros((tables, *array.shape), array.dtype)
        return stacked.view(np.recarray) if array.dtype.names else stacked

    return SceneBatch(
        grid.columns,
        grid.rows,
        grid.pitch_m,
        grid.reach_m,
        reach_m(cell.sensor_offset_m),
        np.array(cell.sensor_offset_m, dtype=np.float64),
        scene.model.first,
        np.zeros(tables),
        rows(scene.model.wheels),
        rows(scene.model.parcels),
        np.zeros((tables, edges, 5)),
        *map(rows, scene.state),
        *map(rows, scene.scratch),
    )


def check_alike(one: Scenario, other: Scenario, k: int) -> None:
    """Raises `InputError` where a table has another shape than the first one."""
    for name, shape in (
        ("array", lambda each: (each.array.columns, each.array.rows, each.array.pitch_m)),
        ("cell.wheel", lambda each: [cell.wheel for cell in build_cells(each)]),
        ("cell.sensor_offset_m", lambda each: each.cell.sensor_offset_m),
        ("number of parcels", lambda each: len(each.parcel)),
    ):
        if shape(one) != shape(other):
            raise InputError(
                f"table {k}: its {name} differs from that of the first table; a batch has tables"
                " of one shape, so make another batch for it"
            )


def _plain(function: Any) -> Callable[..., Any]:
    """A compiled function as it is written."""
    return cast(Callable[..., Any], getattr(function, "py_func", function))
