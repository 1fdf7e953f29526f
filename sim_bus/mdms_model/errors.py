"""Errors that a user can mend: each is one line with the value, the limit and the way out."""

from os import PathLike
from pathlib import Path


class Error(Exception):
    """Base of all errors that a user of the packages can do something about."""


class InputError(Error, ValueError):
    """A scenario, a file, a program or an argument that cannot be used."""


def check_path(name: str, path: object) -> Path:
    """A path that a caller gives. Raises `InputError` for anything else."""
    if not isinstance(path, str | PathLike):
        raise InputError(f"{name} is {path!r:.60}, but must be a path, as text or a Path")
    return Path(path)
