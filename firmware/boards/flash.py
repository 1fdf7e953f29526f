"""Settings in two files of the board's flash file system, as `mdms_cell.store` wants its memory."""

import os

BANK_SIZE = 4096


class Settings:
    """Two banks of bytes; the store never writes to the bank whose content is in use."""

    def __init__(self, folder):
        self._folder = folder

    def _path(self, bank):
        return "%s/settings%d.bin" % (self._folder, bank)

    def read(self, bank):
        """The whole bank, empty if it was never written."""
        try:
            with open(self._path(bank), "rb") as file:
                return file.read(BANK_SIZE)
        except OSError:
            return b""

    def erase(self, bank):
        """Make the bank empty."""
        with open(self._path(bank), "wb"):
            pass

    def write(self, bank, offset, data):
        """Write at the end of what the bank holds."""
        if os.stat(self._path(bank))[6] != offset:
            raise OSError("settings are written from their beginning on")
        with open(self._path(bank), "ab") as file:
            file.write(data)
