"""What a fault does over time, and to which cells."""

from collections.abc import Callable, Sequence
from random import Random
from typing import NamedTuple

from mdms_model.scenario.fault import Fault


class Course(NamedTuple):
    """What is done when a fault begins and when it ends; each may return a word on it."""

    begin: Callable[[], str | None]
    end: Callable[[], str | None]


#: Sets up one fault of a kind; what it draws is drawn from the sequence given.
Kind = Callable[[Fault, Random], Course]


def cells_with(fault: Fault, cells: int) -> Sequence[int]:
    """The cells that have it, from 0, of so many."""
    return [cell - 1 for cell in fault.cells] or range(cells)
