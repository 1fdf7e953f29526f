"""What a page shows where programs offer it, and leaves out where they do not."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeAlias, cast

from mdms_host.coordination.coordinator import Coordinator
from mdms_model.arrays import Floats

#: A square tile, its middle and side [m; table frame], and the parcels that pass over it in turn.
Reserved: TypeAlias = tuple[float, float, float, tuple[str, ...]]


class Planned(Protocol):
    """A program whose parcels have ways and tiles of their own."""

    @property
    def ways(self) -> Mapping[str, Floats]:
        """The poses (K, 3) that are still before each parcel, by its name."""
        ...

    @property
    def reserved(self) -> Sequence[Reserved]:
        """The tiles that are reserved."""
        ...


def plan_of(coordinator: Coordinator | None) -> dict[str, Any]:
    """The message `plan`, empty where the program has neither ways nor tiles."""
    program = None if coordinator is None else coordinator.program
    if not hasattr(type(program), "ways"):
        return planned({}, ())
    plans = cast(Planned, program)
    return planned(plans.ways, plans.reserved)


def planned(ways: Mapping[str, Floats], reserved: Sequence[Reserved]) -> dict[str, Any]:
    """The message `plan` of these ways and tiles."""
    return {
        "kind": "plan",
        "paths": {name: poses.round(4).tolist() for name, poses in ways.items()},
        "tiles": [
            {"x_m": x_m, "y_m": y_m, "size_m": side_m, "parcels": list(parcels)}
            for x_m, y_m, side_m, parcels in reserved
            if parcels
        ],
    }
