"""Supervision of the cells: heartbeats, and states that the phase requires.

A trouble is that of a cell that has been up. Some troubles may pass by themselves.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf

from mdms_host.can_link.remote_cell import CUT, RemoteCell
from mdms_host.coordination.bring_up import BringUpCell
from mdms_host.coordination.cell_setup import PASSING_CODES
from mdms_host.coordination.run_state import Phase, Timing
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.emergencies import IN_ANOTHERS_PLACE, LOW_SUPPLY

#: Errors with which drives shut off; others are mere reports.
_OF_DRIVES = PASSING_CODES | {0x2310, 0x3220, 0x6100, 0x7121, 0x7302, 0x8150, 0x8611}
_FAULTED = frozenset((cia402.FAULT, cia402.FAULT_REACTION))


class TroubleNature(StrEnum):
    """Of what kind a trouble is."""

    #: It may be over soon: silence, a restart, a watchdog's stop.
    PASSING = "passing"
    #: The cell needs a person: its drives have shut off for a reason of their own.
    LASTING = "lasting"
    #: Another program has switched the cell off, and is to be obeyed.
    DELIBERATE = "deliberate"


@dataclass(frozen=True, slots=True)
class Trouble:
    """A trouble of a cell, in words that name the cell."""

    cell: BringUpCell
    text: str
    nature: TroubleNature = TroubleNature.PASSING


def nature_of(cell: BringUpCell) -> TroubleNature:
    """The nature of the event that ended 'operational', or that disabled the drives.

    A cell leaves 'operational' by itself for a restart, which it announces. A cell that steers also
    leaves it when the host is silent. Drives are off by themselves in 'fault' only. Everything else
    was commanded from outside.
    """
    codes = _OF_DRIVES.intersection(cell.errors.values())
    if codes - PASSING_CODES:
        return TroubleNature.LASTING
    if cell.nmt_state != nmt.OPERATIONAL:
        return TroubleNature.PASSING if cell.restarted or cell.steers else TroubleNature.DELIBERATE
    faulted = not _FAULTED.isdisjoint(cell.drive_states or ())
    return TroubleNature.PASSING if faulted else TroubleNature.DELIBERATE


#: The trouble of a second host that sends heartbeats.
OTHER_HOST = (
    f"another host runs on this bus (a heartbeat of node {cob.NODE_MAX}); "
    "let it come to its end, or end it, first"
)

#: The cells of one supply report that it is low within this time [s].
_GATHER_S = 0.05

#: The trouble of cells that another program took out of 'operational': a stop is a stop.
SWITCHED_OFF = "another program has switched cells off on this bus (network management)"

#: The trouble of a cell that gets controlwords or setpoints of another program as well.
COMMANDED = "another program commands drives on this bus (controlwords or setpoints)"

#: Of more cells with another serial number than they are to have, the others are counted.
_MOST_NAMED = 3


class Supervision:
    """Finds the faults of the cells, and checks them only when there may be one.

    While they run, that is after a cell has reported a change (`recheck`), or when a heartbeat may
    be missing: between these nothing can fail that had not failed before.
    """

    def __init__(self, cells: Sequence[BringUpCell], timing: Timing) -> None:
        self._count = len(cells)
        self._timing = timing
        self._silence_s = timing.silence_s
        self._valid_until_s = -inf
        self._low: dict[BringUpCell, None] = {}
        self._low_since_s = inf

    def recheck(self) -> None:
        """The phase, the cells that take part, or a state that a cell reports, has changed."""
        self._valid_until_s = -inf

    def fault(
        self, phase: Phase, taking_part: Collection[BringUpCell], now_s: float
    ) -> Trouble | None:
        """The fault of the first cell that has one while all come up; None without any."""
        for cell in taking_part:
            if text := self._silence_of(cell, now_s) or cell.fault(phase):
                return Trouble(cell, text)
        return None

    def without_supply(
        self, taking_part: Collection[BringUpCell], now_s: float
    ) -> list[BringUpCell]:
        """Cells whose supply has been low since the bring-up; none until all such cells are known.

        A cell whose supply is back counts, too: a person has pressed an emergency stop since the
        start.
        """
        self._low.update(dict.fromkeys(cell for cell in taking_part if cell.lacks_supply))
        low = [cell for cell in taking_part if cell in self._low]
        if low and self._low_since_s == inf:
            self._low_since_s = now_s
        return low if now_s >= self._low_since_s + _GATHER_S else []

    def low_supply_text(self, low: Sequence[BringUpCell]) -> str:
        """The message about the low supply of these cells."""
        where = f"all {len(low)} cells" if len(low) == self._count > 1 else names(low)
        return (
            f"the motors' supply is below its limit on {where} (0x{LOW_SUPPLY:04X}): "
            "release the emergency stop, or mend the supply, then start again"
        )

    def troubles(self, taking_part: Collection[BringUpCell], now_s: float) -> list[Trouble]:
        """Troubles of cells that are up and take part in the run."""
        if now_s < self._valid_until_s:
            return []
        found = (self._trouble_of(cell, now_s) for cell in taking_part)
        troubles = [each for each in found if each is not None]
        oldest_s = min((cell.last_heartbeat_s or 0.0 for cell in taking_part), default=inf)
        self._valid_until_s = -inf if troubles else oldest_s + self._silence_s
        return troubles

    def silent(self, cell: BringUpCell, now_s: float) -> bool:
        """Whether a cell has sent heartbeats, and the next is overdue."""
        return cell.last_heartbeat_s is not None and now_s - cell.last_heartbeat_s > self._silence_s

    def late_text(self, phase: Phase, late: list[BringUpCell]) -> str:
        """Which cells exceeded the phase's time limit, and with what."""
        limit = f"within {self._timing.phase_limit_s:g} s"
        match phase:
            case Phase.WAITING if len(late) == self._count:
                return f"no cell was heard {limit}; is the bus connected and are the cells powered?"
            case Phase.WAITING:
                absent = [cell for cell in late if cell.last_heartbeat_s is None]
                what = "not heard" if absent else "not brought to rest"
                return f"{what} {limit}: {names(absent or late)}"
            case Phase.IDENTIFYING:
                return f"not identified {limit}: {names(late)}"
            case Phase.CONFIGURING:
                return f"settings not written and verified {limit}: {names(late)}"
            case Phase.STARTING:
                others = [cell for cell in late if not cell.elsewhere]
                texts = [f"not operational {limit}: {names(others)}"] if others else []
                return "; ".join(texts + _elsewhere_texts(late))
            case _:
                return f"drives not enabled {limit}: {names(late)} ({late[0].drives_text})"

    def misfits_text(self, phase: Phase, taking_part: Collection[BringUpCell]) -> str | None:
        """All cells that are not as a run expects them at the end of a phase, None without any.

        In the bring-up their protocol, serial number, board or settings do not fit. After a stop
        they may drive.
        """
        if phase in (Phase.STOPPING, Phase.FAILING):
            on = [cell for cell in taking_part if cell.may_drive]
            where = f"all {len(on)} cells" if len(on) == self._count > 1 else names(on)
            return f"not confirmed to be off: {where}; {CUT}" if on else None
        if phase is Phase.CONFIGURING:
            found = (f"{cell.name} is {cell.mismatch}" for cell in taking_part if cell.mismatch)
            return "; ".join(found) or None
        if phase is not Phase.IDENTIFYING:
            return None
        listed = (
            *_listed({cell.name: cell.identification.other_protocol for cell in taking_part}),
            *_listed({cell.name: cell.identification.cannot_steer for cell in taking_part}),
        )
        return "; ".join((*listed, *_other_boards(taking_part))) or None

    def _trouble_of(self, cell: BringUpCell, now_s: float) -> Trouble | None:
        if silence := self._silence_of(cell, now_s):
            return Trouble(cell, silence)
        if fault := cell.fault(Phase.RUNNING):
            return Trouble(cell, fault, nature_of(cell))
        return None

    def _silence_of(self, cell: BringUpCell, now_s: float) -> str | None:
        if not self.silent(cell, now_s):
            return None
        return f"{cell.name} has fallen silent: no heartbeat for {self._silence_s:.3g} s"


def _listed(reasons: Mapping[str, str | None]) -> Iterator[str]:
    """Each reason once, behind the names of the cells that have it."""
    for reason in sorted({reason for reason in reasons.values() if reason}):
        yield f"{', '.join(name for name, one in reasons.items() if one == reason)}: each {reason}"


def _other_boards(cells: Iterable[BringUpCell]) -> Iterator[str]:
    """Cells that are not the boards that they are to be, and what to do."""
    boards = ((cell.name, cell.identification.other_board) for cell in cells)
    found = [f"{name} {other}" for name, other in boards if other]
    yield from found[:_MOST_NAMED]
    if len(found) > _MOST_NAMED:
        yield f"and {len(found) - _MOST_NAMED} more cells"
    if found:
        yield (
            "boards were exchanged or moved: put them back, or write their places anew with "
            "mdms commission"
        )


def _elsewhere_texts(cells: Sequence[BringUpCell]) -> list[str]:
    """Which of the cells say that they stand in another's place, and what to do."""
    elsewhere = [cell for cell in cells if cell.elsewhere]
    if not elsewhere:
        return []
    return [
        f"in the place of another cell (0x{IN_ANOTHERS_PLACE:04X}): {names(elsewhere)}; put the "
        "boards back, or write their places anew with mdms commission"
    ]


def names(cells: Sequence[RemoteCell]) -> str:
    """How messages call these cells."""
    return ", ".join(cell.name for cell in cells)
