"""Draws a storm from a seed: a table, parcels and their jobs, and troubles."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from math import cos, hypot, pi, remainder, sin, tau
from random import Random
from typing import Any

import numpy as np

from mdms_host.motion.footholds import MARGIN_M
from mdms_host.motion.safe_goals import SupportedParcel, least_footing
from mdms_model.array import build_wheels
from mdms_model.buses import address_cells
from mdms_model.errors import InputError
from mdms_model.outline import DISC_CORNERS, outline_of
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import load_scenario, read_tree
from mdms_model.scenario.scenario import Parcel
from tests.storms.storm import EVENTS, Storm, Table, scenario_of

__all__ = ["draw", "draw_cut"]

Pose = tuple[float, float, float]

#: A parcel may reach so far beyond the edge of the table [m], if it stands there.
BEYOND_M = 0.02
PITCH_M = 0.127
#: Parcels start, and are set down, at least so far apart [m].
APART_M = 0.05
#: A parcel that somebody sets down is so far from all places of others [m]: more than they need to
#: stop.
HAND_M = 0.10
#: Parcels are at rest and cells operational from about this time on [s].
BROUGHT_UP_S = 0.7
#: How often a place is drawn again before a storm does without it.
_TRIES = 300


@dataclass(frozen=True, slots=True)
class Setting:
    """A table and a loop that storms are drawn for; `weight` is how often, `lasts_s` how long."""

    name: str
    weight: float
    base: str
    columns: int
    rows: int
    control: str
    field: str
    parcels: tuple[int, int]
    lasts_s: float


SETTINGS = (
    Setting("small host goal", 8, "array18", 6, 3, "host", "goal", (1, 2), 12.0),
    Setting("small host tasks", 6, "array18", 6, 3, "host", "program", (1, 2), 14.0),
    Setting("small host sort", 4, "infeed", 6, 3, "host", "sort", (4, 4), 14.0),
    Setting("small cells goal", 6, "neighbours", 6, 3, "cells", "goal", (1, 2), 12.0),
    Setting("small cells tasks", 3, "neighbours", 6, 3, "cells", "program", (1, 2), 12.0),
    Setting("small service", 2, "array18", 6, 3, "host", "service", (1, 1), 6.0),
    Setting("middle host goal", 2, "array54", 9, 6, "host", "goal", (1, 4), 10.0),
    Setting("middle host tasks", 3, "array54", 9, 6, "host", "program", (2, 6), 12.0),
    Setting("middle host sort", 1.5, "sort54", 9, 6, "host", "sort", (12, 12), 14.0),
    Setting("middle cells goal", 1.2, "passing2", 9, 6, "cells", "goal", (1, 4), 10.0),
    Setting("middle cells tasks", 0.6, "passing2", 9, 6, "cells", "program", (2, 4), 12.0),
    Setting("large host tasks", 0.6, "array54", 12, 10, "host", "program", (3, 6), 10.0),
)

#: Parcels as (shape, length, width) [m]; each stands on these tables wherever it is inside them.
SHAPES = (
    ("rectangle", 0.28, 0.28),
    ("rectangle", 0.30, 0.28),
    ("rectangle", 0.36, 0.30),
    ("rectangle", 0.40, 0.30),
    ("disc", 0.30, 0.30),
    ("disc", 0.34, 0.34),
)
#: Speeds that the built-in scenarios and the guides have [m/s].
SPEEDS_M_S = {"host": (0.1, 0.2, 0.4, 0.6), "cells": (0.05, 0.1, 0.15)}
MASSES_KG = (1.5, 2.0, 2.5)


#: Events after which a program begins, and the time that it has from then on at least [s].
_BEGINNINGS = ("start", "restart", "again")
PROGRAM_S = 9.0


def draw(seed: int, setting: str | None = None, lasts_s: float | None = None) -> Storm:
    """The storm of a seed; of a setting, and as long as said, where that is given."""
    random = Random(f"storm {seed}")
    chosen = random.choices(SETTINGS, [each.weight for each in SETTINGS])[0]
    if setting is not None:
        (chosen,) = (each for each in SETTINGS if each.name == setting)
    if lasts_s is not None:
        chosen = replace(chosen, lasts_s=lasts_s)
    while True:
        storm = _drawn(seed, random, chosen)
        if lasts_s is None:
            storm = _long_enough(storm)
        storm = _with_commands(storm, chosen)
        try:
            scenario_of(storm)
        except InputError:
            # A parcel that would tip on its way, which is refused before anything moves.
            continue
        return storm


def draw_cut(seed: int) -> Storm:
    """A storm of cells that steer, with one trouble: a cell is cut off for 1 s, and comes back."""
    random = Random(f"cut {seed}")
    settings = [each.name for each in SETTINGS if each.control == "cells"]
    storm = draw(seed, random.choice(settings))
    columns, rows = (6, 3) if storm.tables["scenario"] == "neighbours" else (9, 6)
    cut = {
        "kind": "cut",
        "start_s": round(random.uniform(BROUGHT_UP_S, 5.0), 3),
        "duration_s": 1.0,
        "cells": [random.randint(1, columns * rows)],
    }
    run = storm.tables["run"] | {"on_lost_cell": "go_on"}
    motion = {key: value for key, value in storm.tables["motion"].items() if key != "go_on"}
    tables = storm.tables | {"run": run, "motion": motion}
    return replace(storm, tables=tables, events=()).with_faults((cut,))


def _long_enough(storm: Storm) -> Storm:
    """The storm with time for its last program, which begins when a person begins it again."""
    begun_s = (
        each["time_s"] + each.get("pause_s", 0.0)
        for each in storm.events
        if each["kind"] in _BEGINNINGS
    )
    run = storm.tables["run"]
    duration_s = max(run["duration_s"], round(max(begun_s, default=0.0) + PROGRAM_S, 3))
    return replace(storm, tables=storm.tables | {"run": run | {"duration_s": duration_s}})


def _drawn(seed: int, random: Random, setting: Setting) -> Storm:
    tables: Table = {
        "scenario": setting.base,
        "title": f"Storm {seed}: {setting.name}",
        "run": {"seed": seed, "duration_s": setting.lasts_s},
    }
    if random.random() < 0.3:
        tables["run"]["on_lost_cell"] = random.choice(["go_on", "hold"])
    speed_m_s = random.choice(SPEEDS_M_S[setting.control])
    motion: Table = {"speed_m_s": speed_m_s, "control": setting.control}
    if setting.control == "cells" and random.random() < 0.5:
        motion["go_on"] = True
    if random.random() < 0.15:
        tables["cell"] = {"sensor_noise": random.choice([0.001, 0.01])}
    if setting.field == "sort":
        tables |= _sorting(random, setting)
    else:
        tables |= _parcels(random, setting)
    motion["field"] = "goal" if setting.field in ("goal", "service") else "program"
    tables["motion"] = motion
    # The documents prescribe place codes against exchanged cells.
    tables["array"] = {"coded_places": True}
    if (setting.columns, setting.rows) == (12, 10):
        tables["array"] |= {"columns": 12, "rows": 10, "buses": _buses(12, 10)}
    troubles = _Troubles(random, setting, tables)
    faults, events = troubles.draw(random.randint(2, 6))
    if faults:
        tables["fault"] = faults
    return Storm(seed, tables, tuple(events))


def _with_commands(storm: Storm, setting: Setting) -> Storm:
    """Now and then a storm in which another node commands cells too, often just after a fault.

    They are drawn apart, so the rest of a storm is the same with and without them.
    """
    random = Random(f"commands {storm.seed}")
    events = list(storm.events)
    for _ in range(random.choice(COMMANDS)):
        time_s = random.uniform(BROUGHT_UP_S, 0.6 * setting.lasts_s)
        if storm.faults and random.random() < 0.6:
            fault = random.choice(storm.faults)
            time_s = fault["start_s"] + fault.get("duration_s", 0.0) + random.uniform(0.0, 0.5)
        events.append({"time_s": round(time_s, 3), **_command(random, setting)})
    events.sort(key=lambda each: each["time_s"])
    return replace(storm, events=tuple(events))


def _command(random: Random, setting: Setting) -> Table:
    """What another node sends: to one cell, or to all."""
    cells = list(range(1, setting.columns * setting.rows + 1))
    cell, everyone = random.choice(cells), random.random() < 0.5
    match random.choice(("enable", "enable", "network", "setpoint")):
        case "enable":
            gap_s = round(random.uniform(0.002, 0.03), 3)
            return {"kind": "enable", "cells": cells if everyone else [cell], "gap_s": gap_s}
        case "network":
            command = random.choice(NETWORK_COMMANDS)
            return {"kind": "network", "command": command, "cell": 0 if everyone else cell}
        case _:
            speed_m_s = random.choice((-0.2, -0.05, 0.0, 0.05, 0.2))
            return {"kind": "setpoint", "cell": cell, "speed_m_s": speed_m_s}


def _buses(columns: int, rows: int) -> list[list[int]]:
    """Two columns of cells a bus."""
    return [
        [row * columns + column + 1 for row in range(rows) for column in (pair, pair + 1)]
        for pair in range(0, columns, 2)
    ]


def _sorting(random: Random, setting: Setting) -> Table:
    """A stream that is sorted: as in `sort54`, or as in the examples."""
    if setting.base == "sort54":
        return {"task": [{"do": "sort"}]}
    stock = [
        {"name": f"box {k}", "kind": "box", "mass_kg": 2.0, "length_m": 0.28, "width_m": 0.28}
        for k in (1, 2)
    ]
    disc = {"kind": "disc", "mass_kg": 1.5, "length_m": 0.30, "width_m": 0.30, "shape": "disc"}
    stock += [{"name": f"disc {k}", **disc} for k in (1, 2)]
    return {
        "scenario": "array18",
        "parcel": stock,
        "stream": [
            {
                "parcels": [each["name"] for each in stock],
                **{"x_m": -0.21, "y_m": 0.0, "start_s": 0.6, "clear_m": 0.03},
                **{"spread_m": 0.003, "spread_rad": 0.02},
            }
        ],
        "exit": [
            {"name": "east", "side": "east", "kinds": ["box"]},
            {"name": "south", "side": "south", "from_m": 0.0, "kinds": ["disc"]},
        ],
        "task": [{"do": "sort", "count": random.randint(2, 6)}],
    }


def _parcels(random: Random, setting: Setting) -> Table:
    """Parcels that start apart, and where they are to go."""
    starts: list[tuple[Table, Pose]] = []
    goals: list[tuple[Table, Pose]] = []
    ways: list[tuple[Table, Pose]] = []
    for number in range(random.randint(*setting.parcels)):
        shape, length_m, width_m = random.choice(SHAPES)
        parcel: Table = {
            "name": f"parcel {number + 1}",
            "mass_kg": random.choice(MASSES_KG),
            "length_m": length_m,
            "width_m": width_m,
        }
        if shape != "rectangle":
            parcel["shape"] = shape
        start = place(random, setting, parcel, starts)
        goal = place(random, setting, parcel, goals)
        if start is None or goal is None:
            continue
        # Goals of the host are drawn with straight ways apart from each other, so each has a way.
        way = _way(parcel, start, goal)
        if (setting.control, setting.field) == ("host", "goal"):
            if any(gap_m(*one, *other) < APART_M for one in way for other in ways):
                continue
            ways += way
        parcel |= {"x_m": start[0], "y_m": start[1], "yaw_rad": start[2]}
        starts.append((parcel, start))
        goals.append((parcel, goal))
    if setting.field in ("goal", "service"):
        for parcel, goal in goals:
            parcel["goal"] = _goal(parcel, goal)
        return {"parcel": [parcel for parcel, _ in starts]}
    tasks: list[Table] = []
    for parcel, goal in goals:
        task = {"do": "transport", "parcel": parcel["name"], **_goal(parcel, goal)}
        if tasks and random.random() < 0.6:
            task["beside"] = True
        tasks.append(task)
    if len(starts) > 1 and random.random() < 0.3:
        swapped = random.sample([parcel["name"] for parcel, _ in starts], 2)
        tasks.append({"do": "swap", "parcels": swapped})
    return {"parcel": [parcel for parcel, _ in starts], "task": tasks}


def _way(parcel: Table, start: Pose, end: Pose) -> list[tuple[Table, Pose]]:
    """Where a parcel is on its straight way, every 50 mm."""
    turn_rad = remainder(end[2] - start[2], tau)
    change = np.array([end[0] - start[0], end[1] - start[1], turn_rad])
    steps = max(2, round(hypot(change[0], change[1]) / 0.05) + round(abs(turn_rad) / 0.2))
    poses = np.array(start) + np.linspace(0.0, 1.0, steps)[:, None] * change
    return [(parcel, (x_m, y_m, yaw_rad)) for x_m, y_m, yaw_rad in poses.tolist()]


def _goal(parcel: Table, pose: Pose) -> Table:
    """The goal of a parcel; no sensor shows how a disc is turned."""
    goal = {"x_m": pose[0], "y_m": pose[1]}
    return goal if parcel.get("shape") == "disc" else goal | {"yaw_rad": pose[2]}


def place(
    random: Random,
    setting: Setting,
    parcel: Table,
    others: list[tuple[Table, Pose]],
    apart_m: float = APART_M,
) -> Pose | None:
    """A pose within the wheels of a table, so far from the others; None where none was found."""
    half_x_m = setting.columns * PITCH_M / 2 + BEYOND_M
    half_y_m = setting.rows * PITCH_M / 2 + BEYOND_M
    for _ in range(_TRIES):
        # A box fits across a narrow table in few ways, so it is often as it lies there.
        turned = setting.rows > 3 and random.random() < 0.5
        yaw_rad = random.uniform(-pi, pi) if turned else random.uniform(-0.3, 0.3)
        corners = _corners(parcel, (0.0, 0.0, yaw_rad))
        reach_x_m = max(0.0, half_x_m - float(corners[:, 0].max()))
        reach_y_m = max(0.0, half_y_m - float(corners[:, 1].max()))
        pose = (
            _along(random, reach_x_m),
            _along(random, reach_y_m),
            0.0 if parcel.get("shape") == "disc" else round(yaw_rad, 4),
        )
        clear = all(gap_m(parcel, pose, other, at) >= apart_m for other, at in others)
        if clear and _stands(setting, parcel, pose):
            return pose
    return None


def _along(random: Random, reach_m: float) -> float:
    """Anywhere along an axis, or near to an end of it, where there is room beside."""
    if random.random() < 0.5:
        return round(random.uniform(-reach_m, reach_m), 4)
    return round(random.choice((-1, 1)) * random.uniform(0.8, 1.0) * reach_m, 4)


def _stands(setting: Setting, parcel: Table, pose: Pose) -> bool:
    """Whether the wheels of a table hold a parcel there, as the host demands it of goals."""
    outline = outline_of(Parcel(**{"name": "", "mass_kg": 1.0} | parcel))
    wheel_m = _wheels_m(setting.columns, setting.rows)
    footing = least_footing(wheel_m, SupportedParcel(outline, (0.0, 0.0)), np.array(pose), None)
    return footing.margin_m >= MARGIN_M


@cache
def _wheels_m(columns: int, rows: int) -> Any:
    overrides = [f"array.columns={columns}", f"array.rows={rows}"]
    return build_wheels(load_scenario("array18", overrides)).position_m


def gap_m(one: Table, at: Pose, other: Table, there: Pose) -> float:
    """How far two parcels are apart at least, by the axes of their outlines; negative: maybe not.

    For corner against corner it is less than the distance.
    """
    first, second = _corners(one, at), _corners(other, there)
    return max(_beyond(first, second), _beyond(second, first))


def _beyond(first: Any, second: Any) -> float:
    """The most by which one outline lies beyond an edge of the other."""
    sides = np.roll(first, -1, axis=0) - first
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.hypot(*sides.T)[:, None]
    depths = (second[None] - first[:, None]) @ normals[:, :, None]
    return float(depths[..., 0].min(axis=1).max())


def _corners(parcel: Table, pose: Pose) -> Any:
    half = np.array([parcel["length_m"], parcel["width_m"]]) / 2
    if parcel.get("shape") == "disc":
        angles = np.arange(DISC_CORNERS) * 2 * pi / DISC_CORNERS
        local = half[0] * np.column_stack([np.cos(angles), np.sin(angles)])
    else:
        local = half * np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    x_m, y_m, yaw_rad = pose
    turn = np.array([[cos(yaw_rad), -sin(yaw_rad)], [sin(yaw_rad), cos(yaw_rad)]])
    return local @ turn.T + [x_m, y_m]


# Troubles ----------------------------------------------------------------------------------------


class _Troubles:
    """Draws troubles; each method is a kind of trouble, and returns a fault or an event."""

    def __init__(self, random: Random, setting: Setting, tables: Table) -> None:
        self._random = random
        self._setting = setting
        self._tables = tables
        self._cells = setting.columns * setting.rows
        self._sorted = setting.field == "sort"
        buses = (read_tree(tables["scenario"])["array"] | tables["array"]).get("buses", ())
        self._buses = len(buses) or 1
        self._node_ids = address_cells(self._cells, buses).node_ids
        #: Cells that steer have a gateway between each two buses; the host needs none.
        self._gateways = self._buses - 1 if setting.control == "cells" else 0

    def draw(self, count: int) -> tuple[list[Table], list[Table]]:
        """So many of them, as faults of the scenario and as events beside it, by their times."""
        kinds = dict(self._kinds())
        faults: list[Table] = []
        events: list[Table] = []
        for _ in range(count):
            kind = self._random.choices(list(kinds), [weight for weight, _ in kinds.values()])[0]
            trouble = kinds[kind][1]()
            if trouble is None:
                continue
            if trouble.get("kind") in EVENTS:
                events.append(trouble)
            elif not _clashes(trouble, faults):
                faults.append(trouble)
        # Most runs end by their first trouble; a person looks after it, and begins again.
        for _ in range(self._random.choice((0, 1, 1, 2))):
            start_s = self._time(BROUGHT_UP_S, 0.8 * self._setting.lasts_s)
            events.append({"kind": "start", "time_s": start_s})
        if self._setting.field == "service":
            # No program runs beside these tools, and they turn no wheel under a parcel.
            events = [each for each in events if each["kind"] not in _OF_PROGRAMS]
            events.append({"kind": "empty", "time_s": 0.0})
            beside = [cell for cell in range(1, self._cells + 1) if self._is_beside(cell)]
            tools = [self._service(self._random.choice(beside)) for _ in (1, 2) if beside]
            events += tools
            faults += self._stop_within(tools, faults)
        faults.sort(key=lambda each: each["start_s"])
        events.sort(key=lambda each: each["time_s"])
        return faults, events

    def _kinds(self) -> Iterator[tuple[str, tuple[float, Callable[[], Table | None]]]]:
        yield "emergency_stop", (3.0, self._emergency_stop)
        yield "sag", (1.0, self._sag)
        yield "host", (1.5, self._host)
        yield "cell", (3.0, self._cell)
        yield "wire", (2.0, self._wire)
        yield "sensor", (1.0, self._sensor)
        yield "wheel", (1.0, self._wheel)
        yield "stop", (1.0, lambda: self._event("stop"))
        yield "stop_all", (1.0, lambda: self._event("stop_all"))
        yield "restart", (1.0, lambda: self._event("restart", pause_s=self._time(0.01, 2.0)))
        yield "again", (1.0, lambda: self._event("again", pause_s=self._time(0.0, 1.0)))
        yield "second_host", (0.7, self._second_host)
        yield "write", (1.0, self._write)
        yield "reading_high", (0.4, lambda: self._event("reading_high", cell=self._one_cell()))
        if self._gateways:
            yield "gateway", (1.0, self._gateway)
        if not self._sorted and self._setting.field != "service":
            yield "hand", (1.5, self._hand)
            yield "push", (1.0, self._push)
            alone = len(self._tables["parcel"]) == 1
            if alone or (self._setting.control, self._setting.field) != ("host", "goal"):
                yield "goal", (1.5, self._goal)

    # Values

    def _time(self, least_s: float, most_s: float) -> float:
        return round(self._random.uniform(least_s, most_s), 3)

    def _start(self) -> float:
        """Now and then during bring-up, else while parcels move, and not too near to the end."""
        if self._random.random() < 0.15:
            return self._time(0.02, BROUGHT_UP_S)
        return self._time(BROUGHT_UP_S, 0.6 * self._setting.lasts_s)

    def _one_cell(self) -> int:
        return self._random.randint(1, self._cells)

    def _fault(self, kind: str, duration_s: float | None, **values: Any) -> Table:
        table = {"kind": kind, "start_s": self._start()}
        return table | ({} if duration_s is None else {"duration_s": duration_s}) | values

    def _event(self, kind: str, **values: Any) -> Table:
        return {"kind": kind, "time_s": self._start(), **values}

    # Kinds

    def _emergency_stop(self) -> Table:
        """Pressed, and released later; once in five it stays pressed."""
        released = self._random.random() < 0.8
        brakes = {"brake": True} if "brake" in _FAULT_KEYS else {}
        duration_s = self._time(0.02, 2.0) if released else None
        return self._fault("supply", duration_s, supply_v=0.0, **brakes)

    def _sag(self) -> Table:
        """All motors, or those of one cell, have too little for a while."""
        cells = {} if self._random.random() < 0.5 else {"cells": [self._one_cell()]}
        supply_v = round(self._random.uniform(4.0, 18.0), 1)
        return self._fault("supply", self._time(0.003, 0.5), supply_v=supply_v, **cells)

    def _host(self) -> Table:
        """The host is gone; once in four for good."""
        back = self._random.random() < 0.75
        bus = {}
        if self._buses > 1 and self._random.random() < 0.3:
            bus = {"bus": self._random.randrange(self._buses)}
        return self._fault("host", self._time(0.02, 2.0) if back else None, **bus)

    def _cell(self) -> Table:
        cell = self._one_cell()
        kind = self._random.choice(["off", "reboot", "hang", "bus_off", "wrong_place", "bridge"])
        if kind == "off":
            return self._fault("off", None, cells=[cell])
        if kind == "reboot":
            return self._fault("off", self._time(0.05, 2.0), cells=[cell])
        if kind == "hang":
            return self._fault("hang", self._time(0.05, 0.5), cells=[cell])
        if kind == "bus_off":
            return self._fault("corruption", self._time(0.02, 0.2), cells=[cell])
        if kind == "bridge":
            return self._fault("bridge_fault", self._time(0.01, 1.0), cells=[cell])
        # A cell that is put where one with its node id belongs is in its place there.
        own = self._node_ids[cell - 1]
        others = [each for each, node_id in enumerate(self._node_ids, 1) if node_id != own]
        other = self._random.choice(others)
        # Nobody moves a cell while it has power: it has been put there before.
        return self._fault("wrong_place", None, cells=[cell], as_cell=other) | {"start_s": 0.0}

    def _wire(self) -> Table:
        kind = self._random.choice(["loss", "loss", "delay", "cut", "corruption", "overload"])
        duration_s = self._time(0.05, 2.0)
        if kind == "cut":
            # A wire is cut between two columns.
            column = self._random.randrange(1, self._setting.columns)
            beyond = [
                row * self._setting.columns + each + 1
                for row in range(self._setting.rows)
                for each in range(column, self._setting.columns)
            ]
            return self._fault("cut", duration_s, cells=beyond)
        if kind == "delay":
            return self._fault(
                "delay", duration_s, cells=[self._one_cell()], delay_s=self._time(0.001, 0.02)
            )
        shares = {"loss": (0.002, 0.02, 0.1), "corruption": (0.005, 0.05), "overload": (0.05, 0.3)}
        return self._fault(kind, duration_s, probability=self._random.choice(shares[kind]))

    def _sensor(self) -> Table:
        sensors = sorted(self._random.sample(range(5), self._random.randint(1, 5)))
        covered = self._random.random() < 0.5
        duration_s = None if self._random.random() < 0.5 else self._time(0.02, 2.0)
        return self._fault(
            "sensor_stuck", duration_s, cells=[self._one_cell()], sensors=sensors, covered=covered
        )

    def _wheel(self) -> Table:
        kind = self._random.choice(["motor_reversed", "encoder_stuck", "wheel_jammed"])
        duration_s = None if self._random.random() < 0.5 else self._time(0.05, 2.0)
        axes = [self._random.randint(1, 2)]
        return self._fault(kind, duration_s, cells=[self._one_cell()], axes=axes)

    def _second_host(self) -> Table:
        return self._event("second_host", duration_s=self._time(0.05, 2.0))

    def _write(self) -> Table:
        """A setting that is legal, and makes no motor push harder."""
        index, values = self._random.choice(WRITES)
        return self._event(
            "write", cell=self._one_cell(), index=index, value=self._random.choice(values)
        )

    def _gateway(self) -> Table:
        number = self._random.randrange(self._gateways)
        return self._event("gateway", number=number, duration_s=self._time(0.05, 3.0))

    def _service(self, cell: int) -> Table:
        """A tool that turns wheels, or writes firmware, with no program beside it."""
        kind = self._random.choice(("jog", "commission", "update"))
        if kind == "jog":
            return self._jog(cell)
        duration_s = self._time(0.1, 4.0)
        if kind == "commission":
            return self._event(kind, cell=cell, duration_s=duration_s)
        cells = sorted(self._random.sample(range(1, self._cells + 1), self._random.randint(1, 6)))
        return self._event(kind, cells=cells, duration_s=duration_s)

    def _stop_within(self, tools: list[Table], faults: list[Table]) -> list[Table]:
        """An emergency stop while one of these tools is at work, unless the supply fails anyhow."""
        if not tools:
            return []
        tool = self._random.choice(tools)
        start_s = round(tool["time_s"] + self._time(0.0, tool["duration_s"]), 3)
        stop = self._emergency_stop() | {"start_s": start_s}
        return [] if _clashes(stop, faults) else [stop]

    def _jog(self, cell: int) -> Table:
        jogged = {"cell": cell, "axis": self._random.randint(1, 2)}
        speed_m_s = self._random.choice([-0.2, -0.05, 0.05, 0.2])
        duration_s = self._time(0.1, 3.0)
        return self._event("jog", **jogged, speed_m_s=speed_m_s, duration_s=duration_s)

    def _is_beside(self, cell: int) -> bool:
        """Whether no parcel starts near a cell."""
        row, column = divmod(cell - 1, self._setting.columns)
        x_m = (column - (self._setting.columns - 1) / 2) * PITCH_M
        y_m = (row - (self._setting.rows - 1) / 2) * PITCH_M
        parcels: list[Table] = self._tables["parcel"]
        return all(
            hypot(each["x_m"] - x_m, each["y_m"] - y_m)
            > hypot(each["length_m"], each["width_m"]) / 2 + PITCH_M
            for each in parcels
        )

    def _parcel(self) -> Table | None:
        parcels: list[Table] = self._tables["parcel"]
        return self._random.choice(parcels) if parcels else None

    def _push(self) -> Table | None:
        """As much as makes a parcel faster by up to 0.15 m/s."""
        parcel = self._parcel()
        if parcel is None:
            return None
        heading_rad = self._random.uniform(-pi, pi)
        impulse_n_s = parcel["mass_kg"] * self._random.uniform(0.02, 0.15)
        impulse = [round(impulse_n_s * each(heading_rad), 4) for each in (cos, sin)]
        return self._fault("push", None, parcel=parcel["name"], impulse_n_s=impulse)

    def _hand(self) -> Table | None:
        """Lifted, and set down where it was or elsewhere, far from where others start and go."""
        parcel = self._parcel()
        if parcel is None or self._random.random() < 0.1:
            return parcel and self._fault("lift", None, parcel=parcel["name"])
        others = [each for each in self._tables["parcel"] if each is not parcel]
        pose = None
        if self._random.random() < 0.6:
            pose = place(self._random, self._setting, parcel, self._all_places(others), HAND_M)
        values = {} if pose is None else dict(zip(("x_m", "y_m", "yaw_rad"), pose, strict=True))
        return self._fault("lift", self._time(0.1, 2.0), parcel=parcel["name"], **values)

    def _all_places(self, parcels: list[Table]) -> list[tuple[Table, Pose]]:
        """Where parcels start, and where they are to be."""
        named = {each["name"]: each for each in parcels}
        places = [(each, (each["x_m"], each["y_m"], each["yaw_rad"])) for each in parcels]
        goals = [(each, each["goal"]) for each in parcels if "goal" in each]
        goals += [
            (named[task["parcel"]], task)
            for task in self._tables.get("task", ())
            if task.get("parcel") in named
        ]
        ways: list[tuple[Table, Pose]] = []
        for parcel, goal in goals:
            start = parcel["x_m"], parcel["y_m"], parcel["yaw_rad"]
            ways += _way(parcel, start, (goal["x_m"], goal["y_m"], goal.get("yaw_rad", start[2])))
        return places + ways

    def _goal(self) -> Table | None:
        parcel = self._parcel()
        if parcel is None:
            return None
        pose = place(self._random, self._setting, parcel, [])
        if pose is None:
            return None
        return self._event("goal", parcel=parcel["name"], **_goal(parcel, pose))


#: How often another node commands cells in a storm.
COMMANDS = (0, 0, 1, 2)
#: Its commands of network management.
NETWORK_COMMANDS = ("START", "STOP", "ENTER_PRE_OPERATIONAL", "RESET_NODE", "RESET_COMMUNICATION")

_FAULT_KEYS = {each.name for each in fields(Fault)}

_OF_PROGRAMS = ("start", "again", "restart", "second_host", "goal", "stop")

#: Objects and values that somebody may write beside a run without harm: heartbeat producer, EMCY
#: inhibit time, velocity window, identify, debounce, over-current time, voltage limit.
WRITES: tuple[tuple[int, tuple[int, ...]], ...] = (
    (0x1017, (50, 150)),
    (0x1015, (0, 1000)),
    (0x606D, (5000, 20000)),
    (0x3007, (200, 2000)),
    (0x3006, (2, 8)),
    (0x2002, (12000, 20000, 24000)),
    (0x2000, (8000, 10000)),
)

#: Of these a cell, or a parcel, or the table has one at a time.
_ONE_AT_A_TIME = ("off", "hang", "lift", "supply", "wrong_place", "delay", "cut")


def _clashes(trouble: Table, faults: list[Table]) -> bool:
    """Whether the same cell, parcel or wire would have two faults that exclude each other."""
    return trouble["kind"] in _ONE_AT_A_TIME and any(
        trouble["kind"] in (other["kind"], _ALSO.get(other["kind"]))
        and _share(trouble, other)
        and _overlap(trouble, other)
        for other in faults
    )


#: A cell without power does not hang.
_ALSO = {"off": "hang", "hang": "off"}


def _share(one: Table, other: Table) -> bool:
    if one.get("parcel") != other.get("parcel"):
        return False
    cells = [set(each.get("cells", ())) | {each.get("as_cell")} - {None} for each in (one, other)]
    return not all(cells) or bool(cells[0] & cells[1])


def _overlap(one: Table, other: Table) -> bool:
    ends_s = [each["start_s"] + each.get("duration_s", 1e6) for each in (one, other)]
    return one["start_s"] <= ends_s[1] and other["start_s"] <= ends_s[0]
