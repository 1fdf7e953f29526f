"""Whether a cell speaks the host's protocol, by the revision in its identity (0x1018:3).

The upper half is the object table's: cells of another have other objects, or the same with another
meaning. The lower half changes nothing for the host (CiA 301, 7.5.2.21).
"""

from mdms_protocol.dictionary import REVISION

_MAJOR = 16
OURS = REVISION >> _MAJOR


def speaks_ours(revision: int) -> bool:
    """Whether a cell of this revision is understood."""
    return revision >> _MAJOR == OURS


def other_protocol(revision: int) -> str | None:
    """What there is to say of a cell that is not; None for one that is."""
    if speaks_ours(revision):
        return None
    return (
        f"speaks revision {revision >> _MAJOR} of the protocol, this host {OURS}; "
        "flash the same version: mdms flash"
    )
