"""The behaviour of parcels on a small table: stand, wish, enter, leave, by steps of one cell.

A parcel that stands covers its place. A parcel that wishes to go covers the same, and needs the
place that it would cover there. A parcel that is on its way covers both, until it has arrived or
gone back.
"""

from dataclasses import dataclass, replace
from functools import cached_property

#: (dx, dy) of the neighbours by direction; the opposite of d is d ^ 4.
STEPS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))

Cells = frozenset[int]


@dataclass(frozen=True)
class Situation:
    """Where a parcel is and where it is bound for, as sets of cells; equal where it stands."""

    place: Cells
    goal: Cells
    on_its_way: bool = False
    since: int = 0  # beats for which it has wished to go, as far as they are counted

    @property
    def covers(self) -> Cells:
        """The cells that the parcel is over."""
        return self.place | self.goal if self.on_its_way else self.place

    @property
    def needs(self) -> Cells:
        """The cells that it covers or needs next."""
        return self.place | self.goal

    def turned(self, cells: tuple[int, ...]) -> "Situation":
        """The same where each cell has become another."""
        return Situation(
            frozenset(cells[cell] for cell in self.place),
            frozenset(cells[cell] for cell in self.goal),
            self.on_its_way,
            self.since,
        )

    @property
    def waits(self) -> bool:
        """Whether it needs more than it covers."""
        return self.needs != self.covers


def _turned(turn: int, x: int, y: int) -> tuple[int, int]:
    """A vector after one of the eight symmetries of a square."""
    if turn & 4:
        x, y = y, x
    return (-x if turn & 1 else x), (-y if turn & 2 else y)


@dataclass(frozen=True)
class Grid:
    """A table of columns by rows; cells count row by row."""

    columns: int
    rows: int
    reaction_beats: int = 0  # a parcel wishes to go this long before it can be there

    @cached_property
    def neighbours(self) -> list[dict[int, int]]:
        """Of each cell, its neighbours by direction."""
        return [
            {
                direction: (y + dy) * self.columns + x + dx
                for direction, (dx, dy) in enumerate(STEPS)
                if 0 <= x + dx < self.columns and 0 <= y + dy < self.rows
            }
            for y in range(self.rows)
            for x in range(self.columns)
        ]

    @cached_property
    def symmetries(self) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """The ways to turn or mirror the table into itself: images of cells, and of directions."""
        corners = [(x, y) for y in range(self.rows) for x in range(self.columns)]
        found = []
        for turn in range(8):
            images = [self._turned(turn, x, y) for x, y in corners]
            if set(images) == set(corners):
                cells = tuple(y * self.columns + x for x, y in images)
                directions = tuple(STEPS.index(_turned(turn, *step)) for step in STEPS)
                found.append((cells, directions))
        return found

    def _turned(self, turn: int, x: int, y: int) -> tuple[int, int]:
        twice = _turned(turn, 2 * x - self.columns + 1, 2 * y - self.rows + 1)
        return (twice[0] + self.columns - 1) // 2, (twice[1] + self.rows - 1) // 2

    def places(self, length: int) -> list[Cells]:
        """Where a parcel of so many cells in a row can stand, along x or y."""
        found = set()
        for y in range(self.rows):
            for x in range(self.columns):
                for dx, dy in ((1, 0), (0, 1)):
                    cells = [(x + k * dx, y + k * dy) for k in range(length)]
                    if all(a < self.columns and b < self.rows for a, b in cells):
                        found.add(frozenset(b * self.columns + a for a, b in cells))
        return sorted(found, key=sorted)

    def shifted(self, place: Cells, direction: int) -> Cells | None:
        """A place one cell further; None beyond the edge."""
        moved = [self.neighbours[cell].get(direction) for cell in place]
        return None if None in moved else frozenset(cell for cell in moved if cell is not None)

    def goals(self, place: Cells) -> list[Cells]:
        """Where a parcel can go from its place in one step, along x or y."""
        goals = [self.shifted(place, direction) for direction in (0, 2, 4, 6)]
        return [goal for goal in goals if goal is not None]

    def next_of(self, now: Situation, may_drive: bool, noticed: bool = True) -> list[Situation]:
        """The possible situations of a parcel after a beat; first that it goes on as it is.

        It is not farther on its way before all cells that it lies over have noticed.
        """
        if now.on_its_way:
            ends = (now.goal, now.place) if may_drive else ()
            return [now, *(Situation(end, end) for end in ends)]
        since = min(now.since + 1, self.reaction_beats) if now.waits and noticed else 0
        found = [replace(now, since=since)]
        if now.waits:
            if may_drive and now.since >= self.reaction_beats:
                found.append(Situation(now.place, now.goal, on_its_way=True))
            found.append(Situation(now.place, now.place))
        else:
            found += [Situation(now.place, goal) for goal in self.goals(now.place)]
        return found
