"""A program on its way into the board's program memory (CiA 302-3: 0x1F50 and 0x1F56).

The memory has `begin(size)`, with None for a size that is not known, `write(data)` and `end()`,
and raises OSError where it fails.
"""

import binascii

from mdms_cell.objects import key
from mdms_protocol import sdo

DATA = 0x1F50
IDENTIFICATION = 0x1F56


class Program:
    """The sink of a download; `memory` is None on a board that cannot keep a program."""

    def __init__(self, objects, memory, driving):
        self._memory = memory
        self._driving = driving
        self._crc = 0
        self._complete_crc = 0
        objects.domains[key(DATA, 1)] = self._open
        objects.reads[key(IDENTIFICATION, 1)] = lambda: self._complete_crc

    def _open(self, size):
        if self._memory is None:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        if self._driving():
            raise sdo.AbortError(sdo.WRONG_STATE)
        self._crc = 0
        self._complete_crc = 0
        self._try(self._memory.begin, size)
        return self

    def write(self, piece):
        """Take some bytes; raises AbortError."""
        self._crc = binascii.crc32(piece, self._crc)
        self._try(self._memory.write, piece)

    def finish(self):
        """All bytes are there; raises AbortError."""
        self._try(self._memory.end)
        self._complete_crc = self._crc

    def cancel(self):
        """The rest does not come; what is there is no program."""

    def _try(self, action, *arguments):
        try:
            action(*arguments)
        except OSError as error:
            raise sdo.AbortError(sdo.HARDWARE_ERROR) from error
