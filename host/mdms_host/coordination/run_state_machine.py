"""The phases of a run: what all cells have to reach before the next begins, and what ends a run."""

from collections.abc import Callable, Sequence

from mdms_host.coordination.bring_up import REFUSED_S, BringUpCell
from mdms_host.coordination.frames import FrameRouter
from mdms_host.coordination.recovery import ArrayState, Recovery
from mdms_host.coordination.run_state import BRING_UP, STOPPED, TRANSITIONS, UP, Phase, RunSignal
from mdms_host.coordination.supervision import COMMANDED, OTHER_HOST, SWITCHED_OFF

_OVER = (Phase.FAILING, *STOPPED)


class RunStateMachine:
    """`phase` is the phase of a run, `fault` the cause of its end, None as long as it goes on.

    While it `keeps`, all parcels stand as soon as the cells run, also when lost cells come back.
    `on_phase(before, phase, now_s)` is called when a phase begins.
    """

    def __init__(
        self,
        array: ArrayState,
        recovery: Recovery,
        frame_router: FrameRouter,
        *,
        on_phase: Callable[[Phase, Phase, float], None],
    ) -> None:
        self.phase = Phase.WAITING
        self.fault: str | None = None
        self._roster = array.roster
        self._timing = array.timing
        self._supervision = array.supervision
        self._journal = array.journal
        self._recovery = recovery
        self._frame_router = frame_router
        self._on_phase = on_phase
        self._since_s: float | None = None
        self._stop_requested = False
        self._failure: str | None = None
        self.keeps = False

    def stop(self) -> None:
        """Request an orderly end; the next step begins it."""
        self._stop_requested = True

    def fail(self, text: str) -> None:
        """Request an end with a fault from outside the bus; the next step begins it."""
        self._failure = text

    def step(self, now_s: float) -> None:
        """Look whether the phase is over."""
        if self._since_s is None:
            self._enter(Phase.WAITING, now_s)
        self._check(now_s)
        self._advance(now_s)
        # No cycle lies between: a run that comes up, or recovers, moves nothing that is to stand.
        if self.keeps and self.phase is Phase.RUNNING:
            self._signal(RunSignal.KEEP, now_s)
        elif self.phase is Phase.KEEPING and not self.keeps:
            self._signal(RunSignal.DONE, now_s)

    def _check(self, now_s: float) -> None:
        """Act on troubles of cells, on another host, or on a request to stop."""
        if self.phase in _OVER:
            return
        if fault := self._from_outside():
            self._fail(fault, now_s)
        elif self.phase is Phase.STOPPING:
            # Its end names the cells that it has not reached.
            return
        elif self._stop_requested:
            self._signal(RunSignal.STOP, now_s)
        elif self.phase in UP:
            self._look_after_cells(now_s)
        elif trouble := self._supervision.fault(self.phase, self._roster.taking_part, now_s):
            silent = self._supervision.silent(trouble.cell, now_s)
            if not (silent and self._recovery.do_without([trouble.cell], trouble.text, now_s)):
                self._fail(trouble.text, now_s)
        elif low := self._supervision.without_supply(self._roster.taking_part, now_s):
            text = self._supervision.low_supply_text(low)
            if not self._recovery.do_without(low, text, now_s):
                self._fail(text, now_s)
        elif self._roster.out:
            self._recovery.bring_back(now_s)

    def _from_outside(self) -> str | None:
        """The fault that others than the cells have caused; None without one."""
        router = self._frame_router
        if self._failure is not None or router.other_host:
            return self._failure or OTHER_HOST
        if router.switched_off:
            return SWITCHED_OFF
        return None if router.commanded is None else f"{COMMANDED}: {router.commanded.name}"

    def _look_after_cells(self, now_s: float) -> None:
        decision = self._recovery.step(self.phase, now_s)
        if decision is None:
            return
        if decision.signal is RunSignal.FAULT:
            self._fail(decision.text, now_s)
        else:
            self._signal(decision.signal, now_s)

    def _advance(self, now_s: float) -> None:
        """End the phase when all cells have reached its end, or when its time limit has passed."""
        if self.phase in (*UP, *STOPPED):
            return
        late = self._late(now_s)
        waited_s = now_s - (self._since_s or 0.0)
        # Each start is refused anew, so nothing that was misread once ends the run.
        hopeless = waited_s >= REFUSED_S and all(cell.elsewhere for cell in late)
        if not late:
            self._conclude(now_s)
        elif (self.phase is Phase.STARTING and hopeless) or (
            self.phase in BRING_UP and waited_s >= self._timing.phase_limit_s
        ):
            text = self._supervision.late_text(self.phase, late)
            if not self._recovery.do_without(late, text, now_s):
                self._fail(text, now_s)
        elif self.phase not in BRING_UP and waited_s >= self._timing.stop_limit_s:
            self._conclude(now_s)

    def _conclude(self, now_s: float) -> None:
        """End a phase that all cells have reached, if none of them is other than it should be.

        A stop ends all the same, with the cells that have not confirmed it as its fault. Of those
        that the run has gone on without it only warns.
        """
        misfits = self._supervision.misfits_text(self.phase, self._concerned)
        given_up = self._roster.given_up
        if misfits is None:
            self._signal(RunSignal.DONE, now_s)
        elif self.phase in BRING_UP:
            self._fail(misfits, now_s)
        elif any(cell.may_drive for cell in self._concerned if cell not in given_up):
            self.fault = "; ".join(filter(None, (self.fault, misfits)))
            self._journal.warn(now_s, f"fault: {misfits}")
            self._signal(RunSignal.WITHOUT, now_s)
        else:
            self._journal.warn(now_s, misfits)
            self._signal(RunSignal.DONE, now_s)

    @property
    def _concerned(self) -> Sequence[BringUpCell]:
        """The cells of a phase: its end is that of all, also of those that are out of action."""
        roster = self._roster
        return roster.taking_part if self.phase in BRING_UP else roster.cells

    def _late(self, now_s: float) -> list[BringUpCell]:
        """The cells that the phase waits for; when stopping, none that is silent."""
        late = [cell for cell in self._concerned if not cell.has_reached(self.phase)]
        waited_s = now_s - (self._since_s or 0.0)
        # After a host that was away itself, a cell tells within a heartbeat.
        if self.phase in BRING_UP or waited_s < self._timing.heartbeat_period_s:
            return late
        return [cell for cell in late if not self._supervision.silent(cell, now_s)]

    def _signal(self, signal: RunSignal, now_s: float) -> None:
        self._enter(TRANSITIONS[self.phase, signal], now_s)

    def _enter(self, phase: Phase, now_s: float) -> None:
        before, self.phase, self._since_s = self.phase, phase, now_s
        self._supervision.recheck()
        self._journal.note(now_s, phase.value)
        self._on_phase(before, phase, now_s)

    def _fail(self, text: str, now_s: float) -> None:
        self.fault = text
        self._journal.note(now_s, f"fault: {text}")
        self._signal(RunSignal.FAULT, now_s)
