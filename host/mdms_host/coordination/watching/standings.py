"""Parcels that are found, and those that sensors do not show any more."""

from collections.abc import Iterable, Iterator, Mapping

from mdms_host.estimation.change import Change, Event
from mdms_model.arrays import Floats

_TEXTS = {
    Event.FOUND: "{name} found at {where}",
    Event.DOUBTFUL: "{name} is doubtful: sensors do not show it where it was",
    Event.LOST: "{name} is lost: no sensor shows it where it was; it is not steered",
    Event.DEPARTED: "{name} has departed",
    Event.APPEARED: "{name} appeared at {where}, {size}: wheels under it stand",
    Event.HEAPED: (
        "{name} is a heap at {where}, {size}: more than one parcel, which cannot be told apart; "
        "wheels under it stand"
    ),
    Event.CLEARED: "{name} is not there any more",
    Event.EXPLAINED: "{name} is {other}",
    Event.WITHDRAWN: "{name} has not come: something else was taken for it",
    Event.MISFIT: "{name} is not {other}: sensors contradict its outline",
}
_TROUBLES = (Event.LOST, Event.MISFIT)


class Standings:
    """Changes of the beliefs of a run; `troubles` are the changes that need a person."""

    def __init__(self) -> None:
        self._lost_s: dict[str, float] = {}

    @property
    def lost(self) -> str | None:
        """The parcels that are lost now, and since when; None without one.

        Parcels that were never found are not listed.
        """
        lost = ", ".join(f"{name} since {time_s:.2f} s" for name, time_s in self._lost_s.items())
        return f"lost: {lost}; no sensor shows it" if lost else None

    def step(
        self, time_s: float, changes: Iterable[Change], poses: Mapping[str, Floats]
    ) -> Iterator[tuple[str, bool]]:
        """Texts about changes of the standings, each with whether it is a trouble."""
        for change in changes:
            name = change.name
            if change.event is Event.LOST:
                self._lost_s[name] = time_s
            elif change.event in (Event.FOUND, Event.DEPARTED, Event.WITHDRAWN):
                self._lost_s.pop(name, None)
            pose = poses.get(name, change.pose)
            where = "" if pose is None else _where(pose)
            yield (
                _TEXTS[change.event].format(
                    name=name, where=where, size=_size(change), other=change.other
                ),
                change.event in _TROUBLES,
            )


def _where(pose: Floats) -> str:
    x_m, y_m, yaw_rad = pose.tolist()
    return f"x = {x_m:.3f} m, y = {y_m:.3f} m, yaw = {yaw_rad:.2f} rad"


def _size(change: Change) -> str:
    if change.size_m is None:
        return ""
    along_m, across_m = change.size_m
    return f"{along_m:.2f} m x {across_m:.2f} m at most"
