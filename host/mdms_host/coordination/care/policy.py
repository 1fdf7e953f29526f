"""The user's policy for cells that fall out of action."""

from dataclasses import dataclass
from enum import StrEnum


class OnLostCell(StrEnum):
    """Reaction to a cell that does not come back.

    The run goes on without the cell, holds all parcels for it, or stops.
    """

    GO_ON = "go_on"
    HOLD = "hold"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class Policy:
    """How often and how long trouble may hold the array, and the reaction to lost cells.

    Where cells are out of action all parcels are held for `pause_s` at most [s], until the cells
    are back; at most `pauses` times in a minute (0: no trouble passes). With 'hold' it is `hold_s`
    instead, however often, and with 'go_on' parcels are held only where most cells are out.
    """

    on_lost_cell: OnLostCell = OnLostCell.STOP
    pauses: int = 3
    pause_s: float = 5.0
    hold_s: float = 60.0

    @property
    def limit_s(self) -> float:
        """How long the array may be held at a time [s]."""
        return self.hold_s if self.on_lost_cell is OnLostCell.HOLD else self.pause_s
