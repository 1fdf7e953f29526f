"""The array's key, in a file that its owner alone may read; never in the array file itself."""

import hmac
import os
import secrets
import stat
from pathlib import Path

from mdms_protocol.update.codes import KEY_SIZE

_ID = b"MDMS update key"
SUFFIX = ".key"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class KeyFileError(Exception):
    """A key file that cannot be used; the message has why, and the way out."""


def key_beside(array: Path) -> Path:
    """Where the key of an array lies: beside its file."""
    return array.with_suffix(SUFFIX)


def read_key(path: Path) -> bytes:
    """The key in a file of 64 hex digits. Raises KeyFileError."""
    try:
        if os.name == "posix" and path.stat().st_mode & _OTHERS:
            raise KeyFileError(f"{path}: others may read this key; chmod 600 {path}")
        key = bytes.fromhex(path.read_text(encoding="ascii").strip())
    except OSError as error:
        raise KeyFileError(f"{path}: {error.strerror}") from None
    except ValueError:
        key = b""
    if len(key) != KEY_SIZE:
        raise KeyFileError(f"{path}: expected {2 * KEY_SIZE} hex digits")
    return key


def make_key(path: Path) -> bytes:
    """A new key in a new file. Raises OSError, FileExistsError for one that is there."""
    key = secrets.token_bytes(KEY_SIZE)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, stat.S_IRUSR | stat.S_IWUSR)
    with open(descriptor, "w", encoding="ascii") as file:
        file.write(key.hex() + "\n")
    return key


def key_id(key: bytes) -> bytes:
    """Four bytes that stand for a key, as cells report it (0x3030:2)."""
    return hmac.digest(key, _ID, "sha256")[:4]
