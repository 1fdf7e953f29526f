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
    found = {MAIN: reached(program, list(roots))}
    for module, names in imported_later(program).items():
        found[f"{MAIN}_{module.rpartition('.')[2]}"] = reached(program, names)
    unit_of = {}
    for name in program.definitions:
        units = [unit for unit, names in found.items() if name in names]
        unit_of[name] = units[0] if len(units) == 1 else MAIN
    if set(unit_of.values()) - {MAIN}:
        _add_loader(program)
        unit_of[LOAD] = MAIN
    return unit_of


def imported_later(program: Program) -> dict[str, list[str]]:
    """The definitions that functions import, by their modules."""
    found: dict[str, list[str]] = {}
    for node in program.definitions.values():
        for part in ast.walk(node):
            if isinstance(part, ast.ImportFrom) and part.names[0].name in program.definitions:
                names = found.setdefault(str(part.module), [])
                names += [alias.name for alias in part.names]
    return found


def reached(program: Program, names: list[str]) -> set[str]:
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
    """Turns imports inside functions into what loads another file."""

    def __init__(self, unit_of: dict[str, str]) -> None:
        self._unit_of = unit_of

    def visit_ImportFrom(self, node: ast.ImportFrom) -> Any:
        """`from module import name as bound` becomes `bound = load(file).name`."""
        (alias,) = node.names
        if alias.name not in self._unit_of:
            return node
        value: ast.expr = ast.Name(alias.name, ast.Load())
        unit = self._unit_of[alias.name]
        if unit != MAIN:
            loaded = ast.Call(ast.Name(LOAD, ast.Load()), [ast.Constant(unit)], [])
            value = ast.Attribute(loaded, alias.name, ast.Load())
        return ast.Assign([ast.Name(alias.asname or alias.name, ast.Store())], value)
