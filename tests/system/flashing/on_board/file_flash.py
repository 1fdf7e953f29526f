"""A NOR flash chip whose content is a file that outlives the process; strict, on MicroPython.

Blocks of 4096 bytes are erased for themselves. Bytes must be erased before they are programmed, and
are programmed in pages of 256. At the operation of number `cut`, from 0 on, a part of it is done,
the other process is told so, and nothing goes on: it ends this one. Left out: wear, and bits that
are neither 0 nor 1.
"""

import time

BLOCK = 4096
PAGE = 256
BLANK = b"\xff" * BLOCK


class FileFlash:
    """A block device for `vfs.VfsLfs2` over the file at a path; `tell(text)` reaches the other.

    `operations` counts the changes of the chip since power-up.
    """

    operations = 0

    def __init__(self, path, tell, cut=None):
        self._file = open(path, "r+b")  # noqa: SIM115 - open as long as the process lives
        self._blocks = self._file.seek(0, 2) // BLOCK
        self._tell = tell
        self._cut = cut

    def readblocks(self, block, buffer, offset=0):
        """Read."""
        self._file.seek(block * BLOCK + offset)
        assert self._file.readinto(buffer) == len(buffer)
        return 0

    def writeblocks(self, block, data, offset):
        """Program erased bytes, a page at a time."""
        start = block * BLOCK + offset
        assert offset + len(data) <= BLOCK
        done = 0
        while done < len(data):
            count = min(PAGE - (start + done) % PAGE, len(data) - done)
            self._program(start + done, bytes(memoryview(data)[done : done + count]))
            done += count
        return 0

    def _program(self, at, page):
        self._file.seek(at)
        if self._file.read(len(page)) != BLANK[: len(page)]:
            self._tell("not erased before it was programmed: " + str(at))
        cut = self._is_cut()
        self._put(at, page[: len(page) * self._share() // 16] if cut else page)
        self._stop(cut)

    def ioctl(self, operation, argument):
        """Answer a request of the file system."""
        if operation == 6:
            cut = self._is_cut()
            size = BLOCK * self._share() // 16 if cut else BLOCK
            self._put(argument * BLOCK, BLANK[:size])
            self._stop(cut)
            return 0
        return {4: self._blocks, 5: BLOCK}.get(operation, 0)

    def _put(self, at, data):
        self._file.seek(at)
        self._file.write(data)
        self._file.flush()

    def _is_cut(self):
        FileFlash.operations += 1
        return FileFlash.operations - 1 == self._cut

    def _share(self):
        """The share of the cut operation that is done, in sixteenths: another for each."""
        return self._cut * 7 % 16

    def _stop(self, cut):
        if cut:
            self._tell("cut")
            while True:
                time.sleep(1)
