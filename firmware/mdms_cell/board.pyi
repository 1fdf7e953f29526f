"""The interface of a board, for type checkers.

DESIGN.md, 'Cell and board', lists the optional parts too.
"""

from collections.abc import MutableSequence
from typing import Protocol

class Board(Protocol):
    """The hardware of a cell, passed in."""

    @property
    def registers(self) -> MutableSequence[int]:
        """The memory of the speed loop: `speed_loop.REGISTERS` 32-bit integers."""
        ...

    def sample(self, registers) -> None:
        """Write supply [uV], encoder counts and motor currents [mA] into the registers."""
        ...

    def drive(self, registers) -> None:
        """Apply the voltages [uV], and keep the bridges awake while AWAKE is 1."""
        ...

    def presence(self) -> int:
        """The five presence bits; bit 0 is the centre sensor."""
        ...

    def place(self) -> int:
        """The node id that belongs here, as the table's connector says; 0 without jumpers."""
        ...

    def send(self, can_id: int, data) -> bool:
        """Queue a frame; False when there is no room."""
        ...

    def motors_off(self) -> None:
        """0 V at once, whatever state the program is in; awake bridges stay so and brake."""
        ...
