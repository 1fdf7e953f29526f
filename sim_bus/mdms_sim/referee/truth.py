"""What the referee may know: the scenario, the world, and what the host says of itself."""

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
    """What the host says at one instant.

    `goals` are those of the parcels that it steers to one, and `arrived` of those that it says are
    there; `believed` is where it takes these for. `reason` is why it cannot go on, if it says so;
    `trouble_s` is when it has reported a trouble last [s]. `over` is whether its job has ended as
    it was asked for.
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

    `places` has the place of each cell's node, both from 0. `host` returns what the host says now,
    None while nobody runs; where it is None nobody knows what a host says.
    """

    scenario: Scenario
    addresses: Addresses
    world: World
    places: NDArray[np.intp]
    host: Callable[[], HostReport | None] | None = None
