"""Environments of Gymnasium: one table, or many that are stepped by one compiled call.

Table k of many does what one table does alone with the seed of the first plus k.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from mdms_array.experiments.settings import check_count, integers, is_number, uniform
from mdms_array.learning.actions import Actions
from mdms_array.learning.episodes import Episodes, open_scenario
from mdms_array.learning.tables import (
    FIDELITIES,
    PERIOD_S,
    FirmwareTables,
    IdealTables,
    Tables,
)
from mdms_array.learning.tasks import Judgement, LearningTask, ParcelTask, SortTask
from mdms_array.source import Source
from mdms_model.array import build_wheels
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.errors import InputError
from mdms_model.scenario.scenario import Scenario

Observation = dict[str, Any]
#: No place [m], speed [m/s] or yaw rate [rad/s] is beyond this.
FAR = 1000.0
LONGEST_S = 3600.0
#: Options of a reset: of one table, of many, and of Gymnasium's own for many.
OPTIONS = ("scenario", "scenarios", "reset_mask")


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvOptions:
    """The options of an environment. Raises `InputError`."""

    scenario: Source
    fidelity: str = "ideal"
    action: str = "wheels"
    most_m_s: float = 0.3
    randomise: Mapping[str, Any]
    duration_s: float = 10.0
    threads: int = 1

    def __post_init__(self) -> None:
        if self.fidelity not in FIDELITIES:
            must = " or ".join(FIDELITIES)
            raise InputError(f"fidelity is {self.fidelity!r}, but must be {must}")
        if not (is_number(self.duration_s) and PERIOD_S <= self.duration_s <= LONGEST_S):
            raise InputError(
                f"duration_s is {self.duration_s!r}, but must be {PERIOD_S:g} to {LONGEST_S:g} "
                "seconds"
            )
        check_count("threads", self.threads)


class Episode:
    """N tables with a task: their observations, and their steps under actions."""

    def __init__(
        self, task: Callable[..., LearningTask], options: EnvOptions, tables: int = 1
    ) -> None:
        self._episodes = Episodes(options.scenario, options.randomise)
        base = self._episodes.base
        self.actions = Actions(base, options.action, options.most_m_s)
        self._most = round(options.duration_s / PERIOD_S)
        self._done: Ints = np.zeros(tables, np.int64)
        #: Tables with an episode; one whose beginning was refused has none.
        self._begun: Bools = np.zeros(tables, np.bool_)
        self._sensors = np.arange(len(base.cell.sensor_offset_m))
        self.scenario = base
        self.tables: Tables
        if options.fidelity == "firmware":
            self.tables = FirmwareTables([base] * tables)
        else:
            self.tables = IdealTables([base] * tables, options.threads)
        self.task = task(base, tables)

    @property
    def action_space(self) -> spaces.Box:
        """The space of one table's action."""
        return spaces.Box(-1.0, 1.0, (len(self.actions.names),), np.float32)

    @property
    def observation_space(self) -> spaces.Dict:
        """The space of one table's observation."""
        cells = self.scenario.array.columns * self.scenario.array.rows
        wheels = len(build_wheels(self.scenario).cell)
        shapes = {"wheel_speed_m_s": (wheels,), **self.task.sizes}
        boxes: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(-FAR, FAR, shape, np.float32) for name, shape in shapes.items()
        }
        return spaces.Dict({"presence": spaces.MultiBinary(cells * len(self._sensors)), **boxes})

    def begin(self, k: int, chance: np.random.Generator, scenario: Scenario | None = None) -> None:
        """Begin another episode at table k, of `scenario` or of a drawn one."""
        self._begun[k] = False
        scenario = scenario or self._episodes.draw(chance)
        self.tables.begin(k, scenario)
        self.task.begin(k, scenario, self.tables)
        self._done[k] = 0
        self._begun[k] = True

    def observation(self) -> Observation:
        """The observations of all tables."""
        bits = self.tables.presence[..., None] >> self._sensors & 1
        seen: Observation = {"presence": bits.reshape(len(bits), -1).astype(np.int8)}
        seen["wheel_speed_m_s"] = self.tables.wheel_speed_m_s.astype(np.float32)
        return seen | {
            name: np.asarray(each, np.float32) for name, each in self.task.seen(self.tables).items()
        }

    def step(self, actions: Floats) -> tuple[Judgement, Bools]:
        """Move all tables by a period; the judgement, and which episodes have no time left.

        Raises `InputError` for actions of another shape than (N, A), or that are no numbers, and
        for tables without an episode.
        """
        if not self._begun.all():
            raise InputError("step: no episode has begun; call reset first")
        actions = np.asarray(actions)
        shape = len(self._done), len(self.actions.names)
        if actions.shape != shape:
            raise InputError(
                f"action: its shape is {actions.shape}, but must be {shape}: tables, numbers"
            )
        if actions.dtype.kind not in "fiub":
            raise InputError(f"action: it has {actions.dtype}, but must have numbers from -1 to 1")
        if np.isnan(actions).any():
            raise InputError("action: it has NaN, but must have numbers from -1 to 1")
        return self.move(self.actions.references_m_s(actions))

    def move(self, reference_m_s: Floats) -> tuple[Judgement, Bools]:
        """The same under references (N, W)."""
        self.tables.move(reference_m_s)
        self._done += 1
        judgement = self.task.judge(self.tables)
        faults = self.tables.faults
        if faults:
            judgement.ended = judgement.ended | np.array([fault is not None for fault in faults])
            judgement.infos["fault"] = np.array(faults, dtype=object)
        return judgement, self._done >= self._most


PARCEL: Mapping[str, Any] = {
    "scenario": "array18",
    "randomise": {
        "parcel.0.x_m": uniform(-0.12, 0.12),
        "parcel.0.y_m": uniform(-0.04, 0.04),
        "parcel.0.yaw_rad": uniform(-0.8, 0.8),
        "parcel.0.goal.x_m": uniform(-0.12, 0.12),
        "parcel.0.goal.y_m": uniform(-0.04, 0.04),
        "parcel.0.goal.yaw_rad": uniform(-0.8, 0.8),
    },
}
SORT: Mapping[str, Any] = {
    "scenario": "sort54",
    "randomise": {"run.seed": integers(0, 2**31 - 1)},
    "duration_s": 60.0,
}


def options_of(defaults: Mapping[str, Any], given: Mapping[str, Any]) -> EnvOptions:
    """The options of an environment. Raises `InputError` for an unknown option."""
    known = [field.name for field in fields(EnvOptions)]
    for name in given:
        if name not in known:
            raise InputError(
                f"{name} is no option of the environment; there are {', '.join(known)}"
            )
    return EnvOptions(**{**defaults, **given})


def own_option(options: Mapping[str, Any] | None, name: str) -> Any:
    """An option of a reset, None without. Raises `InputError` for one of other environments.

    Options that no environment here knows are for others: PettingZoo's tests give some.
    """
    for other in OPTIONS:
        if options and other != name and other in options:
            raise InputError(f"options: {other!r} is given, but this reset takes {name!r}")
    return None if options is None else options.get(name)


class _TableEnv(gymnasium.Env[Observation, Any]):
    """One table; `defaults` are those of its task."""

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": round(1 / PERIOD_S)}  # noqa: RUF012
    task: ClassVar[Callable[..., LearningTask]]
    defaults: ClassVar[Mapping[str, Any]]

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        if render_mode is not None:
            raise InputError(f"render_mode is {render_mode!r}, but nothing is drawn; leave it out")
        self.render_mode = None
        self.episode = Episode(type(self).task, options_of(self.defaults, options))
        self.action_space = self.episode.action_space
        self.observation_space = self.episode.observation_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode of `options["scenario"]`, or of a drawn scenario."""
        super().reset(seed=seed)
        given = own_option(options, "scenario")
        scenario = None if given is None else open_scenario(given)
        self.episode.begin(0, self.np_random, scenario)
        return self._seen(), {}

    def step(self, action: Floats) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the table by a control period of 10 ms; see Gymnasium."""
        judgement, late = self.episode.step(np.asarray(action)[None])
        infos = {name: each[0] for name, each in judgement.infos.items()}
        ended, reward = bool(judgement.ended[0]), float(judgement.reward[0])
        return self._seen(), reward, ended, bool(late[0]), infos

    def _seen(self) -> Observation:
        return {name: each[0] for name, each in self.episode.observation().items()}

    def close(self) -> None:
        """End the cells of the table."""
        self.episode.tables.close()


class _TableVectorEnv(VectorEnv[Observation, Any, Any]):
    """Many tables. One whose episode has ended begins another at the next step."""

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012
    task: ClassVar[Callable[..., LearningTask]]
    defaults: ClassVar[Mapping[str, Any]]

    def __init__(self, num_envs: int = 1, **options: Any) -> None:
        if options.pop("render_mode", None) is not None:
            raise InputError("render_mode: nothing is drawn; leave it out")
        if not isinstance(num_envs, int) or num_envs < 1:
            raise InputError(f"num_envs is {num_envs!r}, but must be a whole number from 1")
        self.num_envs = num_envs
        self.episode = Episode(type(self).task, options_of(self.defaults, options), num_envs)
        self.single_action_space = self.episode.action_space
        self.single_observation_space = self.episode.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._chances = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._over: Bools = np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode at each table; a seed is that of table 0, the next has one more.

        `options["scenarios"]` has a scenario for each table, in place of those that are drawn.
        """
        given = own_option(options, "scenarios")
        if given is None:
            given = [None] * self.num_envs
        if not isinstance(given, list | tuple):
            raise InputError(f"scenarios: {given!r} is no list; give one scenario for each table")
        if len(given) != self.num_envs:
            raise InputError(
                f"scenarios: {len(given)} are given, but there are {self.num_envs} tables"
            )
        if isinstance(seed, int):
            seed = [seed + k for k in range(self.num_envs)]
        if not isinstance(seed, list | tuple | None):
            raise InputError(
                f"seed is {seed!r}, but must be a whole number, or a list of one for each table"
            )
        if seed is not None and len(seed) != self.num_envs:
            raise InputError(f"seed: {len(seed)} are given, but there are {self.num_envs} tables")
        for k, own in enumerate(seed or ()):
            if own is not None:
                self._chances[k] = seeding.np_random(own)[0]
        for k, chance in enumerate(self._chances):
            scenario = None if given[k] is None else open_scenario(given[k])
            self.episode.begin(k, chance, scenario)
        self._over[:] = False
        return self.episode.observation(), {}

    def step(self, actions: Floats) -> tuple[Observation, Floats, Bools, Bools, dict[str, Any]]:
        """Move all tables by a control period; those that were over begin another episode."""
        began = np.flatnonzero(self._over)
        judgement, late = self.episode.step(actions)
        ended, reward = judgement.ended, judgement.reward
        for k in began.tolist():
            self.episode.begin(k, self._chances[k])
            ended[k] = late[k] = False
            reward[k] = 0.0
        self._over = ended | late
        infos: dict[str, Any] = dict(judgement.infos)
        told = np.ones(self.num_envs, np.bool_)
        # The step of a table that begins has no judgement: that was of its last episode.
        told[began] = False
        for each in infos.values():
            each[began] = None if each.dtype == object else 0
        infos |= {f"_{name}": told.copy() for name in judgement.infos}
        return self.episode.observation(), reward, ended, late, infos

    def close_extras(self, **_: Any) -> None:
        """End the cells of all tables."""
        self.episode.tables.close()


class ParcelEnv(_TableEnv):
    """`mdms/Parcel-v0`: one parcel is to stand at its goal, on `array18`; see `ParcelTask`."""

    task = ParcelTask
    defaults = PARCEL


class ParcelVectorEnv(_TableVectorEnv):
    """The same for `num_envs` tables; `threads` share them."""

    task = ParcelTask
    defaults = PARCEL


class SortEnv(_TableEnv):
    """`mdms/Sort-v0`: parcels that come leave by the exits for their kinds; see `SortTask`."""

    task = SortTask
    defaults = SORT


class SortVectorEnv(_TableVectorEnv):
    """The same for `num_envs` tables; `threads` share them."""

    task = SortTask
    defaults = SORT


def register() -> None:
    """Make the environments known to Gymnasium, once."""
    for name in ("Parcel", "Sort"):
        if f"mdms/{name}-v0" not in gymnasium.registry:
            gymnasium.register(
                f"mdms/{name}-v0",
                entry_point=f"mdms_array.learning.environments:{name}Env",
                vector_entry_point=f"mdms_array.learning.environments:{name}VectorEnv",
            )
