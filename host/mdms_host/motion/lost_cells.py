"""Cells that a run does without: planners and carriers of parcels may go around them."""

from typing import Protocol, runtime_checkable


@runtime_checkable
class MindsLostCells(Protocol):
    """A program that must know which cells are lost.

    Their wheels get no reference, whatever a program commands. A parcel on them drags them along,
    against the friction of motors without power. Their sensors show nothing.
    """

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """These cells (from 1) are lost, and no others; called whenever that changes."""
        ...
