"""A parallel environment of PettingZoo: each cell is an agent that sees its neighbourhood only."""

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from mdms_array.learning.environments import FAR, PARCEL, Episode, options_of, own_option
from mdms_array.learning.episodes import open_scenario
from mdms_array.learning.tasks import ParcelTask
from mdms_model.array import cell_centres
from mdms_model.arrays import Floats, Ints
from mdms_model.errors import InputError
from mdms_model.scenario.scenario import Array

#: A cell and its eight neighbours, by rows from the south west.
NEAR = 9


class CellsEnv(ParallelEnv[str, Floats, Floats]):  # type: ignore[misc]
    """The cells of a table bring the first parcel to its goal together.

    An agent sees of itself and of each of its eight neighbours: whether there is one, its presence
    sensors, and the speeds of its wheels. It also sees the goal from its own place: x, y, cosine
    and sine of the angle, as cells get it on the bus. Its action has its own wheels' references,
    as shares of `most_m_s`. All agents have the reward of `ParcelTask`.

    Options are those of `mdms/Parcel-v0`, but for `action`. Raises `InputError`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "mdms_cells_v0",
        "render_modes": [],
        "is_parallelizable": True,
    }

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        if render_mode is not None:
            raise InputError(f"render_mode is {render_mode!r}, but nothing is drawn; leave it out")
        if "action" in options:
            raise InputError("action: an agent sets its own wheels; leave it out")
        self.render_mode = None
        self.episode = Episode(ParcelTask, options_of(PARCEL, options))
        scenario = self.episode.scenario
        axes, sensors = len(scenario.cell.wheel), len(scenario.cell.sensor_offset_m)
        if scenario.patch:
            raise InputError("patch: cells that differ are no agents of one kind; leave it out")
        self._centres_m = cell_centres(scenario.array)
        self._near = neighbours(scenario.array)
        self.possible_agents = [f"cell_{number + 1}" for number in range(len(self._near))]
        self.agents: list[str] = []
        self._space = spaces.Box(-FAR, FAR, (NEAR * (1 + sensors + axes) + 4,), np.float32)
        self._actions = spaces.Box(-1.0, 1.0, (axes,), np.float32)
        self._own = {
            agent: (_copy(self._space), _copy(self._actions)) for agent in self.possible_agents
        }
        self._axes = axes
        self._chance = seeding.np_random(None)[0]

    def observation_space(self, agent: str) -> spaces.Box:
        """The space of a cell's observation."""
        return self._own[agent][0]

    def action_space(self, agent: str) -> spaces.Box:
        """The space of its references."""
        return self._own[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, dict[str, Any]]]:
        """Begin an episode of `options["scenario"]`, or of a drawn scenario."""
        if seed is not None:
            self._chance = seeding.np_random(seed)[0]
        given = own_option(options, "scenario")
        self.episode.begin(0, self._chance, None if given is None else open_scenario(given))
        self.agents = [*self.possible_agents]
        return self._seen(), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, Floats]
    ) -> tuple[
        dict[str, Floats],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Move the table by a control period of 10 ms; agents without an action stand still.

        Raises `InputError` for actions of no agent, or that are no references of its wheels.
        """
        if not self.agents:
            return {}, {}, {}, {}, {}
        judgement, late = self.episode.step(self._shares(actions)[None])
        reward, over = float(judgement.reward[0]), bool(judgement.ended[0])
        infos = {name: each[0] for name, each in judgement.infos.items()}
        seen, agents = self._seen(), self.agents
        if over or late[0]:
            self.agents = []
        return (
            seen,
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, over),
            dict.fromkeys(agents, bool(late[0])),
            {agent: dict(infos) for agent in agents},
        )

    def _shares(self, actions: dict[str, Floats]) -> Floats:
        for agent, action in actions.items():
            if agent not in self._own:
                raise InputError(
                    f"actions: {agent!r} is no agent; there are {self.possible_agents[0]} to "
                    f"{self.possible_agents[-1]}"
                )
            if np.shape(action) != (self._axes,):
                raise InputError(
                    f"actions: that of {agent} has the shape {np.shape(action)}, but must have "
                    f"{(self._axes,)}: a number for each wheel"
                )
        still = np.zeros(self._axes, np.float32)
        return np.concatenate([actions.get(agent, still) for agent in self.possible_agents])

    def _seen(self) -> dict[str, Floats]:
        table = {name: each[0] for name, each in self.episode.observation().items()}
        cells = len(self._near)
        own = np.zeros((cells + 1, self._space.shape[0] // NEAR), np.float32)
        own[:cells, 0] = 1.0
        own[:cells, 1 : -self._axes] = table["presence"].reshape(cells, -1)
        own[:cells, -self._axes :] = table["wheel_speed_m_s"].reshape(cells, -1)
        # The last row stands for all places beyond the edge of the table.
        near = own[self._near].reshape(cells, -1)
        goal = np.tile(table["goal"], (cells, 1))
        goal[:, :2] -= self._centres_m
        rows = np.concatenate([near, goal], axis=1, dtype=np.float32)
        return dict(zip(self.possible_agents, rows, strict=True))

    def render(self) -> None:
        """Nothing is drawn."""

    def close(self) -> None:
        """End the cells of the table."""
        self.episode.tables.close()


def neighbours(array: Array) -> Ints:
    """Numbers of each cell's neighbourhood (cells, 9), from 0; `cells` for one beyond the edge."""
    columns, rows = array.columns, array.rows
    row, column = np.divmod(np.arange(columns * rows), columns)
    steps = np.array([(down, along) for down in (-1, 0, 1) for along in (-1, 0, 1)])
    rows_near, columns_near = row[:, None] + steps[:, 0], column[:, None] + steps[:, 1]
    inside = (rows_near >= 0) & (rows_near < rows) & (columns_near >= 0) & (columns_near < columns)
    return np.where(inside, rows_near * columns + columns_near, columns * rows)


def _copy(space: spaces.Box) -> spaces.Box:
    return spaces.Box(space.low, space.high, space.shape, np.float32)


def cells_env(**options: Any) -> CellsEnv:
    """A parallel environment in which each cell is an agent; see `CellsEnv`."""
    return CellsEnv(**options)
