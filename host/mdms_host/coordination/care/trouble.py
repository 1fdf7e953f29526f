"""Troubles of a cell that has been up, and whether a trouble may pass by itself."""

from dataclasses import dataclass
from enum import StrEnum

from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.cell_setup.identification import PASSING_CODES
from mdms_protocol.codecs import cia402, nmt

#: Errors with which drives shut off; others are mere reports.
_OF_DRIVES = PASSING_CODES | {0x2310, 0x3220, 0x6100, 0x7121, 0x7302, 0x8150, 0x8611}
_FAULTED = frozenset((cia402.FAULT, cia402.FAULT_REACTION))


class Nature(StrEnum):
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
    nature: Nature = Nature.PASSING


def nature_of(cell: BringUpCell) -> Nature:
    """The nature of the event that ended 'operational', or that disabled the drives.

    A cell leaves 'operational' by itself for a restart, which it announces. A cell that steers also
    leaves it when the host is silent. Drives are off by themselves in 'fault' only. Everything else
    was commanded from outside.
    """
    codes = _OF_DRIVES.intersection(cell.errors.values())
    if codes - PASSING_CODES:
        return Nature.LASTING
    if cell.nmt_state != nmt.OPERATIONAL:
        return Nature.PASSING if cell.restarted or cell.steers else Nature.DELIBERATE
    faulted = not _FAULTED.isdisjoint(cell.drive_states or ())
    return Nature.PASSING if faulted else Nature.DELIBERATE
