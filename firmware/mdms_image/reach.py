"""Drops what a cell never uses: definitions that nothing refers to, methods that nobody names."""

import ast
from collections.abc import Iterator

from mdms_image.linker import Program


def drop_unused(program: Program, roots: tuple[str, ...]) -> None:
    """Keep what is reached from the roots; a root that is a class keeps its public methods.

    A method stays if anything that stays has an attribute of its name, on whatever object.
    """
    definitions = program.definitions
    reached: set[str] = set()
    attributes = {name for root in roots for name in public_of(definitions[root])}
    waiting: list[ast.AST] = [ast.Name(root, ast.Load()) for root in roots]
    used: set[str] = set()
    while waiting:
        for node in _parts(waiting.pop()):
            if isinstance(node, ast.Attribute):
                attributes.add(node.attr)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                attributes.add(node.value)
            for name in _names(node):
                used.add(name)
                if name in definitions and name not in reached:
                    reached.add(name)
                    waiting.append(definitions[name])
        if not waiting:
            waiting = list(_woken(definitions, reached, attributes))
    for name in [name for name in definitions if name not in reached]:
        del definitions[name]
    for node in definitions.values():
        if isinstance(node, ast.ClassDef):
            node.body = [each for each in node.body if not _asleep(each)] or [ast.Pass()]
    program.imports = {name: line for name, line in program.imports.items() if name in used}


def public_of(node: ast.stmt) -> list[str]:
    """The public methods of a class, and the attributes that its methods set."""
    if not isinstance(node, ast.ClassDef):
        return []
    return [each for each in attributes_of(node) if is_public(each)]


def is_public(attribute: str) -> bool:
    """Whether others may mean an attribute."""
    return not attribute.rpartition(".")[2].startswith("_")


def attributes_of(node: ast.ClassDef) -> Iterator[str]:
    """The names of a class's members, and of what its methods set."""
    for member in node.body:
        if isinstance(member, ast.FunctionDef):
            yield member.name
        elif isinstance(member, ast.Assign):
            yield from (each.id for each in member.targets if isinstance(each, ast.Name))
    for part in ast.walk(node):
        if isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store):
            yield part.attr


def _names(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Name):
        return [node.id]
    if isinstance(node, ast.ImportFrom):
        return [alias.name for alias in node.names]
    return []


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all in it, but for methods, which sleep until somebody names them."""
    if isinstance(node, ast.ClassDef):
        for each in (*node.bases, *node.body):
            if not isinstance(each, ast.FunctionDef):
                yield from ast.walk(each)
            elif each.name.startswith("__"):
                _wake(each)
                yield from ast.walk(each)
    else:
        yield from ast.walk(node)


def _woken(
    definitions: dict[str, ast.stmt], reached: set[str], attributes: set[str]
) -> Iterator[ast.AST]:
    for name in sorted(reached):
        node = definitions[name]
        if isinstance(node, ast.ClassDef):
            for member in node.body:
                known = isinstance(member, ast.FunctionDef) and member.name in attributes
                if known and _asleep(member):
                    _wake(member)
                    yield member


def _wake(node: ast.stmt) -> None:
    node.awake = True  # type: ignore[attr-defined]


def _asleep(node: ast.stmt) -> bool:
    return isinstance(node, ast.FunctionDef) and not hasattr(node, "awake")
