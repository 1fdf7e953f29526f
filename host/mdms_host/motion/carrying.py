"""From the aims of each parcel's wheels to the references of all wheels.

Each wheel serves one parcel at most, by the believed outlines.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mdms_host.estimation.belief import Gain
from mdms_host.estimation.footprint import Footprint
from mdms_host.layout import Layout
from mdms_host.motion.trajectory.follower import Carried
from mdms_host.motion.trajectory.traction import WheelDrives
from mdms_model.arrays import Floats, Ints

#: A wheel that serves no parcel.
FREE = -1
#: Wheels this far outside a parcel that moves already run as if they were under it.
AHEAD_M = 0.05
#: Wheels this far outside a parked parcel still hold it: a belief may be wrong by as much.
_HOLD_M = 0.01


@dataclass(frozen=True, slots=True)
class WheelClaim:
    """A parcel that wants the wheels under it: to carry it, or, `parked`, to stand still."""

    outline: Footprint
    pose: Floats
    parked: bool


def allocate(wheels_m: Floats, claims: Sequence[WheelClaim]) -> Ints:
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


class Carrying:
    """The wheels of a layout with their drives, as they carry parcels, by name.

    `speeds_m_s` (W,) is how fast each is to run for its parcel's way under the references that were
    returned last. The rest of a reference is push, under which a wheel may well stand. `gains` are
    the earlier gains of the wheels under each parcel, by its name.
    """

    def __init__(self, layout: Layout, drives: WheelDrives) -> None:
        self._layout = layout
        self._drives = drives
        self.speeds_m_s: Floats = np.zeros(len(layout.wheel_positions_m))
        self.gains: Mapping[str, Gain] = {}

    def references_m_s(
        self,
        carried: Mapping[str, Carried],
        outlines: Mapping[str, Footprint],
        places: Mapping[str, Floats],
    ) -> Floats:
        """References (W,) that carry these parcels; wheels under any other, or near none, stand.

        `places` are the believed poses of all parcels that may lie on wheels.
        """
        wheels_m = self._layout.wheel_positions_m
        references_m_s = np.zeros(len(wheels_m))
        self.speeds_m_s = np.zeros(len(wheels_m))
        self.gains = {name: one.gain for name, one in carried.items() if one.gain is not None}
        if not carried:
            return references_m_s
        claims = [
            WheelClaim(outlines[name], place, name not in carried) for name, place in places.items()
        ]
        serves = allocate(wheels_m, claims)
        for number, name in enumerate(places):
            one = carried.get(name)
            if one is not None:
                mine = serves == number
                reference_m_s, speed_m_s = self._of_one(one)
                np.copyto(references_m_s, reference_m_s, where=mine)
                np.copyto(self.speeds_m_s, speed_m_s, where=mine)
        return references_m_s

    def _of_one(self, carried: Carried) -> tuple[Floats, Floats]:
        """References and speeds of all wheels, (W,), as if all of them served one parcel."""
        jacobian = self._layout.surface_jacobian(*carried.pose[:2].tolist())
        speed_m_s, wanted_m_s, expected_m_s, rate_m_s2 = (
            jacobian
            @ np.column_stack(
                (carried.reference, carried.twist, carried.expected, carried.acceleration)
            )
        ).T
        # Wheels that carry nothing push nothing: they are to run as the parcel is to move.
        force_n = self._drives.b_n_s_per_m * (wanted_m_s - expected_m_s)
        force_n[carried.wheels] = carried.force_n
        return self._drives.references_m_s(expected_m_s, rate_m_s2, force_n), speed_m_s
