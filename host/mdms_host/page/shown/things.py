"""What lies on a table by name: parcels that were given, that have come, and what is unknown."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.parcel import Parcel, outline_corners_m
from mdms_host.estimation.size import Size

#: An outline that changes by less is the same for the eye [m].
_STEP_M = 0.005


@dataclass(frozen=True, slots=True)
class Thing:
    """A parcel, or what may be one: its corners in its own frame [m].

    `size` is how large something unknown is, as far as its outline shows a rectangle.
    """

    corners_m: tuple[tuple[float, float], ...]
    unknown: bool = False
    size: Size | None = field(default=None, compare=False)


def things_of(told: tuple[Parcel, ...], coordinator: Coordinator | None) -> dict[str, Thing]:
    """All that a coordinator has to do with, those first that it was told of at the start."""
    things = {parcel.name: Thing(outline_corners_m(parcel)) for parcel in told}
    if coordinator is None:
        return things
    for name, parcel in coordinator.tracker.parcels.items():
        if name not in things:
            things[name] = Thing(outline_corners_m(parcel))
    for name, unknown in coordinator.tracker.unknown.items():
        rounded = (np.array(unknown.outline.corners_m) / _STEP_M).round() * _STEP_M
        things[name] = Thing(tuple((x, y) for x, y in rounded.tolist()), unknown=True)
    return things


def sized(things: dict[str, Thing], coordinator: Coordinator | None) -> dict[str, Thing]:
    """The same, each that is unknown with its size; takes milliseconds."""
    if coordinator is None:
        return things
    return {
        name: replace(thing, size=coordinator.tracker.size(name)) if thing.unknown else thing
        for name, thing in things.items()
    }


def described(things: dict[str, Thing]) -> list[dict[str, Any]]:
    """The same as the description of a table has it."""
    return [
        {
            "name": name,
            "outline_m": [list(corner) for corner in thing.corners_m],
            "unknown": thing.unknown,
            "size": None if thing.size is None else _described_size(thing.size),
        }
        for name, thing in things.items()
    ]


def _described_size(size: Size) -> dict[str, float]:
    return {
        "length_m": round(size.length_m, 4),
        "width_m": round(size.width_m, 4),
        "spread_m": round(max(size.deviation_m) / 2, 4),
    }
