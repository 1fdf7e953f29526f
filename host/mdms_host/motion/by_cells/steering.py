"""A program whose parcels are steered by the cells: pages out, estimates in."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from mdms_host.estimation.belief import Belief
from mdms_host.motion.program import AnyProgram
from mdms_protocol.neighbours.messages import Estimate, Page


@runtime_checkable
class ByCells(AnyProgram, Protocol):
    """Has pages for the cells, step by step."""

    def on_estimate(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell (from 1) has sent its estimate."""
        ...

    def step(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> list[Page]:
        """The pages to send now, given the beliefs; once a cycle."""
        ...

    def begin_again(self) -> None:
        """Send every parcel's program anew, from where the parcel is; it was at rest meanwhile."""
        ...

    def ends(self) -> list[Page]:
        """The pages that end all programs."""
        ...
