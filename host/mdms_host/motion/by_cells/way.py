"""Where cells are to take a parcel: to a goal, and leg by leg beyond it while the host is gone."""

from dataclasses import dataclass, replace

from mdms_host.motion.by_cells.pages import goal_page
from mdms_host.motion.goal import Goal
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import Page


@dataclass(frozen=True, slots=True)
class Way:
    """A goal, and the ends of the legs that follow it, in this order.

    `joins` is whether it is the rest of the way that the cells have already. Then they keep their
    pages of it; otherwise these count no more.
    """

    places: tuple[Goal, ...]
    joins: bool = False

    @property
    def goal(self) -> Goal:
        """Where the parcel goes now."""
        return self.places[0]

    @property
    def legs(self) -> int:
        """How many legs follow."""
        return len(self.places) - 1

    def after(self, before: "Way | None") -> "Way":
        """The same way, as the cells get it that have the way `before`."""
        if before is None or not before.legs or not self.legs:
            return self
        next_leg = _numbers(self.goal) == _numbers(before.places[1])
        theirs = before.places[2:] if next_leg else before.places[1:]
        joins = all(
            _numbers(mine) == _numbers(its)
            for mine, its in zip(self.places[1:], theirs, strict=False)
        )
        return replace(self, joins=joins)

    def rest(self) -> "Way":
        """The way once the goal is reached; there have to be legs."""
        return Way(self.places[1:], joins=True)

    def page(self, identity: int, sequence: int, leg: int = 0) -> Page:
        """The page of the goal, or of the leg so many after it."""
        number = leg or (wire.JOINS if self.joins else 0)
        return goal_page(identity, sequence, self.places[leg], number, self.legs)


def _numbers(goal: Goal) -> Page:
    """The numbers that cells get of a place."""
    return goal_page(1, 1, goal)
