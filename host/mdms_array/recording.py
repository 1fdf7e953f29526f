"""Beliefs, plans and reports of hosts, for the record of a run; and the folder that keeps it."""

import functools
import shutil
import sys
import tokenize
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import can
import numpy as np

from mdms_array.extras import PICTURES
from mdms_array.host import estimates_of
from mdms_array.revision import git_revision
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.motion.goal import GoalPose
from mdms_host.programs.program import Main, TableProgram
from mdms_model.arrays import Floats
from mdms_model.log import LOG
from mdms_model.run.folder import BUS_LOG, DATABASE, SavePicture, bus_number, write_run
from mdms_model.run.record import Event, Plan, Record, Tile
from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import plain
from mdms_protocol.generators.generate import data_sheet

#: While parcels are on ways over tiles, the rest of these is kept so often [s].
AGAIN_S = 0.5
#: A run of any length is kept with the last of so many plans.
MOST_PLANS = 5000


class PlanLog:
    """Keeps a plan whenever it has changed; look as often as it may.

    That is when a parcel has got another goal or another way, or has come to its way's end, and now
    and then while tiles are left behind.
    """

    def __init__(self, coordinator: Coordinator) -> None:
        self.plans: list[Plan] = []
        self._coordinator = coordinator
        self._goals: dict[str, GoalPose] = {}
        self._ways: tuple[str, ...] = ()
        self._again_s = 0.0
        #: As long as this is the same object, the ways are the same.
        self._planned: object = None

    def look(self, time_s: float) -> None:
        """Keep the plan, if it is another than before."""
        program = self._program
        goals = dict(self._coordinator.goals)
        ways = () if program is None else tuple(program.traffic.under_way)
        planned = None if program is None else program.traffic.plan
        same = goals == self._goals and ways == self._ways and planned is self._planned
        if same and not (ways and time_s >= self._again_s):
            return
        self._again_s = time_s + AGAIN_S
        self._goals, self._ways, self._planned = goals, ways, planned
        self.plans.append(self._plan(time_s))
        del self.plans[:-MOST_PLANS]

    @property
    def _program(self) -> TableProgram | None:
        program = self._coordinator.program
        return program if isinstance(program, TableProgram) else None

    def _plan(self, time_s: float) -> Plan:
        program = self._program
        ways: dict[str, Floats] = {}
        due_s: dict[str, Floats] = {}
        tiles: tuple[Tile, ...] = ()
        if program is not None:
            ways = dict(program.traffic.ways)
            due_s = {name: time_s + in_s for name, in_s in program.traffic.due_in_s.items()}
            tiles = tuple(Tile(*tile) for tile in program.traffic.reserved)
        goals = {name: _pose(goal) for name, goal in self._goals.items()}
        return Plan(time_s, ways, tiles, due_s, goals)


def _pose(goal: GoalPose) -> Floats:
    yaw_rad = np.nan if goal.yaw_rad is None else goal.yaw_rad
    return np.array([goal.x_m, goal.y_m, yaw_rad])


class HostLog:
    """Keeps what every coordinator in its turn has planned and reported.

    `present` returns the present host, None without one.
    """

    def __init__(self, scenario: Scenario, present: Callable[[], Coordinator | None]) -> None:
        self._scenario = scenario
        self._present = present
        self._unknown: Floats = np.full((len(scenario.parcel), 3), np.nan)
        self._last: tuple[Coordinator, PlanLog] | None = None
        self._plans: list[Plan] = []
        self._events: list[Event] = []

    def sample(self, time_s: float) -> Floats:
        """The poses that are believed now [m, m, rad], shape (P, 3), NaN where unknown."""
        coordinator = self._present()
        if coordinator is None:
            return self._unknown
        if self._last is None or self._last[0] is not coordinator:
            self._close()
            self._last = coordinator, PlanLog(coordinator)
        self._last[1].look(time_s)
        return estimates_of(coordinator, self._scenario)

    def add_to(self, record: Record) -> None:
        """Put plans and events into the record of the same table."""
        self._close()
        record.plans = self._plans
        record.events = sorted(record.events + self._events, key=lambda event: event.time_s)

    def _close(self) -> None:
        """The coordinator that was there reports nothing more."""
        if self._last is not None:
            coordinator, log = self._last
            self._plans = (self._plans + log.plans)[-MOST_PLANS:]
            self._events += coordinator_events(coordinator)
            self._last = None


def coordinator_events(coordinator: Coordinator) -> list[Event]:
    """Reports of a coordinator."""
    return [Event(time_s, "coordinator", text) for time_s, text in coordinator.events]


def convert_log(log: Path, form: str) -> Path:
    """Write a candump log as `bus.blf` (Vector, binary) or `bus.asc` (Vector, text) beside it."""
    target = log.with_suffix(f".{form}")
    if target != log:
        with can.CanutilsLogReader(log) as messages, can.Logger(target) as writer:
            for message in messages:
                message.channel = bus_number(message.channel)
                writer(message)
    return target


def keep_run(
    folder: Path,
    scenario: Scenario,
    record: Record,
    figures: dict[str, Any],
    bus_format: str = "log",
    *,
    main: Main | None = None,
    array_file: Path | None = None,
    provenance: dict[str, Any] | None = None,
    pictures: bool = True,
) -> None:
    """Write everything of a run; its bus log, if it had a bus, is there already.

    `main` is its program in Python, and `array_file` the file of its table, if it had any; or
    `provenance` is given as a whole.

    Raises OSError.
    """
    if (folder / BUS_LOG).exists():
        convert_log(folder / BUS_LOG, bus_format)
        shutil.copyfile(data_sheet(DATABASE), folder / DATABASE)
    told = provenance_of(main, array_file) if provenance is None else provenance
    painter = _painter(record) if pictures else None
    write_run(folder, scenario, record, figures, painter, provenance=told)


#: Packages whose versions have a say in a run.
_PACKAGES = ("numpy", "numba", "python-can", "canopen", "mcap")


def provenance_of(main: Main | None, array_file: Path | None) -> dict[str, Any]:
    """The origin of a run of this process: command, revision, packages, program, array file."""
    told: dict[str, Any] = {"command": sys.argv, "revision": git_revision()}
    told["packages"] = {}
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            told["packages"][name] = version(name)
    if main is not None:
        bound = main if isinstance(main, functools.partial) else functools.partial(main)
        function = bound.func
        path = Path(function.__code__.co_filename)
        source = None
        if path.is_file():
            # In the encoding that it names.
            with tokenize.open(path) as file:
                source = file.read()
        # Functions within others, and arguments, cannot be had from the file.
        is_there = function.__qualname__.isidentifier() and not (bound.args or bound.keywords)
        told["program"] = {
            "file": path.name,
            "source": source,
            "function": function.__qualname__ if is_there else None,
        }
    if array_file is not None:
        told["array"] = {"file": array_file.name, "text": array_file.read_text("utf-8")}
    return told


def lasting(scenario: Scenario, duration_s: float) -> Scenario:
    """The scenario with another duration, as its run has had, so that it can be run again.

    It keeps its own after a run that has taken no time, or longer than a scenario may.
    """
    lasted = replace(scenario, run=replace(scenario.run, duration_s=duration_s))
    try:
        return scenario_from(plain(lasted))
    except ScenarioError:
        return scenario


def _painter(record: Record) -> SavePicture | None:
    """The drawing function of the picture; None without matplotlib, or for a single instant."""
    if len(record.time_s) < 2:
        return None
    if PICTURES.missing:
        LOG.warning(f"no picture without matplotlib: pip install {PICTURES.requirement}")
        return None
    # Matplotlib takes longer to import than a short run takes, so only a folder waits for it.
    from mdms_sim.plots import save_picture  # noqa: PLC0415

    return save_picture
