"""The phases of a run: what all cells have to reach before the next begins, and what ends a run."""

from collections.abc import Callable

from mdms_host.coordination.bring_up import REFUSED_S, BringUpCell
from mdms_host.coordination.frames import FrameRouter
from mdms_host.coordination.recovery import ArrayState, Recovery
from mdms_host.coordination.run_state import BRING_UP, STOPPED, TRANSITIONS, UP, Phase, RunSignal
from mdms_host.coordination.supervision import COMMANDED, OTHER_HOST, SWITCHED_OFF, names

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
        if self._failure is not None:
            self._fail(self._failure, now_s)
        elif self._frame_router.other_host:
            self._fail(OTHER_HOST, now_s)
        elif self._frame_router.switched_off:
            self._fail(SWITCHED_OFF, now_s)
        elif cell := self._frame_router.commanded:
            self._fail(f"{COMMANDED}: {cell.name}", now_s)
        elif self._stop_requested and (self.phase, RunSignal.STOP) in TRANSITIONS:
            self._signal(RunSignal.STOP, now_s)
        elif self.phase in UP:
            self._look_after_cells(now_s)
        elif fault := self._supervision.fault(self.phase, self._roster.taking_part, now_s):
            silent = self.phase in BRING_UP and self._supervision.silent(fault.cell, now_s)
            if not (silent and self._recovery.do_without([fault.cell], fault.text, now_s)):
                self._fail(fault.text, now_s)
        elif low := self._without_supply(now_s):
            text = self._supervision.low_supply_text(low)
            if not self._recovery.do_without(low, text, now_s):
                self._fail(text, now_s)
        elif self._roster.out:
            self._recovery.bring_back(now_s)

    def _without_supply(self, now_s: float) -> list[BringUpCell]:
        """The cells that come up without a supply of their motors, in time before any may drive."""
        if self.phase not in BRING_UP:
            return []
        return self._supervision.without_supply(self._roster.taking_part, now_s)

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
            self._journal.note(now_s, f"not confirmed to be off: {names(late)}")
            self._signal(RunSignal.DONE, now_s)

    def _conclude(self, now_s: float) -> None:
        """End a phase that all cells have reached, if none of them is other than it should be."""
        misfits = self._supervision.misfits_text(self.phase, self._roster.taking_part)
        if misfits:
            self._fail(misfits, now_s)
        else:
            self._signal(RunSignal.DONE, now_s)

    def _late(self, now_s: float) -> list[BringUpCell]:
        """The cells that the phase waits for; when stopping, none that is silent."""
        late = [cell for cell in self._roster.taking_part if not cell.has_reached(self.phase)]
        if self.phase in BRING_UP:
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
