"""Which parcel each wheel serves, from the believed outlines."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mdms_host.estimation.footprint import Bottom
from mdms_model.arrays import Floats, Ints

#: A wheel that serves no parcel.
FREE = -1
#: Wheels this far outside a parcel that moves already run as if they were under it.
AHEAD_M = 0.05
#: Wheels this far outside a parked parcel still hold it: a belief may be wrong by as much.
_HOLD_M = 0.01


@dataclass(frozen=True, slots=True)
class Claim:
    """A parcel that wants the wheels under it: to carry it, or, `parked`, to stand still."""

    outline: Bottom
    pose: Floats
    parked: bool


def allocate(wheels_m: Floats, claims: Sequence[Claim]) -> Ints:
    """The claim that each wheel serves, by number, or FREE, (W,); wheels of shape (W, 2).

    A wheel serves one parcel at most: a parked one before one that moves, else the nearer.
    """
    serves = np.full(len(wheels_m), FREE, dtype=np.intp)
    nearest_m = np.full(len(wheels_m), np.inf)
    for parked, reach_m in ((True, _HOLD_M), (False, AHEAD_M)):
        open_ = serves == FREE if not parked else np.ones(len(wheels_m), dtype=bool)
        for number, claim in enumerate(claims):
            if claim.parked != parked:
                continue
            away_m = claim.outline.distance_m(wheels_m, claim.pose)
            mine = open_ & (away_m < np.minimum(nearest_m, reach_m))
            nearest_m[mine], serves[mine] = away_m[mine], number
    return serves
