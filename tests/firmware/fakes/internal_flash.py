"""Internal flash of an STM32F405 and the cache that MicroPython's port has before it.

After `flashbdev.c` and `storage.c` of ports/stm32: one sector is in the cache; writing to another
has the first programmed; the FLASH interrupt looks at it every 512 ms, erases it at the first look
and programs it 5 s after the last write. Flash clears bits when it is programmed and sets them when
a sector is erased. Where power fails, a sector under erasure has some of its old bits, some of its
new bits and some of neither. The same holds for the bits of a word under programming.

Left out: the time that erasing and programming take; the device with the emulated partition table.
"""

import world

#: Where sector 1 begins, the first of the file system, and the sizes of sectors 1 to 4.
ADDRESS = 0x08004000
SECTORS = (0x4000, 0x4000, 0x4000, 0x10000)

_BLANK = b"\xff" * 512


class PowerLost(Exception):  # noqa: N818 - an event of a test
    """The supply has failed."""


class InternalFlash:
    """`content`, a bytearray, is the content of the flash, which is blank without it.

    After `budget` more operations (a sector erased, a word programmed) the supply fails in the next
    one. `on_stop` is called as each of them stops the processor.
    """

    def __init__(self, content=None, seed=1):
        self.size = sum(SECTORS)
        self.content = content or bytearray(b"\xff" * self.size)
        self.budget = None
        self.on_stop = None
        self.lost = False
        self._seed = seed
        self._start = None  # of the sector in the cache
        self._cache = b""
        self._erased = False
        self._forced = False
        self._touched_ms = None

    @property
    def dirty(self):
        """Whether something waits to be programmed."""
        return self._touched_ms is not None

    def read(self, at, buffer):
        """Read through the cache."""
        if self.lost:
            return
        start, _ = sector(at)
        source, at = (self._cache, at - start) if start == self._start else (self.content, at)
        buffer[:] = source[at : at + len(buffer)]

    def half_word(self, address):
        """Read past the cache."""
        at = address - ADDRESS
        return self.content[at] | self.content[at + 1] << 8

    def write(self, at, data):
        """Write into the cache; a finaliser may still try after the cut."""
        if self.lost:
            return
        start, size = sector(at)
        if start != self._start:
            self.sync()
            self._cache = bytearray(self.content[start : start + size])
            self._start = start
        self._touched_ms = world.now_ms
        at -= start
        self._cache[at : at + len(data)] = data

    def sync(self):
        """Program the sector in the cache."""
        self._forced = True
        while self.dirty and not self.lost:
            self.interrupt()
        self._forced = False

    def interrupt(self):
        """The FLASH interrupt, every 512 ms."""
        if not self.dirty:
            return
        if not self._erased:
            self._erase()
            self._erased = True
        elif self._forced or world.now_ms - self._touched_ms >= 5000:
            self._program()
            self._touched_ms = None
            self._erased = False

    def _erase(self):
        start, size = sector(self._start)
        if self._spend():
            self.content[start : start + size] = b"\xff" * size
            return
        for at in range(start, start + size, 512):
            mix = self._random()
            if mix & 3 == 0:
                self.content[at : at + 512] = _BLANK
            elif mix & 3 == 1:
                self.content[at : at + 512] = bytes((mix >> 2 & 0xFF,)) * 512
        raise PowerLost

    def _program(self):
        for block in range(0, len(self._cache), 512):
            if self._cache[block : block + 512] != _BLANK:
                for at in range(block, block + 512, 4):
                    self._program_word(at)

    def _program_word(self, at):
        word = self._cache[at : at + 4]
        if word == b"\xff\xff\xff\xff":
            return  # which changes nothing
        whole = self._spend()
        for place in range(4):
            kept = 0 if whole else self._random() & 0xFF
            self.content[self._start + at + place] &= word[place] | kept
        if not whole:
            raise PowerLost

    def _spend(self):
        """Whether the supply lasts for another operation."""
        if self.on_stop is not None:
            self.on_stop()
        if self.budget is None:
            return True
        self.budget -= 1
        self.lost = self.budget < 0
        return not self.lost

    def _random(self):
        self._seed = (self._seed * 1103515245 + 12345) & 0x3FFFFFFF
        return self._seed >> 12


def sector(at):
    """Beginning and size of the sector that holds a byte."""
    start = 0
    for size in SECTORS:
        if at < start + size:
            return start, size
        start += size
    raise ValueError(at)
