"""The files of a board's flash file system."""

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path

from mdms_image.compiler import ImageError, compile_source
from mdms_image.linker import START
from mdms_image.merge import Merged, merge
from mdms_image.narrow import narrow
from mdms_image.sources import source_of

#: The boards that there are images for, and the architecture of their machine code.
BOARDS = {"pybv11": "armv7emsp", "nucleo_g474re": "armv7emsp"}
#: What is compiled in place of modules that a board's build leaves out.
_STAND_INS = {"nucleo_g474re": {"binascii": "boards.binascii_crc32"}}
#: Classes whose public attributes keep their names, which is how the image is tried out.
_LENT = ("mdms_cell.cell.Cell", "mdms_cell.inbox.Inbox", "mdms_cell.runner.Runner")
_MAIN = "from mdms import start\n\nstart()\n"


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

    Raises ImageError for an unknown board, where mpy-cross is missing, and for sources that cannot
    be merged.
    """
    if board not in BOARDS:
        raise ImageError(f"there is no board {board!r}; there are {', '.join(BOARDS)}")
    return write_image(folder, board, BOARDS[board])


def write_image(folder: Path, board: str, architecture: str | None) -> Image:
    """As `build_image`, for another processor; without an architecture all is bytecode."""
    sources = merged(board, emits=architecture is not None).sources
    for stand_in, name in _STAND_INS.get(board, {}).items():
        sources[stand_in] = source_of(name).read_text(encoding="utf-8")
    compiled = {
        f"{name}.mpy": compile_source(narrow(source, architecture), name, architecture)
        for name, source in sources.items()
    }
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in {"main.py": _MAIN.encode(), **compiled}.items():
        (folder / name).write_bytes(content)
    return image_of(folder)


def merged(board: str, *, emits: bool) -> Merged:
    """The merged sources of a board's image."""
    others = tuple(f"boards.{each}" for each in BOARDS if each != board)
    return merge("main", {START: "start"}, emits=emits, lent=_LENT, skip=others)


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
