"""In which condition the cells of a bank are, and what time each takes it to be."""

from collections.abc import Sequence

PPM = 1_000_000


class Conditions:
    """Cells start all well; those in `halted` do not run, and `frozen_uv` stays on their motors."""

    def __init__(self, cells: int) -> None:
        self.ticks = 0
        self.halted: dict[int, Sequence[int]] = {}
        self._started = [0] * cells
        self._drift_ppm = [0] * cells
        self._special = False

    @property
    def plain(self) -> bool:
        """Whether all cells run, and all clocks show `ticks`."""
        return not (self._special or self.halted)

    def times_ms(self) -> list[int]:
        """What each cell's clock shows: milliseconds since it started, as its crystal has them."""
        if not self._special:
            return [self.ticks] * len(self._started)
        ages = (self.ticks - started for started in self._started)
        drifts = self._drift_ppm
        return [age + age * drift // PPM for age, drift in zip(ages, drifts, strict=True)]

    def halt(self, cell: int, frozen_uv: Sequence[int]) -> None:
        """The cell runs no more; its motors are left with these voltages."""
        self.halted[cell] = frozen_uv

    def restart(self, cell: int) -> None:
        """The cell runs again, and its clock starts anew."""
        self.halted.pop(cell, None)
        self._started[cell] = self.ticks
        self._special = True

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """The cell's clock runs so much fast; what it shows may leap once, by what it missed."""
        self._drift_ppm[cell] = drift_ppm
        self._special = True
