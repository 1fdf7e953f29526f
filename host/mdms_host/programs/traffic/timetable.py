"""The plan in effect, and how far all have come on their routes."""

from collections.abc import Collection, Iterable, Mapping
from math import hypot

from mdms_host.routes.planner import Plan
from mdms_model.arrays import Floats

#: A parcel that stands farther from its planned place is in the way of others [m].
_ASTRAY_M = 0.03


class Timetable:
    """Limits how far each may go, by the order over tiles: the plan's times keep nobody apart.

    `progress_m` is how far all have come on their routes of the `plan`; 0 where that is not listed.
    """

    def __init__(self) -> None:
        self.plan: Plan | None = None
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

    def begin(self, plan: Plan) -> None:
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

    def stopped_m(self, places: Mapping[str, Floats]) -> dict[str, float]:
        """How far those have come that stand where the plan has them, of these."""
        return {
            name: self.progress_m.get(name, 0.0)
            for name, place in places.items()
            if self.has_at(name, place)
        }

    def limits_m(self, there: Iterable[str]) -> dict[str, float]:
        """How far each may go, of those that are on the table."""
        return {} if self.plan is None else self.plan.authority.limits_m(self._come_m(there))

    def held(
        self, there: Iterable[str], riding: Collection[str], going: Collection[str]
    ) -> frozenset[str]:
        """Parcels that wait for one that stays: that neither rides nor is yet to be `going`."""
        if self.plan is None:
            return frozenset()
        come_m = self._come_m(there)
        by = frozenset(riding), frozenset(come_m.keys() - {*riding, *going})
        if by != self._held_by:
            self._held, self._held_by = self.plan.authority.held(come_m, by[1]), by
        return self._held

    def _come_m(self, there: Iterable[str]) -> Mapping[str, float]:
        there = {*there} - self._gone
        routes = () if self.plan is None else self.plan.routes
        return {name: self.progress_m.get(name, 0.0) for name in routes if name in there}
