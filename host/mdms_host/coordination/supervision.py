"""Whether the cells are heard of and as far as the phase wants them, and if not, what is wrong."""

from collections.abc import Sequence
from math import inf

from mdms_host.coordination.bring_up import BringUpCell
from mdms_host.coordination.phase import Phase
from mdms_host.coordination.schedule import Timing


class Supervision:
    """Looks after the cells, all of them, whenever something may have gone wrong.

    While they run, that is when one has told something new (`look_again`), or when the heartbeat
    of one may be missing: until then nothing can be wrong that was not wrong before.
    """

    def __init__(self, cells: Sequence[BringUpCell], timing: Timing) -> None:
        self._cells = cells
        self._timing = timing
        self._sound_until_s = -inf

    def look_again(self) -> None:
        """The phase, or something that a cell tells of itself, has changed."""
        self._sound_until_s = -inf

    def wrong(self, phase: Phase, now_s: float) -> str | None:
        """What is wrong with the first cell that something is wrong with; None if all are well."""
        if now_s < self._sound_until_s:
            return None
        troubles = (self._wrong_with(cell, phase, now_s) for cell in self._cells)
        wrong = next(filter(None, troubles), None)
        if phase == Phase.RUNNING and wrong is None:
            heard_s = min(cell.heard_s or 0.0 for cell in self._cells)
            self._sound_until_s = heard_s + self._timing.silence_s
        return wrong

    def silent(self, cell: BringUpCell, now_s: float) -> bool:
        """Whether a cell that was heard once has not been heard for too long."""
        return cell.heard_s is not None and now_s - cell.heard_s > self._timing.silence_s

    def late_text(self, phase: Phase, late: list[BringUpCell]) -> str:
        """Which cells have not got on in time, and with what."""
        limit = f"within {self._timing.phase_limit_s:g} s"
        match phase:
            case Phase.WAITING if len(late) == len(self._cells):
                return f"no cell was heard {limit}; is the bus connected and are the cells powered?"
            case Phase.WAITING:
                unheard = [cell for cell in late if cell.heard_s is None]
                what = "not heard" if unheard else "not brought to rest"
                return f"{what} {limit}: {names(unheard or late)}"
            case Phase.CONFIGURING:
                return f"settings not written and verified {limit}: {names(late)}"
            case Phase.STARTING:
                return f"not operational {limit}: {names(late)}"
            case _:
                return f"drives not enabled {limit}: {names(late)} ({late[0].drive_text})"

    def _wrong_with(self, cell: BringUpCell, phase: Phase, now_s: float) -> str | None:
        if self.silent(cell, now_s):
            return f"{cell.name} has fallen silent: no heartbeat for {self._timing.silence_s:.3g} s"
        return cell.trouble(phase)


def names(cells: list[BringUpCell]) -> str:
    """How messages call these cells."""
    return ", ".join(cell.name for cell in cells)
