"""A program whose parcels are steered by the cells: pages out, estimates in."""

from collections.abc import Collection, Mapping
from typing import Protocol, runtime_checkable

from mdms_host.estimation.belief import Belief
from mdms_host.motion.goal import Goal
from mdms_host.motion.program import Steered
from mdms_protocol.neighbours.messages import Estimate, Page


@runtime_checkable
class ByCells(Protocol):
    """What a run needs of such a program; see `motion.program.Program` for the rest."""

    def on_estimate(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell (from 1) has sent its estimate."""
        ...

    def step(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> list[Page]:
        """The pages to send now, given what is believed; once a cycle."""
        ...

    def begin_again(self) -> None:
        """Send every parcel's program anew, from where the parcel is; it was at rest meanwhile."""
        ...

    def ends(self) -> list[Page]:
        """The pages that end all programs."""
        ...

    def take_notices(self) -> list[str]:
        """What has happened to parcels since the last call."""
        ...

    @property
    def stuck(self) -> str | None:
        """Why no parcel is steered any more though some have not arrived; None while one is."""
        ...

    @property
    def finished(self) -> bool:
        """Whether what the program is for has been reached."""
        ...

    @property
    def endless(self) -> bool:
        """Whether the program has no end of its own."""
        ...

    @property
    def near(self) -> Collection[str]:
        """Parcels about to arrive, of which it matters how well their places are known."""
        ...

    @property
    def controllers(self) -> Mapping[str, Steered]:
        """What steers each parcel that has a goal, by the parcel's name."""
        ...

    def set_goal(self, name: str, goal: Goal) -> None:
        """Have a parcel steered to this goal from now on. Raises KeyError for no parcel of it."""
        ...
