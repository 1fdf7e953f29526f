"""Why a parcel has no route, in words that say what to do."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import degrees

from mdms_model.arrays import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Blocker:
    """A parcel that is in the way, at its place or at its goal."""

    parcel: str
    at: str
    pose: Floats

    def __str__(self) -> str:
        return f"{self.parcel!r} at its {self.at} {place(self.pose)}"


@dataclass(frozen=True, eq=False)
class Blocked:
    """A parcel without a route. `by` are the fewest parcels, without which it would have one.

    Where there are none, `closed` is whether closed cells are what is in the way; else its start or
    goal cannot be left or come to on this table at all.
    """

    parcel: str
    start: Floats
    goal: Floats | None
    by: tuple[Blocker, ...] = ()
    closed: bool = False

    def __str__(self) -> str:
        goal = "" if self.goal is None else f" to its goal {place(self.goal)}"
        way = f"parcel {self.parcel!r} has no way from {place(self.start)}{goal}"
        if self.by:
            names = " and ".join(map(str, self.by))
            return f"{way}: blocked by {names}; move what stands there, or give another goal"
        if self.closed:
            return f"{way}: blocked by closed cells; give a goal that is reached around them"
        return (
            f"{way}: on this table it would hang over the edge or tip, at its start, at its goal "
            "or between; give a goal farther from the edge"
        )


def place(pose: Floats) -> str:
    """A pose as a person reads it."""
    return f"({pose[0]:.3f} m, {pose[1]:.3f} m, {degrees(pose[2]):.0f} degrees)"


def blockers(
    places: Sequence[tuple[Blocker, Ints]], closed: Bools, free: Callable[[Bools], bool]
) -> tuple[tuple[Blocker, ...], bool]:
    """Which of these places have to be free for a way, none of them in vain; whether tiles must.

    `free` is whether there is a way past these tiles.
    """
    if not free(closed):
        return (), bool(closed.any()) and free(closed & False)
    blocked, by = closed.copy(), []
    for blocker, tiles in places:
        more = blocked.copy()
        more[tiles] = True
        if free(more):
            blocked = more
        else:
            by.append(blocker)
    return tuple(by), False
