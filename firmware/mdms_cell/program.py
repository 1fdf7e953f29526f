"""A program on its way into the board's program memory (CiA 302-3: 0x1F50 and 0x1F56).

The memory has `begin(size)`, with None for a size that is not known, `write(data)` and `end()`;
`cancel()` drops what has not ended, and leaves nothing to be written later. They raise OSError
where they fail. `crc` is the CRC-32 of the program that is there, 0 without one.
"""

from mdms_cell.objects import key
from mdms_protocol import sdo

DATA = 0x1F50
IDENTIFICATION = 0x1F56

#: What an axis that may not be enabled yet is reported to wait for, and the error code.
SOURCE_PROGRAM = 7
MEMORY_BUSY = 0x5520


class Program:
    """The sink of a download; `memory` is None on a board that cannot keep a program.

    Writing flash stops the processor. So while there may be something left to write, the axes get
    no further than 'switched on', and an emergency tells who wants more that this is why.
    """

    def __init__(self, objects, memory, axes, emcy):
        self._memory = memory
        self._axes = axes
        self._emcy = emcy
        self._pending = False
        objects.domains[key(DATA, 1)] = self._open
        if memory is not None:
            objects.reads[key(IDENTIFICATION, 1)] = self._identification
        axes.hold(self._holds)

    def _identification(self):
        return self._memory.crc

    def _open(self, size):
        if self._memory is None:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        if self._axes.driving():
            raise sdo.AbortError(sdo.WRONG_STATE)
        self._pending = True
        self._try(self._memory.begin, size)
        return self

    def write(self, piece):
        """Take some bytes; raises AbortError."""
        self._try(self._memory.write, piece)

    def finish(self):
        """All bytes are there; raises AbortError."""
        self._try(self._memory.end)
        self._settle()

    def cancel(self):
        """The rest does not come; where flash fails even now, the axes stay off."""
        try:
            self._memory.cancel()
        except OSError:
            return
        self._settle()

    def _settle(self):
        self._pending = False
        self._emcy.clear(SOURCE_PROGRAM)

    def _holds(self):
        if self._pending:
            self._emcy.report(SOURCE_PROGRAM, MEMORY_BUSY)
        return self._pending

    def _try(self, action, *arguments):
        try:
            action(*arguments)
        except OSError as error:
            self.cancel()
            raise sdo.AbortError(sdo.HARDWARE_ERROR) from error
