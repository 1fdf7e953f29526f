"""How far each parcel may go now, from how far all have really come."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import inf

from mdms_host.routes.reservations import Reservations


@dataclass(frozen=True)
class Authority:
    """Movement authorities by the order over tiles: no parcel enters one before those ahead left.

    A follower is expected to come to rest before the path coordinate that it is given, at poses of
    its route within `reservations.REST_M`. It rests before that by no more than the way that it
    makes from rest in the plan's `gap_s`.
    """

    reservations: Reservations

    def limits_m(self, progress_m: Mapping[str, float]) -> dict[str, float]:
        """The path coordinate up to which each way is free [m]; the route's end for all of it.

        `progress_m` is the path coordinate at which each parcel is believed to be. A parcel that is
        left out is no longer on the table.
        """
        limits_m: dict[str, float] = {}
        for name in progress_m.keys() & self.reservations.routes.keys():
            limit_m = self.reservations.routes[name].length_m
            for before_m, other, leaves_m in self.reservations.waits[name]:
                if before_m >= limit_m:
                    break
                if progress_m.get(other, inf) < leaves_m:
                    limit_m = before_m
            limits_m[name] = limit_m
        return limits_m

    def held(self, progress_m: Mapping[str, float], still: Collection[str]) -> frozenset[str]:
        """The parcels that never come to the end of their routes while those of `still` stay.

        They wait for these, or for another parcel that does. Parcels of `still` are not among them.
        """
        routes = self.reservations.routes
        come_m, before_m = dict(progress_m), None
        while come_m != before_m:
            before_m = dict(come_m)
            limits_m = self.limits_m(come_m)
            for name in limits_m.keys() - still:
                come_m[name] = max(come_m[name], limits_m[name])
        going = come_m.keys() & routes.keys() - set(still)
        return frozenset(name for name in going if come_m[name] < routes[name].length_m)
