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

    If there are none, `closed` is whether closed cells are in the way, and `passing` whether
    parcels that are under way are. If neither is, its start or goal cannot be left or reached on
    this table at all.
    """

    parcel: str
    start: Floats
    goal: Floats | None
    by: tuple[Blocker, ...] = ()
    closed: bool = False
    passing: bool = False

    @property
    def may_pass(self) -> bool:
        """Whether the obstacle may go away."""
        return bool(self.by) or self.closed or self.passing

    @property
    def way(self) -> str:
        """Which way there is none of, in words."""
        goal = "" if self.goal is None else f" to its goal {place(self.goal)}"
        return f"parcel {self.parcel!r} has no way from {place(self.start)}{goal}"

    def __str__(self) -> str:
        way = self.way
        if self.by:
            names = " and ".join(map(str, self.by))
            return f"{way}: blocked by {names}; clear the way, or give another goal"
        if self.closed:
            return f"{way}: blocked by closed cells; give a goal that is reached around them"
        if self.passing:
            return f"{way}: parcels that are under way are before it"
        return (
            f"{way}: on this table it would hang over the edge or tip, at its start, at its goal "
            "or between; give a goal farther from the edge"
        )


def place(pose: Floats) -> str:
    """A pose as a person reads it."""
    return f"({pose[0]:.3f} m, {pose[1]:.3f} m, {degrees(pose[2]):.0f} degrees)"


def blockers(
    places: Sequence[tuple[Blocker, Ints]], closed: Bools, free: Callable[[Bools], bool]
) -> tuple[tuple[Blocker, ...], bool, bool]:
    """The bars of a way: places, none of them in vain, or closed tiles, or nothing for good.

    The result is the places, whether closed tiles bar the way, and whether nothing does for good.
    `free` returns whether there is a way past these tiles.
    """
    if not free(closed):
        return (), bool(closed.any()) and free(closed & False), False
    blocked, by = closed.copy(), []
    for blocker, tiles in places:
        more = blocked.copy()
        more[tiles] = True
        if free(more):
            blocked = more
        else:
            by.append(blocker)
    return tuple(by), False, not by
