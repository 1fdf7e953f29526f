"""The order of one parcel, and its progress."""

from dataclasses import dataclass

from mdms_host.motion.goal import GoalPose


@dataclass(frozen=True, slots=True)
class Gate:
    """A stretch of one edge of the table over which parcels leave [table frame].

    `outward` is the axis, 0 for x and 1 for y, and the sign of the way out. `last_m` is the place
    of the last support in that direction. `from_m` to `to_m` is the stretch along the other axis.
    """

    name: str
    outward: tuple[int, int]
    last_m: float
    from_m: float
    to_m: float
    kinds: tuple[str, ...] = ()

    @property
    def middle_m(self) -> float:
        """The middle of the stretch, along the edge [m]."""
        return (self.from_m + self.to_m) / 2

    def out_m(self, x_m: float, y_m: float) -> float:
        """How far a place is beyond the last support [m]; negative before it."""
        axis, sign = self.outward
        return sign * (x_m, y_m)[axis] - self.last_m

    def place_m(self, out_m: float, along_m: float | None = None) -> tuple[float, float]:
        """The place so far beyond the last support, in the middle or elsewhere along the edge."""
        axis, sign = self.outward
        across_m = sign * (self.last_m + out_m)
        along_m = self.middle_m if along_m is None else along_m
        return (across_m, along_m) if axis == 0 else (along_m, across_m)


class Order:
    """A parcel is to be at a goal, or to leave through a gate; `done` once it is, or has.

    `refused` is why it never will be: there is no way, or the parcel is lost or stands. An order
    that is `replaced` by another order for the parcel counts as done, because the other one is in
    force. An order that is `kept` stays in force: a parcel that has been moved away from its goal
    is brought back, however long it was lost. `moves` is how often the parcel has been moved at its
    goal to have its place made sure.
    """

    def __init__(self, parcel: str, goal: GoalPose | Gate, *, kept: bool = False) -> None:
        self.parcel = parcel
        self.goal = goal
        self.kept = kept
        self.done = False
        self.replaced = False
        self.refused: str | None = None
        self.moves = 0

    @property
    def over(self) -> bool:
        """Whether nothing more comes of it."""
        done = self.done and not self.kept
        return done or self.replaced or self.refused is not None
