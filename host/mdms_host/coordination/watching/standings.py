"""Parcels that are found, and those that sensors do not show any more."""

from collections.abc import Iterable, Iterator, Mapping

from mdms_host.estimation.confirmation import Standing
from mdms_model.arrays import Floats


class Standings:
    """What becomes of the beliefs of a run; `troubles` are what a person should look after."""

    def __init__(self) -> None:
        self._lost_s: dict[str, float] = {}

    @property
    def lost(self) -> str | None:
        """Which parcels are lost now, and since when; None without one. Who never was is not."""
        lost = ", ".join(f"{name} since {time_s:.2f} s" for name, time_s in self._lost_s.items())
        return f"lost: {lost}; no sensor shows it" if lost else None

    def step(
        self, time_s: float, changes: Iterable[tuple[str, Standing]], poses: Mapping[str, Floats]
    ) -> Iterator[tuple[str, bool]]:
        """What changes of the standings are to a person, each with whether it is a trouble."""
        for name, standing in changes:
            if standing is Standing.LOST:
                self._lost_s[name] = time_s
                yield f"{name} is lost: no sensor shows it where it was; it is not steered", True
            elif standing is Standing.DOUBTFUL:
                yield f"{name} is doubtful: sensors do not show it where it was", False
            else:
                self._lost_s.pop(name, None)
                x_m, y_m, yaw_rad = poses[name].tolist()
                where = f"x = {x_m:.3f} m, y = {y_m:.3f} m, yaw = {yaw_rad:.2f} rad"
                yield f"{name} found at {where}", False
