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


def imported(entry: str, skip: tuple[str, ...] = ()) -> list[str]:
    """The modules that a module needs on a board, itself included, in the order of execution.

    What functions import comes after what is imported at once; modules in `skip` are left out.
    """
    found: dict[str, None] = {}
    waiting = [entry]
    while waiting:
        name = waiting.pop(0)
        if name not in found:
            waiting += _collect(name, found, skip)
    return list(found)


def _collect(name: str, found: dict[str, None], skip: tuple[str, ...]) -> list[str]:
    """Add a module after those that it imports at once; returns those that functions import."""
    tree = ast.parse(source_of(name).read_text(encoding="utf-8"))
    later = []
    for node in tree.body:
        for each in _imports(node):
            if each in skip:
                continue
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                later.append(each)
            elif each not in found:
                later += _collect(each, found, skip)
    found[name] = None
    return later


def _imports(tree: ast.AST) -> list[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return [name for name in names if is_ours(name)]


def is_ours(name: str) -> bool:
    """Whether a name is that of a module of ours."""
    package, _, module = name.partition(".")
    return (
        package in PACKAGES
        and bool(module)
        and name not in _STAND_INS
        and (source_of(name).is_file())
    )
