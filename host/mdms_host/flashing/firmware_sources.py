"""The modules of the firmware that run on a board, found by following what `main.py` imports.

They are read, never imported: most of them need a board.
"""

import ast
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from mdms_host.flashing.parsing import tree_of

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
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


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
