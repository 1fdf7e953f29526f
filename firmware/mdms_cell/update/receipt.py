"""A bundle on its way from the client into the spare slot.

The head is looked at first, and refused before flash is touched. What is in flash is read again at
the end, past every buffer, and counts only if it is what the head has signed.
"""

from mdms_protocol.update import bundle, codes


class Receipt:
    """Takes a bundle in pieces; `admit(data)`, which returns the head, and `received(head)`
    are the update's.

    `refusal(reason)` returns an AbortError.
    """

    def __init__(self, slots, admit, received, refusal):
        self._slots = slots
        self._admit = admit
        self._received = received
        self._refusal = refusal
        self._start = b""
        self._slot = None

    def write(self, piece):
        """Take some bytes; raises AbortError."""
        slot = self._slot
        if slot is None:
            self._start += piece
            if len(self._start) < bundle.HEAD_SIZE:
                return
            slot = self._slot = self._open()
            piece, self._start = self._start[bundle.HEAD_SIZE :], b""
        slot.left -= len(piece)
        if slot.left < 0:
            raise self._refusal(codes.TOO_LARGE)
        try:
            slot.file.write(piece)
        except OSError:
            raise self._refusal(codes.FLASH_FAILED)  # noqa: B904 - MicroPython has no `from`

    def _open(self):
        try:
            return _Slot(self._admit(self._start), self._slots.create())
        except OSError:
            raise self._refusal(codes.FLASH_FAILED)  # noqa: B904

    def finish(self):
        """All has come; raises AbortError if that is not what the head has signed."""
        slot = self._slot
        if slot is None:
            known = self._start[:4] == bundle.MAGIC
            raise self._refusal(codes.TRUNCATED if known else codes.NO_BUNDLE)
        if slot.left:
            raise self._refusal(codes.TRUNCATED)
        try:
            slot.file.close()
            found = self._slots.digest()
        except OSError:
            raise self._refusal(codes.FLASH_FAILED)  # noqa: B904
        if found != (slot.head.size, slot.head.digest):
            raise self._refusal(codes.DAMAGED)
        self._received(slot.head)

    def cancel(self):
        """Throw away what has come."""
        self._received(None)
        if self._slot is None:
            return
        try:
            self._slot.file.close()
        except OSError:
            return  # what flash cannot keep is not there
        finally:
            self._slots.remove()


class _Slot:
    """The spare slot while it is written: what is to be in it, and how much is missing."""

    def __init__(self, head, file):
        self.head = head
        self.file = file
        self.left = head.size
