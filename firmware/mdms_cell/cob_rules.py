"""Which COB-ID objects may be written, loaded when one is (CiA 301, table 41 and 7.5.2)."""

from mdms_protocol import cob, sdo


def check(cob_id, can_id_before, ignored=0):
    """Raises AbortError if a service with this identifier, or None, may not have it.

    The bits `ignored` may be set.
    """
    if cob_id & cob.INVALID:
        return
    can_id = cob_id & cob.IDENTIFIER
    check_plain(cob_id & ~ignored)
    if can_id_before is not None and can_id_before != can_id:
        raise sdo.AbortError(sdo.WRONG_STATE)


def check_plain(cob_id):
    """Raises AbortError if it is no identifier alone that a service may be given."""
    if cob_id != cob_id & cob.IDENTIFIER or cob.restricted(cob_id):
        raise sdo.AbortError(sdo.INVALID_VALUE)
