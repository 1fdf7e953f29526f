"""A NOR flash chip as the ports of Teensy 4.1 and of SPI flash give it to a file system.

Blocks of 4096 bytes are erased for themselves; programming clears bits and no more. The supply
fails in the operation after `budget` others, an erase or a page of at most 256 bytes, and leaves
it half done; after that nothing works any more, which is how LittleFS gets to see it.
"""

BLOCK = 4096
PAGE = 256
_FAILED = -5  # EIO


class NorFlash:
    """A block device for `vfs.VfsLfs2` over `content`, or over a blank chip of so many blocks."""

    def __init__(self, content=None, blocks=16, seed=1):
        self.content = bytearray(content or b"\xff" * (blocks * BLOCK))
        self.budget = None
        self.erases = 0
        self.on_stop = None
        self._seed = seed
        self._lost = False

    @property
    def dirty(self):
        """Whether something waits to be programmed; these ports have nothing wait."""
        return False

    def readblocks(self, block, buffer, offset=0):
        """Read; from a chip without supply nothing comes."""
        if self._lost:
            return _FAILED
        start = block * BLOCK + offset
        buffer[:] = self.content[start : start + len(buffer)]
        return 0

    def writeblocks(self, block, data, offset):
        """Program, a page at a time."""
        start = block * BLOCK + offset
        for place in range(0, len(data), PAGE):
            page = data[place : place + PAGE]
            whole = self._spend()
            if whole is None:
                return _FAILED
            for at in range(len(page)):
                kept = 0 if whole else self._random() & 0xFF
                self.content[start + place + at] &= page[at] | kept
        return _FAILED if self._lost else 0

    def ioctl(self, operation, argument):
        """Answer a request of the file system."""
        if operation == 6:
            return self._erase(argument)
        return {4: len(self.content) // BLOCK, 5: BLOCK}.get(operation, 0)

    def _erase(self, block):
        whole = self._spend()
        if whole is None:
            return _FAILED
        self.erases += 1
        for at in range(block * BLOCK, (block + 1) * BLOCK):
            if whole or self._random() & 1:
                self.content[at] = 0xFF
        return 0 if whole else _FAILED

    def _spend(self):
        """True for an operation to be done, False for one cut off, None for none any more."""
        if self._lost:
            return None
        if self.on_stop is not None:
            self.on_stop()
        if self.budget is not None:
            self.budget -= 1
            self._lost = self.budget < 0
        return not self._lost

    def _random(self):
        self._seed = (self._seed * 1103515245 + 12345) & 0x3FFFFFFF
        return self._seed >> 12
