"""Where the sources of the firmware lie, in a checkout as well as in an installed wheel."""

import ast
from importlib.util import find_spec
from pathlib import Path

#: The packages that a board imports.
PACKAGES = ("boards", "mdms_cell", "mdms_protocol")
#: What stands in on CPython for what MicroPython has built in.
_STAND_INS = {"mdms_cell.cpython"}

_HERE = Path(__file__).parent
#: In a wheel `boards` and `main.py` lie inside this package, in a checkout beside it.
_FLASHED = _HERE / "flashed" if (_HERE / "flashed").is_dir() else _HERE.parent


def source_of(name: str) -> Path:
    """The file of a module, `main` or one of the packages'; it may be missing."""
    package, _, module = name.partition(".")
    if package in ("main", "boards"):
        return _FLASHED / f"{name.replace('.', '/')}.py"
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"there is no package {package}")
    return Path(spec.origin).parent / f"{module or '__init__'}.py"


def imported(name: str) -> list[str]:
    """The modules that a module needs on a board, directly or by others, itself included."""
    found: list[str] = []
    waiting = [name]
    while waiting:
        each = waiting.pop()
        if each not in found:
            found.append(each)
            waiting.extend(_imports(ast.parse(source_of(each).read_text(encoding="utf-8"))))
    return sorted(found)


def _imports(tree: ast.Module) -> list[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return [name for name in names if _is_ours(name)]


def _is_ours(name: str) -> bool:
    package, _, module = name.partition(".")
    return (
        package in PACKAGES
        and bool(module)
        and name not in _STAND_INS
        and (source_of(name).is_file())
    )
