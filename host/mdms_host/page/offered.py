"""What a page shows and does where the host's parts offer it, and leaves out where they do not."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.estimation.tracker import Parcel
from mdms_model.arrays import Floats


class Reserved(NamedTuple):
    """A square tile that parcels pass over in this order [m; table frame]."""

    x_m: float
    y_m: float
    size_m: float
    parcels: tuple[str, ...]


@runtime_checkable
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


@runtime_checkable
class Naming(Protocol):
    """A tracker that finds what nobody has announced, and takes a name for it."""

    def name(self, unknown: str, parcel: Parcel) -> None:
        """Raises KeyError where nothing of that name is there, ValueError for one that is taken."""
        ...


def plan_of(coordinator: Coordinator | None) -> dict[str, Any]:
    """The message `plan`: ways and tiles, none where the program has none."""
    program = None if coordinator is None else coordinator.program
    if not isinstance(program, Planned):
        return {"kind": "plan", "paths": {}, "tiles": []}
    return {
        "kind": "plan",
        "paths": {name: poses.round(4).tolist() for name, poses in program.ways.items()},
        "tiles": [
            {**tile._asdict(), "parcels": list(tile.parcels)}
            for tile in program.reserved
            if tile.parcels
        ],
    }
