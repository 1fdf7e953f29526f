"""The way back of one cell that is out of action, through the phases of a bring-up of its own."""

from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.phase import TRANSITIONS, Phase, Signal
from mdms_protocol.emergencies import LOW_SUPPLY, code_text

#: A cell that gets on no further for so long begins anew [s].
_STEP_LIMIT_S = 1.0


class Comeback:
    """Takes one cell from its next heartbeat to enabled drives, while others may run.

    Settings are written and verified as when it came up first, and every target begins at 0. `text`
    is why the cell is out, `refused` why it is not taken back, None as long as it may be. It is
    asked again only when it has restarted; `has_restarted` is whether it has since it is out, and
    `had_no_supply` whether its motors have lost their supply.
    """

    def __init__(self, cell: BringUpCell, text: str, now_s: float) -> None:
        self.cell = cell
        self.text = text
        self.since_s = now_s
        self.phase = Phase.WAITING
        self.refused: str | None = None
        self.has_restarted = cell.restarted
        self.had_no_supply = cell.lacks_supply
        self._step_s = now_s
        cell.begin_again()

    @property
    def heard(self) -> bool:
        """Whether the cell has reported since it is out, and not fallen silent again."""
        return self.phase is not Phase.WAITING

    @property
    def back(self) -> bool:
        """Whether the cell is up again."""
        return self.phase is Phase.RUNNING

    def step(self, now_s: float, silent: bool) -> None:
        """Look how far the cell is by now."""
        self.has_restarted |= self.cell.restarted
        self.had_no_supply |= self.cell.lacks_supply
        if self.refused is not None:
            if self.cell.restarted or silent:
                self._begin_again(now_s)
            return
        if self._is_stuck(now_s, silent):
            self._begin_again(now_s)
        if self.heard and self.cell.lacks_supply:
            self._refuse(code_text(LOW_SUPPLY))
        while self.refused is None and not self.back and self.cell.has_reached(self.phase):
            self._advance(now_s)

    def _advance(self, now_s: float) -> None:
        """Take the cell into its next phase, unless it is not to be taken."""
        cell, reached = self.cell, self.phase
        self.phase, self._step_s = TRANSITIONS[reached, Signal.DONE], now_s
        if reached is Phase.WAITING:
            cell.restarted = False
        reason = {Phase.IDENTIFYING: cell.refusal, Phase.CONFIGURING: cell.mismatch}.get(reached)
        if reason is not None:
            self._refuse(reason)

    def _refuse(self, reason: str) -> None:
        self.refused = f"{self.cell.name} is not taken back: {reason}"
        self.phase = Phase.WAITING

    def _is_stuck(self, now_s: float, silent: bool) -> bool:
        """Whether the cell has fallen silent or restarted on its way, or takes too long."""
        fallen = silent or self.cell.restarted or self.cell.fault(self.phase) is not None
        return (self.heard and fallen) or now_s >= self._step_s + _STEP_LIMIT_S

    def _begin_again(self, now_s: float) -> None:
        self.phase, self._step_s, self.refused = Phase.WAITING, now_s, None
        self.cell.begin_again()
