"""How the objects of a cell refuse a request of a client, for tests on every interpreter."""

from mdms_protocol.codecs import sdo


def code_of(action, *arguments):
    """The abort code with which a call is refused, None if it is not."""
    try:
        action(*arguments)
    except sdo.AbortError as refusal:
        return refusal.code
    return None
