"""Settings in files of a LittleFS, the memory of `mdms_cell.canopen.store`.

This suits boards on which the port gives LittleFS the erase blocks of the flash. These are the
Teensy 4.1, and STM32 boards with their file system on SPI flash. There LittleFS keeps the old data
until the new data are whole. On internal flash of an STM32 it cannot; see `boards.pybv11`.

Erasing flash stops the processor. So nothing is written unless `asleep()` reports that no bridge is
awake.
"""

import os

BANK_SIZE = 4096
#: Of flash chips; a port that lets LittleFS erase nothing has blocks of 512 bytes.
_ERASE_BLOCK = 4096


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
        """Append to the contents of the bank."""
        _check(self._asleep)
        if os.stat(self._path(bank))[6] != offset:
            raise OSError("settings are written from their beginning on")
        with open(self._path(bank), "ab") as file:
            file.write(data)


def memory(folder, asleep):
    """The memory of the store; None where power may not fail while the folder is written."""
    return Settings(folder, asleep) if keeps_whole(folder) else None


def keeps_whole(folder):
    """Whether the folder is a LittleFS on real erase blocks."""
    import vfs  # for this only

    for file_system, path in vfs.mount():
        if path == folder:
            return isinstance(file_system, vfs.VfsLfs2) and os.statvfs(folder)[0] >= _ERASE_BLOCK
    return False


def _check(asleep):
    if not asleep():
        raise OSError("flash is written only while both bridges sleep")
