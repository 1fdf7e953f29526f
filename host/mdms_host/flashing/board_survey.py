"""The kind of a board, and the files of the firmware on it, with their hashes.

The probe is MicroPython that a board runs at its prompt to answer questions about itself.
"""

import hashlib
from binascii import crc32
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from textwrap import dedent

from mdms_host.flashing.board_link import BoardError, BoardLink
from mdms_host.flashing.firmware import START, Firmware

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
        return told._machine, tuple(told.version[:3]), told._mpy, chip, _root, os.getcwd()

    def _version(path):
        before = sys.path[:]
        sys.path[:] = path
        try:
            from mdms_protocol.version import VERSION
            return VERSION
        except ImportError:
            return None
        except Exception:
            return ""
        finally:
            sys.path[:] = before
            for name in ("mdms_protocol.version", "mdms_protocol"):
                sys.modules.pop(name, None)

    def _rom():
        try:
            import vfs
        except ImportError:
            return None
        if not hasattr(vfs, "rom_ioctl") or vfs.rom_ioctl(1) < 1:
            return None
        found = vfs.rom_ioctl(2, 0)
        return None if isinstance(found, int) else found

    def _rom_size():
        rom = _rom()
        if rom is None:
            return 0
        return rom.ioctl(4, 0) * rom.ioctl(5, 0) if hasattr(rom, "ioctl") else len(rom)

    def _rom_names():
        try:
            return os.listdir("/rom")
        except (OSError, ValueError):  # none, or a name that was cut while it was written
            return []

    def _rom_hash(size):
        import hashlib
        return hashlib.sha256(memoryview(_rom())[:size]).digest()

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
        each, buffer = [], memoryview(bytearray(512))
        for path in paths:
            one = hashlib.sha256()
            with open(_root + "/" + path, "rb") as file:
                count = file.readinto(buffer)
                while count:
                    one.update(buffer[:count])
                    count = file.readinto(buffer)
            _feed()
            each.append(one.digest())
        return each
    """)


def teach(link: BoardLink) -> None:
    """Define the functions of the questions on the board; a reset takes them away."""
    link.run(_PROBE)


#: What the name of the machine contains, as `boards/detect.py` distinguishes boards.
MACHINES = {
    "Teensy 4.1": "teensy41",
    "WEACTSTUDIO_MINI_STM32H743": "weact_h743",
    "PYBv1.1": "pybv11",
    "G474": "nucleo_g474re",
}
#: The place where MicroPython looks for its frozen modules.
FROZEN = ".frozen"
#: As `sys.implementation._mpy` numbers them, and mpy-cross calls them.
ARCHITECTURES = (
    *(None, "x86", "x64", "armv6", "armv6m", "armv7m", "armv7em", "armv7emsp", "armv7emdp"),
    *("xtensa", "xtensawin", "rv32imc", "rv64imc"),
)
#: Files that firmware of any version has put into the root of the file system.
_OURS = ("main", "boards", "binascii")
_OUR_PREFIX = "mdms"
#: The record of the slots. It stays as the key does: without its counter a cell would take a bundle
#: again that was used before.
_RECORD = "mdms_slots/record"
_UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class BoardInfo:
    """A board's statement about itself; `board` is None where there is no firmware for it.

    `mpy` is that entry of `sys.implementation`, `heap` the free bytes of its heap after a reset,
    and `frozen` the version of the firmware that is frozen into its MicroPython. `rom_size` is the
    size of its ROMFS partition [bytes], 0 without one, and `rom_names` are the files in the root of
    that.
    """

    machine: str
    board: str | None
    micropython: tuple[int, ...]
    mpy: int
    chip: str
    root: str
    folder: str
    heap: int = 0
    frozen: str | None = None
    rom_size: int = 0
    rom_names: tuple[str, ...] = ()

    @property
    def serial(self) -> str | None:
        """The serial number that its cell has on the bus (0x1018:4), None without a chip's own."""
        return f"{crc32(bytes.fromhex(self.chip)):08X}" if self.chip else None

    @property
    def release(self) -> str:
        """MicroPython's version as people write it."""
        return ".".join(map(str, self.micropython))

    @property
    def architecture(self) -> str | None:
        """The machine code that it loads from `.mpy` files, as mpy-cross calls it."""
        number = self.mpy >> 10 & 0xF
        return ARCHITECTURES[number] if number < len(ARCHITECTURES) else None

    @property
    def rom_is_ours(self) -> bool:
        """Whether its ROMFS holds nothing but firmware."""
        return all(map(_is_ours, self.rom_names))


@dataclass(frozen=True, slots=True)
class Survey:
    """The firmware's files on a board, by path, with their SHA-256.

    `version` is None where `main.py` is missing, so that nothing starts at power-up; `rom` says
    whether the ROMFS holds the image that was asked for, or none was.
    """

    hashes: Mapping[str, bytes]
    version: str | None
    rom: bool = True

    def has(self, firmware: Firmware) -> bool:
        """Whether these very files lie on the board, and no others of the firmware."""
        return self.rom and dict(self.hashes) == hashes_of(firmware)


def hashes_of(firmware: Firmware) -> dict[str, bytes]:
    """SHA-256 of the files by path."""
    return {path: hashlib.sha256(data).digest() for path, data in firmware.files.items()}


def identify(link: BoardLink) -> BoardInfo:
    """The board at the other end, then ready for all other questions. Raises BoardError."""
    link.run("import gc")
    heap = link.ask("(gc.collect(), gc.mem_free())[1]")
    teach(link)
    machine, release, mpy, chip, root, folder = link.ask("_who()")
    board = next((name for part, name in MACHINES.items() if part in machine), None)
    frozen = link.ask(f"_version([{FROZEN!r}])")
    rom_size, rom_names = link.ask("(_rom_size(), _rom_names())")
    return BoardInfo(
        machine,
        board,
        tuple(release),
        mpy,
        chip.hex(),
        root,
        folder,
        heap=heap,
        frozen=_UNKNOWN if frozen == "" else frozen,
        rom_size=rom_size,
        rom_names=tuple(rom_names),
    )


def survey(link: BoardLink, firmware: Firmware | None = None) -> Survey:
    """Which files of firmware of any version lie on a board that was identified.

    `firmware` adds the roots of its own files to those looked for. Raises BoardError.
    """
    wanted = firmware or Firmware({})
    roots = {_root_of(path) for path in wanted.files}
    paths = [
        path
        for path in link.ask("_files('', [])")
        if (_root_of(path) in roots or _is_ours(path)) and path != _RECORD
    ]
    paths.sort(key=lambda path: path.split("/"))
    try:
        each = link.ask(f"_hashes({paths!r})")
    except BoardError as error:
        if "hashlib" not in str(error):
            raise
        each = _hashes_here(link, paths)
    version = (link.ask("_version(sys.path[:])") or _UNKNOWN) if START in paths else None
    return Survey(dict(zip(paths, each, strict=True)), version, _has_rom(link, wanted.rom))


def _has_rom(link: BoardLink, image: bytes | None) -> bool:
    if image is None:
        return True
    return bool(link.ask(f"_rom_hash({len(image)})") == hashlib.sha256(image).digest())


def _is_ours(path: str) -> bool:
    return _root_of(path) in _OURS or path.startswith(_OUR_PREFIX)


def _root_of(path: str) -> str:
    """The first part of a path without any suffix: its name for an import."""
    return path.partition("/")[0].partition(".")[0]


def _hashes_here(link: BoardLink, paths: Iterable[str]) -> list[bytes]:
    """For a build of MicroPython without `hashlib`: the files are read, and hashed on the host."""
    root = link.ask("_root")
    return [hashlib.sha256(link.read(f"{root}/{path}")).digest() for path in paths]
