"""Images in place of the packages that they are made of, for tests that know only the packages."""

import ast
import shutil
from pathlib import Path

from mdms_image.compiler import compile_source
from mdms_image.constants import inline
from mdms_image.image import merged, write_image
from mdms_image.linker import link
from mdms_image.merge import merge
from mdms_image.narrow import narrow
from mdms_image.sources import imported, source_of
from mdms_image.trim import trim
from mdms_sim.nodes.micropython_process import EMITTER_LINE

BOARD = "pybv11"
FAKES = tuple(
    Path(__file__).parent / "fakes" / f"{name}.py" for name in ("machine", "pyb", "world")
)
SKIP = ("boards.nucleo_g474re",)
_ABORT = "mdms_protocol.sdo.AbortError"


def flashed(folder: Path, architecture: str | None) -> None:
    """The files of a board's flash, faked peripherals, and what tests import of the cell.

    The module `started` does what `main` does before its loop, with node id 5.
    """
    shutil.copytree(source_of("mdms_protocol.cob").parent, folder / "mdms_protocol")
    write_image(folder / "flash", BOARD, architecture)
    for path in (folder / "flash").glob("*.mpy"):
        path.rename(folder / path.name)
    for path in FAKES:
        shutil.copy(path, folder)
    package = folder / "mdms_cell"
    package.mkdir()
    names = merged(BOARD, emits=architecture is not None).names
    for name in ("Cell", "Inbox", "Runner"):
        full = f"mdms_cell.{name.lower()}.{name}"
        (package / f"{name.lower()}.py").write_text(
            f"import mdms, mdms_start\n\ndef {name}(*given):\n"
            f"    return mdms_start.{names[full + '.__init__']}(mdms.{names[full]}(), *given)\n"
        )
    source = source_of("mdms_cell.drive.speed_loop").read_text()
    (package / "speed_loop.py").write_text(EMITTER_LINE.sub("", source))
    load = f"mdms.{names['mdms_image.load']}('mdms_start')"
    (folder / "started.py").write_text(
        f"import mdms\n\nboard = {load}.{names[f'boards.{BOARD}.board']}('.')\n"
        f"cell, runner = {load}.{names['boards.start.cell_on']}(board, 5)\n"
        "board.start(runner.tick)\n"
    )


def tested(folder: Path, architecture: str | None, tests: Path) -> None:
    """An image with the public names of the modules that tests import, and modules that lend them.

    What those need besides is hidden, as on a board.
    """
    program = link(imported("main", SKIP))
    trim(program.definitions, emits=architecture is not None)
    inline(program)
    modules = sorted(_imported_by(tests))
    roots = {
        name: name.replace(".", "_")
        for name in program.definitions
        if name == _ABORT or (name.rpartition(".")[0] in modules and "._" not in name)
    }
    emits = architecture is not None
    made = merge("main", roots, emits=emits, public=False, skip=SKIP)
    write(folder, made.sources, architecture)
    shutil.copytree(source_of("mdms_protocol.cob").parent, folder / "mdms_protocol")
    (folder / "mdms_cell").mkdir()
    for module in modules:
        constants = _of(module, made.constants)
        lines = [f"{name} = {value!r}" for name, value in constants.items()]
        lines += [
            f"from mdms import {roots[f'{module}.{name}']} as {name}" for name in _of(module, roots)
        ]
        (folder / f"{module.replace('.', '/')}.py").write_text("\n".join([*lines, ""]))
    with (folder / "mdms_protocol" / "sdo.py").open("a") as file:
        file.write(f"from mdms import {roots[_ABORT]} as AbortError\n")


def write(folder: Path, sources: dict[str, str], architecture: str | None = None) -> None:
    """Compile sources into a new folder."""
    folder.mkdir()
    for unit, source in sources.items():
        narrowed = narrow(source, architecture)
        (folder / f"{unit}.mpy").write_bytes(compile_source(narrowed, unit, architecture))


def _imported_by(tests: Path) -> set[str]:
    """The modules of `mdms_cell` that the files in a folder import from."""
    found = set()
    for path in tests.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module == "mdms_cell":
                found |= {f"mdms_cell.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and str(node.module).startswith("mdms_cell."):
                found.add(str(node.module))
    return found


def _of(module: str, names: dict[str, object]) -> dict[str, object]:
    """Of full names, those of a module, as they are called there."""
    return {
        name.rpartition(".")[2]: value
        for name, value in names.items()
        if name.rpartition(".")[0] == module
    }
