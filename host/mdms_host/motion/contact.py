"""Room between parcels, by their believed outlines."""

from collections.abc import Mapping
from math import hypot

from mdms_host.estimation.footprint import Footprint
from mdms_model import outline
from mdms_model.arrays import Floats

#: Room that a parcel needs around it to turn on the spot, and beside its way to go around [m].
_NEAR_M = 0.015
_BESIDE_M = 0.05


def gap_m(one: Footprint, one_pose: Floats, other: Footprint, other_pose: Floats) -> float:
    """Gap between two parcels' outlines along the direction that parts them best [m]."""
    return outline.gap_m(one.outline_m(one_pose), other.outline_m(other_pose))


def has_room(
    name: str, move: Floats, places: Mapping[str, Floats], outlines: Mapping[str, Footprint]
) -> bool:
    """Whether a parcel may turn, and move so, without coming near any other that has a place."""
    mine = places[name]
    reach_m = outlines[name].reach_m + _NEAR_M + hypot(*move[:2].tolist())
    return not any(
        hypot(*(place - mine)[:2].tolist()) < reach_m + outlines[other].reach_m
        for other, place in places.items()
        if other != name
    )


def has_room_to(
    end: Floats, name: str, places: Mapping[str, Floats], outlines: Mapping[str, Footprint]
) -> bool:
    """Whether no other parcel that has a place is near the straight way of one to a pose."""
    mine, reach_m = places[name][:2], outlines[name].reach_m + _NEAR_M + _BESIDE_M
    along = end[:2] - mine
    length_m = max(hypot(*along.tolist()), _NEAR_M)
    for other, place in places.items():
        share = float((place[:2] - mine) @ along) / length_m**2
        nearest = mine + min(max(share, 0.0), 1.0) * along
        off_m = hypot(*(place[:2] - nearest).tolist())
        if other != name and off_m < reach_m + outlines[other].reach_m:
            return False
    return True
