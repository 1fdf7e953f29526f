"""Parcels that come and leave, as the page shows them: where, how many, and under which names."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.parcel import Parcel, outline_corners_m
from mdms_host.programs.program import TableProgram
from mdms_model.array import edge_m
from mdms_model.arrays import Floats
from mdms_model.run.record import Event, exit_of
from mdms_model.scenario.scenario import Array, Exit, Scenario, in_stock


@dataclass(frozen=True, slots=True)
class Ends:
    """The infeeds and exits of a table, as the description has them; none by default.

    `stock` names the parcels that come by an infeed. `kinds` has the kind of each parcel that is
    like others, by its name. `since_s` is when the first infeed may bring a parcel.
    """

    infeeds: tuple[Mapping[str, Any], ...] = ()
    exits: tuple[Mapping[str, Any], ...] = ()
    stock: frozenset[str] = frozenset()
    kinds: Mapping[str, str] = field(default_factory=dict)
    since_s: float = 0.0

    def describe(self) -> dict[str, Any]:
        """The members of the message `table`."""
        return {"infeeds": [*self.infeeds], "exits": [*self.exits], "stock": sorted(self.stock)}


NO_ENDS = Ends()


def ends_of(scenario: Scenario, parcels: Iterable[Parcel]) -> Ends:
    """Those of a scenario, whose parcels have these outlines."""
    outlines = {parcel.name: outline_corners_m(parcel) for parcel in parcels}
    infeeds = tuple(
        {
            "x_m": stream.x_m,
            "y_m": stream.y_m,
            "yaw_rad": stream.yaw_rad,
            "outline_m": [list(corner) for corner in outlines[stream.parcels[0]]],
        }
        for stream in scenario.stream
    )
    return Ends(
        infeeds,
        tuple(_edge(each, scenario.array) for each in scenario.exit),
        frozenset(in_stock(scenario)),
        {parcel.name: parcel.kind for parcel in scenario.parcel if parcel.kind},
        min((stream.start_s for stream in scenario.stream), default=0.0),
    )


def _edge(exit_: Exit, array: Array) -> dict[str, Any]:
    """An exit with the ends of its stretch of the table's edge, and the way out."""
    ends_m = edge_m(array, exit_.side, exit_.from_m, exit_.to_m).tolist()
    out = {"east": [1.0, 0.0], "west": [-1.0, 0.0], "north": [0.0, 1.0], "south": [0.0, -1.0]}
    return {
        "name": exit_.name,
        "ends_m": ends_m,
        "out": out[exit_.side],
        "kinds": [*exit_.kinds],
    }


class FlowCount:
    """Counts of the parcels that have come, and left by each exit, from events as they happen."""

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self._seen = 0
        self._came = 0
        self._left = dict.fromkeys((each["name"] for each in ends.exits), 0)

    def count(self, events: Sequence[Event]) -> None:
        """Count those of all events that are new since the last call."""
        for event in events[self._seen :]:
            if event.kind == "arrival":
                self._came += 1
            elif event.kind == "exit" and exit_of(event) in self._left:
                self._left[exit_of(event)] += 1
        self._seen = len(events)

    def values(self, now_s: float) -> dict[str, Any]:
        """The signals by name; none for a table where no parcel comes or leaves."""
        return flow_values(self._ends, self._came, self._left, now_s - self._ends.since_s)


def flow_values(ends: Ends, came: int, left: Mapping[str, int], lasts_s: float) -> dict[str, Any]:
    """The signals of so many parcels that came, and left by exits, within a time [s]."""
    if not (ends.infeeds or ends.exits):
        return {}
    return {
        "parcels_came": [came],
        "parcels_left": [left.get(each["name"], 0) for each in ends.exits],
        "flow_time": [max(0.0, lasts_s)],
    }


def believed_flow(ends: Ends, coordinator: Coordinator | None) -> dict[str, Any]:
    """The same as the program that runs has counted; none without one."""
    program = None if coordinator is None else coordinator.program
    if not isinstance(program, TableProgram):
        return {}
    driver = program.driver
    return flow_values(ends, driver.came, driver.left, program.table.now_s)


def beside(
    believed: Mapping[str, Floats], true: Mapping[str, Floats], ends: Ends
) -> dict[str, Floats]:
    """True poses by the names under which the host has those parcels.

    Like parcels look alike to the host: a newcomer gets the first free name of its kind. So of each
    kind the true pose nearest to a belief has that belief's name. `believed` has the poses
    (x, y, yaw) of parcels that have been found, and `true` of parcels on the table.
    """
    named = dict(true)
    ordered = sorted(ends.kinds, key=ends.kinds.__getitem__)
    for _, like in groupby(ordered, ends.kinds.__getitem__):
        names = list(like)
        places = {name: true[name] for name in names if name in true}
        if len(names) > 1 and places:
            for name in places:
                del named[name]
            named |= _nearest({name: believed[name] for name in names if name in believed}, places)
    return named


def _nearest(believed: Mapping[str, Floats], true: Mapping[str, Floats]) -> dict[str, Floats]:
    """Each true pose under the name of the nearest belief, the nearest pair first.

    The rest have a name of their own that is free.
    """
    pairs = sorted(
        (float(np.hypot(*(pose - place)[:2])), name, other)
        for name, pose in believed.items()
        for other, place in true.items()
    )
    named: dict[str, Floats] = {}
    taken: set[str] = set()
    for _, name, other in pairs:
        if name not in named and other not in taken:
            named[name] = true[other]
            taken.add(other)
    for other in true.keys() - taken:
        free = other if other not in named else next(iter(true.keys() - named.keys()))
        named[free] = true[other]
    return named
