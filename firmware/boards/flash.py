"""Settings in files of the board's flash file system, the memory of `mdms_cell.canopen.store`.

Erasing flash stops the processor, so nothing is written unless `asleep()` reports that no bridge is
awake. MicroPython writes the last sector that was touched five seconds later, or when a file is
closed, renamed or removed; nothing here leaves it to the former.
"""

import os

BANK_SIZE = 4096


class Settings:
    """Two banks of bytes; the store never writes to the bank whose content is in use."""

    def __init__(self, folder, asleep):
        self._folder = folder
        self._asleep = asleep

    def _path(self, bank):
        return "%s/settings%d.bin" % (self._folder, bank)

    def read(self, bank):
        """The whole bank, empty if it was never written.

        Read asks for as much memory as it may return, and a long piece may not be free.
        """
        path = self._path(bank)
        try:
            with open(path, "rb") as file:
                return file.read(min(os.stat(path)[6], BANK_SIZE))
        except OSError:
            return b""

    def erase(self, bank):
        """Make the bank empty."""
        _check(self._asleep)
        with open(self._path(bank), "wb"):
            pass

    def write(self, bank, offset, data):
        """Write at the end of what the bank holds."""
        _check(self._asleep)
        if os.stat(self._path(bank))[6] != offset:
            raise OSError("settings are written from their beginning on")
        with open(self._path(bank), "ab") as file:
            file.write(data)


def _check(asleep):
    if not asleep():
        raise OSError("flash is written only while both bridges sleep")
