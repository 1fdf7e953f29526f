"""Log files of a command that runs for weeks: rotated by size, opened again on SIGHUP.

A full or broken disk ends no run: what cannot be written is dropped, and said once.
"""

import os
from collections.abc import Callable
from contextlib import suppress
from errno import ENOSPC
from io import FileIO
from pathlib import Path

try:
    import fcntl
except ModuleNotFoundError:
    # Windows has none.
    fcntl = None  # type: ignore[assignment]

from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.clock import wall_text

EVENTS, FRAMES, LOCK = "events.log", "bus.log", ".lock"
#: Bytes of a file, and how many of them are kept; frames of 18 cells come to 170 kB/s.
EVENT_BYTES, EVENT_FILES = 1_000_000, 10
FRAME_BYTES, FRAME_FILES = 64_000_000, 16
#: Lines go to the operating system when they are so many bytes.
_AT_ONCE_BYTES = 8192


class RotatingFile:
    """A text file that gives way to a new one when it is full: `NAME`, `NAME.1`, ... `NAME.N`.

    `failed(text)` is called when the disk takes no more, once until it does again.
    """

    def __init__(
        self,
        path: Path,
        most_bytes: int,
        most_files: int,
        failed: Callable[[str], object] = lambda _text: None,
    ) -> None:
        self.path = path
        self._most_bytes = most_bytes
        self._most_files = most_files
        self._failed = failed
        self._has_failed = False
        self._file: FileIO | None = None
        #: Lines that wait for the file.
        self._lines = bytearray()
        self._size = 0

    def write(self, text: str) -> None:
        """Append whole lines."""
        lines = text.encode(errors="backslashreplace")
        try:
            size = self._size + len(self._lines) + len(lines)
            if self._file is not None and size > self._most_bytes:
                self._rotate()
            if self._file is None:
                self._file = self.path.open("ab", buffering=0)
                self._size = self._file.tell()
        except OSError as error:
            self._fail(error)
        else:
            self._lines += lines
            if len(self._lines) >= _AT_ONCE_BYTES:
                self.flush()

    def flush(self) -> None:
        """Hand the written lines to the operating system, all of them or none."""
        lines, self._lines = self._lines, bytearray()
        if self._file is None or not lines:
            return
        try:
            if self._file.write(lines) != len(lines):
                # Half a line would spoil the next one.
                self._file.truncate(self._size)
                raise OSError(ENOSPC, os.strerror(ENOSPC))
        except OSError as error:
            self._fail(error)
        else:
            self._size += len(lines)
            # A file that could not give way is written, too.
            self._has_failed &= self._size > self._most_bytes

    def reopen(self) -> None:
        """Close the file: the next line opens that of this name, another where it was moved."""
        self.flush()
        file, self._file = self._file, None
        if file is not None:
            with suppress(OSError):
                file.close()

    def _fail(self, error: OSError) -> None:
        self.reopen()
        if not self._has_failed:
            self._has_failed = True
            self._failed(f"{self.path}: cannot be written: {error.strerror}")

    def _rotate(self) -> None:
        self.reopen()
        for number in range(self._most_files - 1, 0, -1):
            older = self._numbered(number - 1)
            if older.exists():
                older.replace(self._numbered(number))

    def _numbered(self, number: int) -> Path:
        return self.path if not number else self.path.with_name(f"{self.path.name}.{number}")


class LogFolder:
    """The files of one command in a folder: its events, each with the time of day, and frames.

    Raises `CommandError` for a folder that another command writes, or that cannot be written.
    """

    def __init__(self, folder: Path, failed: Callable[[str], object]) -> None:
        self.folder = folder
        self._lock = locked(folder, LOCK, "--log-dir")
        self.events = RotatingFile(folder / EVENTS, EVENT_BYTES, EVENT_FILES, failed)
        self.frames = RotatingFile(folder / FRAMES, FRAME_BYTES, FRAME_FILES, failed)

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Append an event: the time of day, the time of the run, and one line."""
        line = " ".join(text.split())
        self.events.write(f"{wall_text()} {time_s:.3f} {kind}: {line}\n")
        self.events.flush()

    def reopen(self) -> None:
        """Go on in files of the usual names."""
        self.events.reopen()
        self.frames.reopen()

    def close(self) -> None:
        """Close both files, and leave the folder to others."""
        self.reopen()
        os.close(self._lock)


def locked(folder: Path, name: str, option: str) -> int:
    """A descriptor that keeps other commands away as long as it is open: a lock in a folder.

    Raises `CommandError` where another command has it, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / name, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise CommandError(
            f"{option} {folder}: cannot be written: {error.strerror}", ExitCode.USAGE
        ) from None
    try:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise CommandError(
            f"{option} {folder}: another command writes there; give each a folder of its own",
            ExitCode.USAGE,
        ) from None
    return lock
