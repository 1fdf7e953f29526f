"""Settings and program in files of the board's flash file system.

They are the memories that `mdms_cell.store` and `mdms_cell.program` ask for. Erasing flash stops
the processor, so both write only while `asleep()` says that no bridge is awake. MicroPython writes
the last sector that was touched five seconds later, or when a file is closed, renamed or removed;
nothing here leaves it to the former.
"""

import binascii
import os
import sys

BANK_SIZE = 4096
_PIECE = 512
_CRC_SIZE = 4
#: The CRC-32 of whatever ends with its own CRC-32.
_RESIDUE = 0x2144DF1C


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


class Program:
    """A downloaded program, `program.bin`: the one before until all of the next is there and read.

    Behind its last byte the file has its CRC-32. A file that is renamed takes no other's place on
    FAT: between removing the old and renaming the new one power may fail. So the new one is
    `program.new` from when it is known to be whole, and replaces the old one then or at the next
    start. `crc` tells the program that is there, 0 without one or when it is damaged, which is
    found out at the start.
    """

    def __init__(self, folder, asleep):
        self._path = folder + "/program"
        self._asleep = asleep
        self._file = None
        self._crc = 0
        self.crc = 0
        try:
            self._tidy()
            self.crc = _crc_in(self._path + ".bin") or 0
        except OSError as error:  # flash that fails is no reason not to start
            sys.print_exception(error)

    def _tidy(self):
        """End what power failed in; what was not whole is no program."""
        _remove(self._path + ".tmp")
        crc = _crc_in(self._path + ".new")
        if crc is None:
            _remove(self._path + ".new")
        else:
            self._replace(crc)

    def begin(self, _size):
        """Make room for a program of so many bytes, or None; it grows while it is written."""
        self.cancel()
        self._tidy()
        self._crc = 0
        self._file = open(self._path + ".tmp", "wb")  # noqa: SIM115 - until `end` or `cancel`

    def write(self, data):
        """Take the next bytes."""
        self._write(data)
        self._crc = binascii.crc32(data, self._crc)

    def end(self):
        """All bytes are there: read them back, and let them take the place of the old program."""
        self._write(self._crc.to_bytes(_CRC_SIZE, "little"))
        self._close()
        if _crc_in(self._path + ".tmp") != self._crc:
            raise OSError("flash does not hold what was written")
        os.rename(self._path + ".tmp", self._path + ".new")
        self._replace(self._crc)

    def cancel(self):
        """Drop what has not ended; nothing of it waits to be written."""
        _check(self._asleep)
        try:
            self._close()
        finally:
            _remove(self._path + ".tmp")

    def _write(self, data):
        _check(self._asleep)
        if self._file is None:
            raise OSError("a program is written from its beginning on")
        if self._file.write(data) != len(data):
            raise OSError("there is no room for the program")

    def _close(self):
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _replace(self, crc):
        self.crc = 0
        _remove(self._path + ".bin")
        os.rename(self._path + ".new", self._path + ".bin")
        self.crc = crc


def _check(asleep):
    if not asleep():
        raise OSError("flash is written only while both bridges sleep")


def _crc_in(path):
    """The CRC-32 that ends a file, None if it is not that of the rest, or there is no file."""
    if not _exists(path):
        return None
    crc = 0
    with open(path, "rb") as file:
        piece = file.read(_PIECE)
        while piece:
            crc = binascii.crc32(piece, crc)
            piece = file.read(_PIECE)
        if crc != _RESIDUE:
            return None
        file.seek(-_CRC_SIZE, 2)
        return int.from_bytes(file.read(_CRC_SIZE), "little")


def _exists(path):
    try:
        os.stat(path)
    except OSError:
        return False
    return True


def _remove(path):
    if _exists(path):
        os.remove(path)
