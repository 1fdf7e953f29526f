"""The files of a board's flash file system."""

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path

from mdms_image.compiler import ImageError, compile_source
from mdms_image.sources import imported, source_of

#: Stand-ins that the builds for these boards need, by the name under which they are imported.
_STAND_INS = {"nucleo_g474re": {"binascii": "boards.binascii_crc32"}}

#: The boards that there are images for, and the architecture of their machine code.
BOARDS = {"pybv11": "armv7emsp", "nucleo_g474re": "armv7emsp"}


@dataclass(frozen=True, slots=True)
class Image:
    """What lies in an image's folder: its files, relative to it, and how they add up.

    `version` tells images apart by their contents; `size` is in bytes.
    """

    files: tuple[Path, ...]
    version: str
    size: int


def build_image(folder: Path, board: str = "pybv11") -> Image:
    """Fill a folder, which is made anew, with the files of a board's flash.

    Raises ImageError for an unknown board and where mpy-cross is missing.
    """
    if board not in BOARDS:
        raise ImageError(f"there is no board {board!r}; there are {', '.join(BOARDS)}")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    shutil.copy(source_of("main"), folder / "main.py")
    for name in imported("main"):
        if name != "main":
            _compile(name, folder / f"{name.replace('.', '/')}.mpy", BOARDS[board])
    for stand_in, name in _STAND_INS.get(board, {}).items():
        _compile(name, folder / f"{stand_in}.mpy", BOARDS[board])
    return image_of(folder)


def image_of(folder: Path) -> Image:
    """The image that lies in a folder."""
    files = tuple(sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file()))
    digest = hashlib.sha256()
    size = 0
    for file in files:
        content = (folder / file).read_bytes()
        size += len(content)
        digest.update(f"{file.as_posix()}\0{len(content)}\0".encode() + content)
    return Image(files, digest.hexdigest()[:12], size)


def _compile(name: str, target: Path, architecture: str) -> None:
    target.parent.mkdir(exist_ok=True)
    source = source_of(name).read_text(encoding="utf-8")
    target.write_bytes(compile_source(source, name, architecture))
