"""Files that verbs write, and never over somebody else's.

They are whole or not there. The folder of a run on a table has all that the disk took.
"""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mdms_host.cli.exits import CommandError, ExitCode

#: Faults of a given path, and not of the device behind it.
_BAD_PLACES = frozenset(
    (
        *(errno.ENOENT, errno.EEXIST, errno.ENOTDIR, errno.EISDIR),
        *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG),
    )
)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns an `OSError` inside into a `CommandError` that names the path.

    A place without permission to write is bad input; a full or broken one is a failure.
    """
    try:
        yield
    except OSError as error:
        code = ExitCode.USAGE if error.errno in _BAD_PLACES else ExitCode.FAILURE
        raise CommandError(f"{path}: cannot be written: {error.strerror}", code) from None


def written(
    folder: Path, write: Callable[[], object], put_in_place: Callable[[], object]
) -> CommandError | None:
    """Have the rest of a folder written, which else stays as it is, and have it take its place.

    Returns the last error, None if there was none.
    """
    incomplete = None
    try:
        with writing(folder):
            write()
    except CommandError as error:
        incomplete = CommandError(f"{error}; only what was written before is there", error.code)
    try:
        with writing(folder):
            put_in_place()
    except CommandError as error:
        return error
    return incomplete


def check_own(path: Path, mark: bytes, force: bool) -> None:
    """Raise `CommandError` for a file that is there and that this verb has not written.

    `mark` stands in every file that it writes.
    """
    if force or not path.is_file():
        return
    with writing(path):
        own = mark in path.read_bytes()
    if not own:
        raise CommandError(
            f"{path}: is there already, and was not written by this verb; "
            "--force overwrites it, or give another name",
            ExitCode.USAGE,
        )


@contextmanager
def replacing(path: Path, mark: bytes, force: bool) -> Iterator[Path]:
    """A file beside `path` to write, with its suffix; it takes its place at the end, or vanishes.

    A terminal or a pipe, which is no plain file, is written as it is. Raises `CommandError`.
    """
    check_own(path, mark, force)
    if path.exists() and not path.is_file():
        with writing(path):
            yield path
        return
    # A link stays, and leads to the new file.
    place = Path(os.path.realpath(path))
    partial = place.with_name(f".{os.getpid()}-partial-{path.name}")
    try:
        with writing(path):
            yield partial
            partial.replace(place)
    finally:
        with suppress(OSError):
            partial.unlink()
