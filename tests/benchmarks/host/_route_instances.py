"""Random well-formed instances of many parcels, of any number that stands on the table.

All starts are drawn first. Then one parcel after another, by chance, is given a goal to which it
has a way past all others, wherever these are by then: at their goals, or still at their starts. So
there is an order in which they could go one after another (H. Ma, W. Hoenig, T. Kumar, N. Ayanian,
S. Koenig, 2019, ask for ways past all others' starts and goals, which so full a table has not). The
planner is not given it; it is asked only for ways of one parcel alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from random import Random

import numpy as np
from scipy import ndimage

from mdms_host.estimation.footprint import Disc, Rectangle
from mdms_host.layout import Layout
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Planner, SearchSettings
from mdms_host.routes.planning_problem import RouteTask
from mdms_host.routes.support import Shape

SHAPES = (
    Shape(Rectangle(0.28, 0.28)),
    Shape(Rectangle(0.36, 0.30)),
    Shape(Rectangle(0.40, 0.30)),
    Shape(Disc(0.30)),
)
#: Draws of a start, and of a goal, before another parcel's turn comes.
DRAWS = 200, 60
#: So often a parcel's goals may be out of reach before all starts are drawn anew.
TURNS = 20
#: Wherever a parcel of these shapes is, it is on a square of so many tiles along each side.
BLOCK = 4


@dataclass(frozen=True)
class Table:
    """A table and how many parcels are on it at most."""

    columns: int
    rows: int
    parcels: int
    step: int

    @property
    def name(self) -> str:
        return f"{self.columns}x{self.rows}"

    @property
    def size_m(self) -> tuple[float, float]:
        return self.columns * self.layout.pitch_m, self.rows * self.layout.pitch_m

    @cached_property
    def layout(self) -> Layout:
        cells = range(self.columns * self.rows)
        nodes, buses = tuple(n % 100 + 1 for n in cells), tuple(n // 100 for n in cells)
        return Layout(self.columns, self.rows, node_ids=nodes, buses=buses)

    @cached_property
    def planner(self) -> Planner:
        return Planner(Tiles(self.layout, 2), search=SearchSettings(step=self.step))


TABLES = (Table(9, 6, 3, 1), Table(18, 10, 8, 1), Table(30, 20, 20, 2))


def instance(table: Table, seed: int, parcels: int | None = None) -> list[RouteTask]:
    """So many parcels, else as many as the table may have (1 to 3 where that is 3), shuffled."""
    random = Random(f"routes {table.columns} x {table.rows} {seed}")
    count = parcels or (random.randint(1, 3) if table.parcels == 3 else table.parcels)
    tasks = None
    while tasks is None:
        tasks = with_goals(table, random, started(table, random, count))
    random.shuffle(tasks)
    return [
        RouteTask(f"parcel {number}", task.shape, task.start, task.goal)
        for number, task in enumerate(tasks)
    ]


def drawn_pose(random: Random, table: Table, shape: Shape) -> np.ndarray:
    """A pose on the table; most are along it, some are turned anyhow."""
    tidy = random.random() < 0.7
    yaw_rad = random.choice((0, 1, 2, 3)) * np.pi / 2 if tidy else random.uniform(-np.pi, np.pi)
    corners_m = shape.footprint.outline_m(np.array([0.0, 0.0, yaw_rad]))
    half_m = np.array([table.columns, table.rows]) * table.layout.pitch_m / 2
    low_m, high_m = -half_m - corners_m.min(axis=0), half_m - corners_m.max(axis=0)
    place_m = [*map(random.uniform, low_m, high_m)]
    if random.random() < 0.5:
        # Along an edge, so that tables get fuller than by chance.
        axis = random.randrange(2)
        place_m[axis] = random.choice((low_m[axis], high_m[axis]))
    return np.array([*place_m, yaw_rad])


def started(table: Table, random: Random, count: int) -> list[RouteTask]:
    """Parcels at their starts, none on a tile of another's."""
    while True:
        tasks: list[RouteTask] = []
        taken = np.zeros(table.planner.tiles.count, dtype=bool)
        for _ in range(DRAWS[0]):
            shape = random.choice(SHAPES)
            start = drawn_pose(random, table, shape)
            under = table.planner.stand(shape, start)
            if not taken[under].any():
                taken[under] = True
                tasks.append(RouteTask("", shape, start))
            if len(tasks) == count:
                return tasks


def with_goals(table: Table, random: Random, tasks: Sequence[RouteTask]) -> list[RouteTask] | None:
    """The same with goals, one after another; None: a remaining task finds no goal."""
    taken = np.zeros(table.planner.tiles.count, dtype=bool)
    for task in tasks:
        taken[table.planner.stand(task.shape, task.start)] = True
    waiting, done = list(tasks), []
    turns = dict.fromkeys(map(id, tasks), TURNS)
    while waiting:
        task = random.choice(waiting)
        taken[table.planner.stand(task.shape, task.start)] = False
        gone = with_goal(table, random, task, taken)
        if gone is None:
            turns[id(task)] -= 1
            taken[table.planner.stand(task.shape, task.start)] = True
            if not turns[id(task)]:
                return None
            continue
        taken[table.planner.stand(gone.shape, gone.goal)] = True
        waiting.remove(task)
        done.append(gone)
    return done


def with_goal(table: Table, random: Random, task: RouteTask, taken: np.ndarray) -> RouteTask | None:
    """A parcel with a goal that it has a way to past tiles that are taken; None: none was drawn."""
    parts = parts_of(table, taken)
    own = parts[table.planner.stand(task.shape, task.start)]
    reached = np.isin(parts, own[own > 0])
    for _ in range(DRAWS[1]):
        goal = drawn_pose(random, table, task.shape)
        under = table.planner.stand(task.shape, goal)
        if taken[under].any() or not reached[under].any():
            continue
        gone = RouteTask("", task.shape, task.start, goal)
        return gone if table.planner.plan([gone], closed=taken).routes[""].length_m else None
    return None


def parts_of(table: Table, taken: np.ndarray) -> np.ndarray:
    """Parts of the table between which no parcel of these shapes gets, a number by tile; 0: none.

    That two places are in one part does not mean that there is a way.
    """
    tiles = table.planner.tiles
    free = ~taken.reshape(tiles.rows, tiles.columns)
    blocks = np.lib.stride_tricks.sliding_window_view(free, (BLOCK, BLOCK)).all(axis=(2, 3))
    numbers, _ = ndimage.label(blocks)
    parts = np.zeros_like(taken, dtype=np.int64).reshape(free.shape)
    for row in range(BLOCK):
        for column in range(BLOCK):
            own = parts[row : row + blocks.shape[0], column : column + blocks.shape[1]]
            np.maximum(own, numbers, out=own)
    return parts.ravel()
