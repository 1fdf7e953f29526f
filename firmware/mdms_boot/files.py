"""The files of firmware over the bus, in a board's file system.

On LittleFS a file keeps its contents until it is closed. `rename` is done or not done, whenever the
supply fails.
"""

import os

from deflate import ZLIB, DeflateIO

_PIECE = 1024
_FRESH = ".new"


class Files:
    """Files under `root`, by their paths; what changes them raises OSError where it cannot."""

    def __init__(self, root):
        self._root = root + "/"

    def size(self, path):
        """Bytes in a file; OSError if there is none."""
        return os.stat(self._root + path)[6]

    def read(self, path):
        """The bytes of a small file."""
        with open(self._root + path, "rb") as file:
            return file.read()

    def unpack(self, path):
        """Return the unpacked contents of a file: its size (u32), and then a zlib stream."""
        with open(self._root + path, "rb") as file:
            image = bytearray(int.from_bytes(file.read(4), "little"))
            stream, view, at = DeflateIO(file, ZLIB), memoryview(image), 0
            while at < len(image):
                count = stream.readinto(view[at:])
                if not count:
                    raise OSError("a file is shorter than it says")
                at += count
        return image

    def check(self, path, hash_):
        """Update `hash_` with all of a file, a piece at a time."""
        piece = memoryview(bytearray(_PIECE))
        with open(self._root + path, "rb") as file:
            count = file.readinto(piece)
            while count:
                hash_.update(piece[:count])
                count = file.readinto(piece)

    def create(self, path):
        """A new file, open to be written, in a folder that is made where it is missing."""
        if "/" in path:
            _quietly(os.mkdir, self._root + path[: path.index("/")])
        return open(self._root + path, "wb")

    def replace(self, path, data):
        """Give a file other content, all of it or nothing."""
        with self.create(path + _FRESH) as file:
            file.write(data)
        os.rename(self._root + path + _FRESH, self._root + path)

    def remove(self, path):
        """Remove a file, if it is there."""
        _quietly(os.remove, self._root + path)


def _quietly(change, path):
    """Make a change that may have been made before."""
    try:
        change(path)
    except OSError:
        return
