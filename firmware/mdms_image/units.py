"""Which file a definition goes to: what functions import is loaded and forgotten again."""

import ast
from typing import Any

from mdms_image.linker import Program

#: The file that is loaded at power-up.
MAIN = "mdms"
LOAD = "mdms_image.load"
_LOADER = """
def load(name):
    module = __import__(name)
    del sys.modules[name]
    return module
"""


def assign(program: Program, roots: tuple[str, ...]) -> dict[str, str]:
    """The file of every definition.

    What only one module needs that functions import goes into a file of its own; what several need
    goes into the main file, as does what is needed at once.
    """
    reached = {MAIN: _reached(program, list(roots))}
    for node in program.definitions.values():
        for part in ast.walk(node):
            if isinstance(part, ast.ImportFrom) and part.names[0].name in program.definitions:
                unit = f"{MAIN}_{str(part.module).rpartition('.')[2]}"
                names = [alias.name for alias in part.names]
                reached[unit] = reached.get(unit, set()) | _reached(program, names)
    unit_of = {}
    for name in program.definitions:
        units = [unit for unit, names in reached.items() if name in names]
        unit_of[name] = units[0] if len(units) == 1 else MAIN
    if set(unit_of.values()) - {MAIN}:
        _add_loader(program)
        unit_of[LOAD] = MAIN
    return unit_of


def _reached(program: Program, names: list[str]) -> set[str]:
    """What definitions need at once, themselves included."""
    found: set[str] = set()
    while names:
        name = names.pop()
        if name in program.definitions and name not in found:
            found.add(name)
            walked = ast.walk(program.definitions[name])
            names += [part.id for part in walked if isinstance(part, ast.Name)]
    return found


def _add_loader(program: Program) -> None:
    loader = ast.parse(_LOADER).body[0]
    assert isinstance(loader, ast.FunctionDef)
    loader.name = LOAD
    program.definitions = {LOAD: loader, **program.definitions}
    program.imports["sys"] = ast.Import([ast.alias("sys")])


class LazyImports(ast.NodeTransformer):
    """Turns imports inside functions, when names are short, into what loads another file."""

    def __init__(self, unit_of: dict[str, str], load: str) -> None:
        self._unit_of = unit_of
        self._load = load

    def visit_ImportFrom(self, node: ast.ImportFrom) -> Any:
        """`from file import a as x, b as y` becomes `x = load(file); y = x.b; x = x.a`."""
        (alias,) = node.names
        if alias.name not in self._unit_of:
            return node
        bound = alias.asname or alias.name
        unit = self._unit_of[alias.name]
        if unit == MAIN:
            return ast.parse(f"{bound} = {alias.name}").body
        return ast.parse(f"{bound} = {self._load}({unit!r}).{alias.name}").body
