"""Cells that fall out of action: their recovery, and the reaction of the run by a policy.

The run holds the parcels, goes on without the cells, or ends.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf

import numpy as np

from mdms_host.coordination.bring_up import REFUSED_S, BringUpCell
from mdms_host.coordination.cell_setup import Identification
from mdms_host.coordination.run_state import (
    TRANSITIONS,
    TROUBLED,
    EventJournal,
    Phase,
    RunSignal,
    Timing,
)
from mdms_host.coordination.supervision import Supervision, Trouble, TroubleNature
from mdms_host.coordination.wheel_speeds import Odometry
from mdms_model.arrays import Bools
from mdms_protocol.codecs import nmt
from mdms_protocol.emergencies import IN_ANOTHERS_PLACE, LOW_SUPPLY, code_text


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


#: A cell that gets on no further for so long begins anew [s].
_STEP_LIMIT_S = 1.0


class CellRecovery:
    """Takes one cell from its next heartbeat to enabled drives, while others may run.

    Settings are written and verified as when it came up first, and every target begins at 0. `text`
    is why the cell is out, `refused` why it is not taken back, None as long as it may be. It is
    asked again only when it has restarted; `has_restarted` is whether it has since it is out, and
    `had_no_supply` whether its motors have lost their supply. `switched_off` is whether another
    program has stopped the cell while it was not heard, and `restarted_unheard` whether it has
    restarted then. `was_up` is whether the cell has come up in this run before.
    """

    def __init__(self, cell: BringUpCell, text: str, now_s: float, *, was_up: bool = True) -> None:
        self.cell = cell
        self.text = text
        self.since_s = now_s
        self.phase = Phase.WAITING
        self.refused: str | None = None
        self.has_restarted = cell.restarted
        self.had_no_supply = cell.lacks_supply
        self.switched_off = self.restarted_unheard = False
        self._found: int | None = None
        # 'Pre-operational' is no stop where the cell comes up anew.
        self._comes_up = cell.restarted or not was_up
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
        if self._found is None:
            self._found = self.cell.nmt_state
        self.has_restarted |= self.cell.restarted
        self._comes_up |= self.cell.restarted
        # Neither a silence nor the host leads there.
        self.switched_off |= self.cell.nmt_state == nmt.STOPPED and not self._comes_up
        self.had_no_supply |= self.cell.lacks_supply
        if self.refused is not None:
            if self.cell.restarted or silent:
                self._begin_again(now_s)
            return
        if self._is_stuck(now_s, silent):
            self._begin_again(now_s)
        if self.heard and self.cell.lacks_supply:
            self._refuse(code_text(LOW_SUPPLY))
        elif self._refuses(now_s):
            self._refuse(f"{code_text(IN_ANOTHERS_PLACE)}; put the boards back")
        while self.refused is None and not self.back and self.cell.has_reached(self.phase):
            self._advance(now_s)

    def _refuses(self, now_s: float) -> bool:
        """Whether the cell refuses to start: it stands in another's place."""
        waits = self.phase is Phase.STARTING and now_s >= self._step_s + REFUSED_S
        return waits and self.cell.elsewhere

    def _advance(self, now_s: float) -> None:
        """Take the cell into its next phase, unless it is not to be taken."""
        cell, reached = self.cell, self.phase
        self.phase, self._step_s = TRANSITIONS[reached, RunSignal.DONE], now_s
        if reached is Phase.WAITING:
            cell.restarted = False
        elif reached is Phase.IDENTIFYING:
            self._judge(cell.identification)
        refusal, mismatch = cell.identification.refusal, cell.mismatch
        reason = {Phase.IDENTIFYING: refusal, Phase.CONFIGURING: mismatch}.get(reached)
        if reason is not None:
            self._refuse(reason)

    def _judge(self, found: Identification) -> None:
        """Tell a stop from the host's silence, and from a restart, that were not heard."""
        left = self._found == nmt.PRE_OPERATIONAL
        if self._comes_up:
            return
        if left and found.has_lost_settings:
            self._comes_up = self.has_restarted = self.restarted_unheard = True
        else:
            # The host's silence leads there only where cells steer, and leaves a fault.
            silence = self.cell.steers and found.shut_off
            self.switched_off |= found.stopped or (left and not silence)

    def _refuse(self, reason: str) -> None:
        self.refused = f"{self.cell.name} is not taken back: {reason}"
        self.phase = Phase.WAITING

    def _is_stuck(self, now_s: float, silent: bool) -> bool:
        """Whether the cell has fallen silent or restarted on its way, or takes too long."""
        fallen = silent or self.cell.restarted or self.cell.fault(self.phase) is not None
        return (self.heard and fallen) or now_s >= self._step_s + _STEP_LIMIT_S

    def _begin_again(self, now_s: float) -> None:
        if self.phase in (Phase.ENABLING, Phase.RUNNING):
            # It was operational again.
            self._found, self._comes_up = None, self.cell.restarted
        self.phase, self._step_s, self.refused = Phase.WAITING, now_s, None
        self.cell.begin_again()


class Roster:
    """The cells of `axes` wheels each; a cell is `taking_part`, or `out` with its way back.

    `wheels_out` are the wheels of cells that are out, shape (W,). No reference moves them, and
    their reports show nothing of a parcel. The run does not wait for the cells in `given_up`.
    """

    def __init__(self, cells: Sequence[BringUpCell], axes: int) -> None:
        self.cells = cells
        self.taking_part: tuple[BringUpCell, ...] = tuple(cells)
        self.out: dict[BringUpCell, CellRecovery] = {}
        self.given_up: set[BringUpCell] = set()
        self.wheels_out: Bools = np.zeros(axes * len(cells), dtype=bool)
        self._axes = axes

    @property
    def awaited(self) -> list[CellRecovery]:
        """The ways back of the cells that the run waits for."""
        return [way for cell, way in self.out.items() if cell not in self.given_up]

    def lose(self, cell: BringUpCell, text: str, now_s: float, *, was_up: bool = True) -> None:
        """A cell is out of action, for a reason in words; its way back begins."""
        self.out[cell] = CellRecovery(cell, text, now_s, was_up=was_up)
        # Its last report is of a wheel that ran.
        cell.speeds_data = None
        self._sort()

    def give_up(self, cells: Iterable[BringUpCell]) -> None:
        """Wait no more for these cells; they may come back all the same."""
        self.given_up.update(cells)

    def await_since(self, since_s: float) -> None:
        """Wait again for cells that have been out since then only, and are not refused."""
        late = (
            cell for cell, way in self.out.items() if way.since_s >= since_s and not way.refused
        )
        self.given_up.difference_update(list(late))

    def step(
        self,
        now_s: float,
        silent: Callable[[BringUpCell], bool],
        ready: Callable[[BringUpCell], bool],
    ) -> list[BringUpCell]:
        """Take the cells that are out further; those that are back, and `ready`, take part again.

        `silent` is whether a cell has fallen silent.
        """
        for cell, way in self.out.items():
            way.step(now_s, silent(cell))
        back = [cell for cell, way in self.out.items() if way.back and ready(cell)]
        for cell in back:
            del self.out[cell]
            self.given_up.discard(cell)
        if back:
            self._sort()
        return back

    def _sort(self) -> None:
        self.taking_part = tuple(cell for cell in self.cells if cell not in self.out)
        self.wheels_out = np.repeat([cell in self.out for cell in self.cells], self._axes)


@dataclass(frozen=True, slots=True)
class ArrayState:
    """The array of a run, as its parts share it: the cells, their troubles and their speeds."""

    timing: Timing
    journal: EventJournal
    roster: Roster
    supervision: Supervision
    odometry: Odometry


#: Pauses are counted over so long [s].
_COUNTED_S = 60.0
#: Parcels lie still for so long, with all cells back, before they are moved again [s].
_SETTLED_S = 0.2
#: Signals after which parcels that have waited for cells are held no more.
_ENDS_HOLD = (RunSignal.FAULT, RunSignal.WITHOUT)
#: How many cells a message says it of.
_LISTED = 3


@dataclass(frozen=True, slots=True)
class Decision:
    """The next step of the run, and the reason in words."""

    signal: RunSignal
    text: str = ""


class Recovery:
    """Follows cells that are out of action until they are back, and decides by a policy.

    `pauses` is how often all parcels have been held. `on_lost` gets the numbers of the cells that
    the run does without, whenever they change, and `on_back` is called when all cells are back.
    `unsure()` returns whether a parcel is doubtful.
    """

    def __init__(
        self,
        array: ArrayState,
        policy: Policy,
        *,
        on_lost: Callable[[frozenset[int]], None],
        on_back: Callable[[], None],
        unsure: Callable[[], bool],
    ) -> None:
        self.pauses = 0
        self._roster = array.roster
        self._policy = policy
        self._supervision = array.supervision
        self._odometry = array.odometry
        self._journal = array.journal
        self._on_lost = on_lost
        self._on_back = on_back
        self._unsure = unsure
        self._lost: frozenset[int] = frozenset()
        self._begun_s: deque[float] = deque()
        self._since_s = 0.0
        self._stepped_s = inf
        self._settled_s: float | None = None

    @property
    def lost(self) -> dict[int, str]:
        """The cells that the run does without, by number, and why."""
        ways = ((cell, self._roster.out[cell]) for cell in self._roster.given_up)
        return {cell.number: way.refused or way.text for cell, way in ways}

    def step(self, phase: Phase, now_s: float) -> Decision | None:
        """The decision of the run now; None to go on."""
        if asleep := self._asleep(now_s):
            return Decision(RunSignal.FAULT, asleep)
        troubles = self._troubles(now_s)
        for trouble in troubles:
            self._roster.lose(trouble.cell, trouble.text, now_s)
        self.bring_back(now_s)
        if any(each.nature is TroubleNature.DELIBERATE for each in troubles):
            return Decision(RunSignal.FAULT, _told(each.text for each in troubles))
        ways = self._roster.out.values()
        if stopped := [way for way in ways if way.switched_off]:
            texts = (f"{way.text}; it was stopped meanwhile" for way in stopped)
            return Decision(RunSignal.FAULT, _told(texts))
        unheard, cells = sum(way.restarted_unheard for way in ways), len(self._roster.cells)
        if 1 < unheard <= cells // 2:
            # One boot-up message may get lost. Several are a supply, or a reset, of a part.
            cut = "their supply was cut, or they were reset; start again"
            return Decision(RunSignal.FAULT, f"{unheard} cells have restarted unheard: {cut}")
        decision = None
        if phase in TROUBLED:
            decision = self._while_held(phase, now_s)
            if troubles and (decision is None or decision.signal not in _ENDS_HOLD):
                more = _told(each.text for each in troubles)
                self._journal.warn(now_s, f"parcels stay held: {more}")
        elif troubles:
            decision = self._on_troubles(troubles, now_s)
        self._report_lost()
        return decision

    def _asleep(self, now_s: float) -> str | None:
        """A message if the host itself was away for longer than a pause may last."""
        away_s, self._stepped_s = now_s - self._stepped_s, now_s
        if away_s <= self._policy.limit_s:
            return None
        return f"this host was held up for {away_s:.1f} s, longer than a pause may last"

    def bring_back(self, now_s: float) -> None:
        """Take the cells that are out further on their way back."""
        if not self._roster.out:
            return  # as nearly always
        silent = self._supervision.silent
        back = self._roster.step(now_s, lambda cell: silent(cell, now_s), self._odometry.answers)
        for cell in back:
            self._supervision.recheck()
            self._journal.note(now_s, f"{cell.name} is back")
        self._report_lost()

    def do_without(self, late: Sequence[BringUpCell], text: str, now_s: float) -> bool:
        """Whether the run goes on without cells that have not come up in time."""
        if not self._may_lose(len(self._roster.out) + len(late)):
            return False
        for cell in late:
            self._roster.lose(cell, text, now_s, was_up=False)
        self._go_without(late, text, now_s)
        self._report_lost()
        return True

    def _troubles(self, now_s: float) -> list[Trouble]:
        """Troubles of cells that take part, one for each cell."""
        taking_part = self._roster.taking_part
        found = {each.cell: each for each in self._supervision.troubles(taking_part, now_s)}
        limit_s, late = self._odometry.late()
        for cell in taking_part if late else ():
            if cell in late and cell not in found:
                text = f"{cell.name} has fallen silent: no speeds for {limit_s:.3g} s"
                found[cell] = Trouble(cell, text)
        return list(found.values())

    # While parcels move

    def _on_troubles(self, troubles: list[Trouble], now_s: float) -> Decision | None:
        text = _told(each.text for each in troubles)
        if self._may_lose(len(self._roster.out)):
            self._go_without([each.cell for each in troubles], text, now_s)
            return None
        if all(each.nature is TroubleNature.LASTING for each in troubles) and not self._waits:
            return Decision(RunSignal.FAULT, text)
        return self._hold(text, now_s)

    def _hold(self, text: str, now_s: float) -> Decision:
        while self._begun_s and now_s - self._begun_s[0] > _COUNTED_S:
            self._begun_s.popleft()
        if len(self._begun_s) >= self._policy.pauses and not self._waits:
            held = f"; held {len(self._begun_s)} times in a minute before"
            return Decision(RunSignal.FAULT, text + (held if self._begun_s else ""))
        self._begun_s.append(now_s)
        self.pauses += 1
        self._since_s, self._settled_s = now_s, None
        # Those that fell out just before may have the same reason, and come back as soon.
        self._roster.await_since(now_s - self._policy.pause_s)
        self._journal.warn(now_s, f"all parcels are held: {text}")
        return Decision(RunSignal.TROUBLE)

    @property
    def _waits(self) -> bool:
        """Whether all parcels are held for a cell however often, and however it fell out."""
        return self._policy.on_lost_cell is OnLostCell.HOLD

    def _may_lose(self, cells: int) -> bool:
        """Whether the run goes on without so many cells; without most it is the bus that fails."""
        goes_on = self._policy.on_lost_cell is OnLostCell.GO_ON
        return goes_on and 2 * cells <= len(self._roster.cells)

    def _go_without(self, cells: Sequence[BringUpCell], text: str, now_s: float) -> None:
        self._roster.give_up(cells)
        them = "it" if len(cells) == 1 else "them"
        self._journal.warn(now_s, f"{text}; the run goes on without {them}")

    # While they are held

    def _while_held(self, phase: Phase, now_s: float) -> Decision | None:
        if refusal := self._power_cut() or self._refusal(now_s):
            return Decision(RunSignal.FAULT, refusal)
        awaited = self._roster.awaited
        held_s = now_s - self._since_s
        if awaited and held_s >= self._policy.limit_s:
            return self._overdue(awaited, now_s)
        heard = all(way.heard for way in awaited)
        if heard is not (phase is Phase.RECOVERING):
            return Decision(RunSignal.DONE if heard else RunSignal.TROUBLE)
        return self._settle(held_s, now_s) if heard else None

    def _power_cut(self) -> str | None:
        """Why a run ends if most cells have lost their supply, or that of their motors.

        That may have been an emergency stop, and letting go of it is to move nothing: a cell that
        measures a supply where there is none is disabled, too.
        """
        ways, cells = self._roster.out.values(), len(self._roster.cells)
        restarted = sum(way.has_restarted for way in ways)
        cut = sum(way.had_no_supply for way in ways)
        if 2 * restarted > cells:
            return f"{restarted} of {cells} cells have restarted: their supply was cut; start again"
        if 2 * cut > cells:
            return (
                f"{cut} of {cells} cells have lost the supply of their motors "
                f"(0x{LOW_SUPPLY:04X}): release the emergency stop, or mend the supply, then "
                "start again"
            )
        return None

    def _refusal(self, now_s: float) -> str | None:
        """Why a run ends whose cells are refused; where it need not, it waits for them no more."""
        refused = [way for way in self._roster.awaited if way.refused is not None]
        if not refused or self._waits:
            return None
        text = _told(way.refused or way.text for way in refused)
        if not self._may_lose(len(self._roster.out)):
            return text
        self._go_without([way.cell for way in refused], text, now_s)
        return None

    def _settle(self, held_s: float, now_s: float) -> Decision | None:
        """Go on once all cells are back, and all parcels have been found again."""
        if self._roster.awaited:
            self._settled_s = None
            return None
        if self._settled_s is None:
            self._on_back()
        if self._settled_s is None or self._unsure():
            self._settled_s = now_s
        if now_s - self._settled_s < _SETTLED_S:
            return None
        self._journal.note(now_s, f"all cells are back after {held_s:.2f} s")
        return Decision(RunSignal.DONE)

    def _overdue(self, awaited: list[CellRecovery], now_s: float) -> Decision:
        """The array has been held for long enough."""
        limit = f"not back within {self._policy.limit_s:g} s"
        text = f"{_told(way.refused or way.text for way in awaited)}; {limit}"
        if not self._may_lose(len(self._roster.out)):
            return Decision(RunSignal.FAULT, text)
        self._go_without([way.cell for way in awaited], text, now_s)
        return Decision(RunSignal.WITHOUT)

    def _report_lost(self) -> None:
        lost = frozenset(cell.number for cell in self._roster.given_up)
        if lost != self._lost:
            self._lost = lost
            self._on_lost(lost)


def _told(texts: Iterable[str]) -> str:
    """The texts in one line, the first few of them and the number of the rest."""
    listed = list(dict.fromkeys(texts))
    more = len(listed) - _LISTED
    return "; ".join(listed[:_LISTED]) + (f"; and {more} more" if more > 0 else "")
