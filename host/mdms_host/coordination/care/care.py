"""Reaction of a run to cells out of action: hold the parcels, go on without the cells, or end."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf

from mdms_host.coordination.care.comeback import Comeback
from mdms_host.coordination.care.policy import OnLostCell, Policy
from mdms_host.coordination.care.roster import Roster
from mdms_host.coordination.care.supervision import Supervision
from mdms_host.coordination.care.trouble import Nature, Trouble
from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.journal import Journal
from mdms_host.coordination.phase import HELD, Phase, Signal
from mdms_host.coordination.speeds.odometry import Odometry
from mdms_protocol.emergencies import LOW_SUPPLY

#: Pauses are counted over so long [s].
_COUNTED_S = 60.0
#: Parcels lie still for so long, with all cells back, before they are moved again [s].
_SETTLED_S = 0.2
#: How many cells a message says it of.
_LISTED = 3


@dataclass(frozen=True, slots=True)
class Decision:
    """The next step of the run, and the reason in words."""

    signal: Signal
    text: str = ""


class Care:
    """Follows cells that are out of action until they are back, and decides by a policy.

    `pauses` is how often all parcels have been held. `on_lost` gets the numbers of the cells that
    the run does without, whenever they change, and `on_back` is called when all cells are back.
    """

    def __init__(
        self,
        roster: Roster,
        policy: Policy,
        *,
        supervision: Supervision,
        odometry: Odometry,
        journal: Journal,
        on_lost: Callable[[frozenset[int]], None],
        on_back: Callable[[], None],
    ) -> None:
        self.pauses = 0
        self._roster = roster
        self._policy = policy
        self._supervision = supervision
        self._odometry = odometry
        self._journal = journal
        self._on_lost = on_lost
        self._on_back = on_back
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

    def step(self, phase: Phase, now_s: float, unsure: bool) -> Decision | None:
        """The decision of the run now; None to go on. `unsure` is whether a parcel is doubtful."""
        if asleep := self._asleep(now_s):
            return Decision(Signal.FAULT, asleep)
        troubles = self._troubles(now_s)
        for trouble in troubles:
            self._roster.lose(trouble.cell, trouble.text, now_s)
        self.bring_back(now_s)
        if any(each.nature is Nature.DELIBERATE for each in troubles):
            return Decision(Signal.FAULT, _told(each.text for each in troubles))
        decision = None
        if phase in HELD:
            decision = self._while_held(phase, now_s, unsure)
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
            self._roster.lose(cell, text, now_s)
        self._go_without(late, text, now_s)
        self._report_lost()
        return True

    def _troubles(self, now_s: float) -> list[Trouble]:
        """Troubles of cells that take part, one for each cell."""
        limit_s, late = self._odometry.late()
        silence = f"has fallen silent: no speeds for {limit_s:.3g} s"
        troubles = self._supervision.troubles(self._roster.taking_part, now_s)
        found = {each.cell: each for each in troubles}
        for cell in self._roster.taking_part:
            if cell in late and cell not in found:
                found[cell] = Trouble(cell, f"{cell.name} {silence}")
        return list(found.values())

    # While parcels move

    def _on_troubles(self, troubles: list[Trouble], now_s: float) -> Decision | None:
        text = _told(each.text for each in troubles)
        if self._may_lose(len(self._roster.out)):
            self._go_without([each.cell for each in troubles], text, now_s)
            return None
        if all(each.nature is Nature.LASTING for each in troubles) and not self._waits:
            return Decision(Signal.FAULT, text)
        return self._hold(text, now_s)

    def _hold(self, text: str, now_s: float) -> Decision:
        while self._begun_s and now_s - self._begun_s[0] > _COUNTED_S:
            self._begun_s.popleft()
        if len(self._begun_s) >= self._policy.pauses and not self._waits:
            held = f"; held {len(self._begun_s)} times in a minute before"
            return Decision(Signal.FAULT, text + (held if self._begun_s else ""))
        self._begun_s.append(now_s)
        self.pauses += 1
        self._since_s, self._settled_s = now_s, None
        # Those that fell out just before may have the same reason, and come back as soon.
        self._roster.await_since(now_s - self._policy.pause_s)
        self._journal.warn(now_s, f"all parcels are held: {text}")
        return Decision(Signal.TROUBLE)

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

    def _while_held(self, phase: Phase, now_s: float, unsure: bool) -> Decision | None:
        if refusal := self._power_cut() or self._refusal(now_s):
            return Decision(Signal.FAULT, refusal)
        awaited = self._roster.awaited
        held_s = now_s - self._since_s
        if awaited and held_s >= self._policy.limit_s:
            return self._overdue(awaited, now_s)
        heard = all(way.heard for way in awaited)
        if heard is not (phase is Phase.RECOVERING):
            return Decision(Signal.DONE if heard else Signal.TROUBLE)
        return self._settle(unsure, held_s, now_s) if heard else None

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

    def _settle(self, unsure: bool, held_s: float, now_s: float) -> Decision | None:
        """Go on once all cells are back, and all parcels have been found again."""
        if self._roster.awaited:
            self._settled_s = None
            return None
        if self._settled_s is None:
            self._on_back()
        if self._settled_s is None or unsure:
            self._settled_s = now_s
        if now_s - self._settled_s < _SETTLED_S:
            return None
        self._journal.note(now_s, f"all cells are back after {held_s:.2f} s")
        return Decision(Signal.DONE)

    def _overdue(self, awaited: list[Comeback], now_s: float) -> Decision:
        """The array has been held for long enough."""
        limit = f"not back within {self._policy.limit_s:g} s"
        text = f"{_told(way.refused or way.text for way in awaited)}; {limit}"
        if not self._may_lose(len(self._roster.out)):
            return Decision(Signal.FAULT, text)
        self._go_without([way.cell for way in awaited], text, now_s)
        return Decision(Signal.WITHOUT)

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
