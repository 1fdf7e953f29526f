"""In which condition the cells of a bank are, and what time each takes it to be."""

from collections.abc import Sequence

PPM = 1_000_000


class Conditions:
    """Cells start all well; those in `halted` do not run, and `frozen_uv` stays on their motors.

    The simulation goes in steps of 1 ms, of which `ticks` are over. A cell makes its control
    periods by its own clock, each in the first step that is not before it.
    """

    def __init__(self, cells: int) -> None:
        self.ticks = 0
        self.halted: dict[int, Sequence[int]] = {}
        #: The step from which on a clock runs as it does now, and the periods made before that.
        self._since = [0] * cells
        self._before = [0] * cells
        self._drift_ppm = [0] * cells
        self._special = False

    @property
    def plain(self) -> bool:
        """Whether all cells run, and make in every step the period of that number."""
        return not (self._special or self.halted)

    def turns(self) -> list[dict[int, int]]:
        """Which cells make a control period in this step, and the time their clocks show then [ms].

        The first item has those that make one at least, the second those that make another, and so
        on. A clock that is slow by 100 ppm leaves out one step in 10,000; one that is as fast makes
        two periods in one.
        """
        if self.plain:
            return [dict.fromkeys(range(len(self._since)), self.ticks)]
        turns: list[dict[int, int]] = []
        for cell in range(len(self._since)):
            if cell not in self.halted:
                made = range(self._made(cell, self.ticks - 1), self._made(cell, self.ticks))
                turns += [{} for _ in range(len(made) - len(turns))]
                for turn, time_ms in zip(turns, made, strict=False):
                    turn[cell] = time_ms
        return turns

    def _made(self, cell: int, step: int) -> int:
        """How many periods the cell has made when `step` is over; the first at once."""
        elapsed = step - self._since[cell]
        if elapsed < 0:
            return 0
        return self._before[cell] + 1 + elapsed + elapsed * self._drift_ppm[cell] // PPM

    def halt(self, cell: int, frozen_uv: Sequence[int]) -> None:
        """The cell runs no more; its motors are left with these voltages."""
        self.halted[cell] = frozen_uv

    def restart(self, cell: int) -> None:
        """The cell runs again, and its clock starts anew."""
        self.halted.pop(cell, None)
        self._since[cell] = self.ticks
        self._before[cell] = 0
        self._special = True

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """The cell's clock runs so much fast from now on."""
        if self._since[cell] < self.ticks:
            last = self.ticks - 1
            self._before[cell], self._since[cell] = self._made(cell, last) - 1, last
        self._drift_ppm[cell] = drift_ppm
        self._special = True
