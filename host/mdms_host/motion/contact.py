"""Room between parcels, by their believed outlines."""

from collections.abc import Mapping
from math import hypot

from mdms_host.estimation.footprint import Footprint
from mdms_model import outline
from mdms_model.arrays import Floats

#: Room that a parcel needs around it to turn on the spot [m].
_NEAR_M = 0.015


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
