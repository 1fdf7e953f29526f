"""The present state of a table for its traffic: the plan in effect, places, and obstacles."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from math import hypot, inf
from types import MappingProxyType

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Footprint, has_room
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.planner import RoutePlan
from mdms_host.routes.route import Route
from mdms_host.routes.support import Shape
from mdms_model.arrays import Floats, Ints

#: A parcel that stands farther from its planned place is in the way of others [m].
_ASTRAY_M = 0.03


class Timetable:
    """Limits how far each may go, by the order over tiles: the plan's times keep nobody apart.

    `progress_m` is how far all have come on their routes of the `plan`; 0 where that is not listed.
    """

    def __init__(self) -> None:
        self.plan: RoutePlan | None = None
        self.progress_m: dict[str, float] = {}
        #: Parcels that left since the plan was asked for, and since the next one was: another
        #: parcel may have come under the same name.
        self._gone: set[str] = set()
        self._gone_since: set[str] = set()
        #: Parcels that wait for one that stays, by the parcels that ride and that stay.
        self._held: frozenset[str] = frozenset()
        self._held_by: tuple[frozenset[str], frozenset[str]] | None = None

    def asked(self) -> None:
        """The next plan has been asked for, with all that are there now."""
        self._gone_since.clear()

    def begin(self, plan: RoutePlan) -> None:
        """Have a plan take effect, which was asked for last."""
        self.plan, self.progress_m = plan, {}
        self._gone, self._held_by = set(self._gone_since), None

    def leave(self, name: str) -> None:
        """A parcel is no longer on the table, and in nobody's way."""
        self._gone.add(name)
        self._gone_since.add(name)

    def has_at(self, name: str, place: Floats) -> bool:
        """Whether something stands where the plan has it."""
        if self.plan is None or name in self._gone or name not in self.plan.routes:
            return False
        planned = self.plan.routes[name].pose_at(self.progress_m.get(name, 0.0))
        return bool(hypot(*(planned - place)[:2].tolist()) < _ASTRAY_M)

    def leads_beside(self, name: str, place: Floats) -> bool:
        """Whether something still stands where a route of the plan begins or ends beside it."""
        beside = () if self.plan is None else self.plan.beside.values()
        places = (its[name] for its in beside if name in its)
        return any(np.abs(its - place).max() < _SAME for its in places)

    def stopped_m(self, places: Mapping[str, Floats]) -> dict[str, float]:
        """How far those have come that stand where the plan has them, of these."""
        return {
            name: self.progress_m.get(name, 0.0)
            for name, place in places.items()
            if self.has_at(name, place)
        }

    def limits_m(self, there: Iterable[str]) -> dict[str, float]:
        """How far each may go, of those that are on the table."""
        return {} if self.plan is None else self.plan.reservations.limits_m(self._come_m(there))

    def held(
        self, there: Iterable[str], riding: Collection[str], going: Collection[str]
    ) -> frozenset[str]:
        """Parcels that wait for one that stays: that neither rides nor is yet to be `going`."""
        if self.plan is None:
            return frozenset()
        come_m = self._come_m(there)
        by = frozenset(riding), frozenset(come_m.keys() - {*riding, *going})
        if by != self._held_by:
            self._held, self._held_by = self.plan.reservations.held(come_m, by[1]), by
        return self._held

    def _come_m(self, there: Iterable[str]) -> Mapping[str, float]:
        there = {*there} - self._gone
        routes = () if self.plan is None else self.plan.routes
        return {name: self.progress_m.get(name, 0.0) for name in routes if name in there}


#: A parcel stops so far before an obstacle's tiles, for it is to find a way from there [m].
_SHORT_M = 0.01
#: An obstacle that has moved by less is where it was [m, m, rad].
_SAME = 2e-3

Stand = Callable[[Shape, Floats], Ints]


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something that lies where the plan has nothing: its place, and the tiles under it."""

    place: Floats
    shape: Shape
    tiles: Ints


class WorldState:
    """All things that are believed to lie on the table: parcels of known `loads`, and others.

    `places` are poses by name, at first as `told`. A parcel that is not believed anywhere has its
    last pose; an unknown thing lies only where it is seen. `stand` returns the tiles that a shape
    takes at a pose.
    """

    def __init__(
        self,
        loads: Mapping[str, Load],
        stand: Stand,
        told: Mapping[str, Floats] = MappingProxyType({}),
    ) -> None:
        self.places: dict[str, Floats] = dict(told)
        self.loads = loads
        self._stand = stand
        self._shapes: dict[str, tuple[Load, Shape]] = {}
        self._beliefs: Mapping[str, Belief] = {}
        self._seen_s: dict[str, float] = {}
        self._obstacles: dict[str, Obstacle] = {}

    def see(self, beliefs: Mapping[str, Belief], now_s: float) -> None:
        """Take in the present beliefs."""
        self._beliefs = beliefs
        self.places = {name: place for name, place in self.places.items() if name in self.loads} | {
            name: belief.pose for name, belief in beliefs.items()
        }
        for name in beliefs:
            self._seen_s[name] = now_s

    def drop(self, name: str) -> None:
        """Something is no longer on the table."""
        self.places.pop(name, None)
        self._seen_s.pop(name, None)
        self._obstacles.pop(name, None)

    def seen_s(self, name: str) -> float:
        """When something was believed to be anywhere last [s]; 0 for never."""
        return self._seen_s.get(name, 0.0)

    @property
    def outlines(self) -> dict[str, Footprint]:
        """The outline of everything that has a place."""
        return {
            name: self._beliefs[name].outline
            if name in self._beliefs
            else self.loads[name].footprint
            for name in self.places
        }

    @property
    def unseen(self) -> set[str]:
        """Parcels that are not believed anywhere now, though they have a last place."""
        return self.places.keys() - self._beliefs.keys()

    def shape(self, name: str) -> Shape | None:
        """The shape of a parcel, or of something unknown as far as it may reach, if it is seen."""
        if name in self.loads:
            # Another parcel may come under the name of a parcel that has left.
            load = self.loads[name]
            if name not in self._shapes or self._shapes[name][0] is not load:
                self._shapes[name] = load, shape_of(load)
            return self._shapes[name][1]
        return Shape(self._beliefs[name].outline) if name in self._beliefs else None

    def under(self) -> dict[str, Ints]:
        """The tiles under each thing that lies on the table."""
        lying = ((name, self.shape(name), place) for name, place in self.places.items())
        return {
            name: self._stand(shape, place) for name, shape, place in lying if shape is not None
        }

    def has_room(self, name: str, move: Floats) -> bool:
        """Whether a parcel may turn, and move so, without coming near any other."""
        return has_room(name, move, self.places, self.outlines)

    def find_obstacles(self, is_planned: Callable[[str, Floats], bool]) -> None:
        """Find things that lie where the plan has none."""
        kept, self._obstacles = self._obstacles, {}
        for name, place in self.places.items():
            if is_planned(name, place):
                continue
            before = kept.get(name)
            if before is not None and np.abs(before.place - place).max() < _SAME:
                self._obstacles[name] = before
            elif (shape := self.shape(name)) is not None:
                self._obstacles[name] = Obstacle(place, shape, self._stand(shape, place))

    def free_m(self, name: str, route: Route, progress_m: float) -> float:
        """Up to where a parcel's route is free of obstacles, from where it has come to [m].

        It may leave tiles that it stood on at the beginning: the route leads away from there.
        """
        visits, free_m = route.visits, inf
        ahead = (visits.leaves_m > progress_m) & (visits.enters_m > 0.0)
        for other, obstacle in self._obstacles.items():
            if other != name:
                met = ahead & np.isin(visits.tile, obstacle.tiles)
                free_m = min(free_m, float(visits.enters_m[met].min(initial=inf)) - _SHORT_M)
        return free_m


def shape_of(load: Load) -> Shape:
    """The shape that a load is planned with."""
    return Shape(load.footprint, load.mass.centre_m)
