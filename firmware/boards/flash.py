"""Settings and program in files of the board's flash file system.

They are the memories that `mdms_cell.store` and `mdms_cell.program` ask for.
"""

import binascii
import os
import sys

BANK_SIZE = 4096
_PIECE = 512


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


class Program:
    """A downloaded program, `program.bin`: the one before until all of the next is there and read.

    A file that is renamed takes no other's place on FAT: between removing the old and renaming the
    new one power may fail. So the new one is `program.new` from when it is known to be whole, and
    replaces the old one then or at the next start. Erasing flash stops the processor, so nothing
    is written while `driving()`.
    """

    def __init__(self, folder, driving):
        self._path = folder + "/program"
        self._driving = driving
        self._file = None
        self._crc = 0
        try:
            self._tidy()
        except OSError as error:  # flash that fails is no reason not to start
            sys.print_exception(error)

    def _tidy(self):
        """End what power failed in; what was not whole is no program."""
        _remove(self._path + ".tmp")
        if _exists(self._path + ".new"):
            self._replace()

    def begin(self, _size):
        """Make room for a program of so many bytes, or None; it grows while it is written."""
        self._close()
        self._tidy()
        self._crc = 0
        self._file = open(self._path + ".tmp", "wb")  # noqa: SIM115 - until `end`

    def write(self, data):
        """Take the next bytes."""
        if self._begun().write(data) != len(data):
            raise OSError("there is no room for the program")
        self._crc = binascii.crc32(data, self._crc)

    def end(self):
        """All bytes are there: read them back, and let them take the place of the old program."""
        self._begun()
        self._close()
        if _crc_of(self._path + ".tmp") != self._crc:
            raise OSError("flash does not hold what was written")
        os.rename(self._path + ".tmp", self._path + ".new")
        self._replace()

    def _begun(self):
        if self._file is None or self._driving():
            raise OSError("a program is written from its beginning on, with the motors off")
        return self._file

    def _close(self):
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _replace(self):
        _remove(self._path + ".bin")
        os.rename(self._path + ".new", self._path + ".bin")


def _crc_of(path):
    crc = 0
    with open(path, "rb") as file:
        piece = file.read(_PIECE)
        while piece:
            crc = binascii.crc32(piece, crc)
            piece = file.read(_PIECE)
    return crc


def _exists(path):
    try:
        os.stat(path)
    except OSError:
        return False
    return True


def _remove(path):
    if _exists(path):
        os.remove(path)
