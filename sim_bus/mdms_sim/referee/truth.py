"""The knowledge of the referee: the scenario, the world, and the host's reports of itself."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mdms_model.buses import Addresses
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.plane.world import World

#: Where a parcel is to be [m, m, rad; table frame]; the yaw is None where any will do.
Pose = tuple[float, float, float | None]


class Note(Protocol):
    """Notes a violation of a rule, by a cell (number from 1) or about a parcel."""

    def __call__(
        self, rule: str, text: str, *, cell: int | None = None, parcel: str | None = None
    ) -> None:
        """The violation is of this instant."""


@dataclass(frozen=True, slots=True)
class HostReport:
    """The host's report at one instant.

    `goals` has the parcels that it steers to one, `arrived` those that it reports there, and
    `believed` their believed poses. `reason` says why it cannot go on, if it does. `trouble_s` is
    the time of its last report of trouble [s]. `over` is whether its job has ended as requested.
    """

    goals: Mapping[str, Pose] = field(default_factory=dict)
    arrived: Mapping[str, Pose] = field(default_factory=dict)
    believed: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    reason: str | None = None
    trouble_s: float = -inf
    over: bool = False


@dataclass(frozen=True, slots=True)
class Truth:
    """The run as it is, for the judges.

    `places` has the place of each cell's node, both from 0. `host` returns the host's report of
    now, or None while no host runs. Without `host` reports are not known.
    """

    scenario: Scenario
    addresses: Addresses
    world: World
    places: NDArray[np.intp]
    host: Callable[[], HostReport | None] | None = None
