"""Gives short names to what only the image itself names; each name costs a board memory.

Definitions and parameters get them always. An attribute does if it is private, or if it is set or
defined in the image and nothing outside can mean it: neither MicroPython's own types, nor the
peripherals that the boards use, nor a string, nor who calls the cell by its interface.
"""

import array
import ast
import binascii
import builtins
import keyword
import struct
import sys
from collections.abc import Iterator
from itertools import count, product
from string import ascii_lowercase
from typing import Any

from mdms_image.compiler import ImageError
from mdms_image.linker import Program
from mdms_image.privacy import families
from mdms_image.reach import is_public, public_of
from mdms_image.scopes import Scoped, bound_names
from mdms_image.sources import source_of

_LETTERS = ascii_lowercase + ascii_lowercase.upper()
#: What reaches beyond the image: a public attribute that these modules use stays as it is.
_HARDWARE = ("main", "boards")
_TYPES = (int, str, bytes, bytearray, memoryview, list, tuple, dict, set, Exception, array.array)
_FOREIGN = {
    name for each in (*_TYPES, array, binascii, struct, sys, builtins) for name in dir(each)
}


def _short() -> Iterator[str]:
    for length in count(1):
        for letters in product(_LETTERS, repeat=length):
            name = "".join(letters)
            if not keyword.iskeyword(name) and name not in _FOREIGN:
                yield name


class _Keywords(ast.NodeVisitor):
    """Collects what must stay: keywords of calls, strings, and attributes of the hardware."""

    def __init__(self) -> None:
        self.keywords: set[str] = set()
        self.strings: set[str] = set()

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg is not None:
            self.keywords.add(node.arg)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self.strings.add(node.value)


class _Renamer(Scoped):
    def __init__(
        self, names: dict[str, str], attributes: dict[str, str], keep: set[str], pool: list[str]
    ) -> None:
        super().__init__()
        self._names = names
        self._attributes = attributes
        self._keep = keep
        self._pool = pool

    def scope(self, node: ast.AST) -> Any:
        taken = sum(len(each) for each in self._scopes)
        names = list(bound_names(node))
        free = iter(self._pool[taken:])
        return {name: name if name in self._keep else next(free) for name in names}

    def _renamed(self, name: str) -> str:
        for scope in reversed(self._scopes):
            if name in scope:
                return str(scope[name])
        if "." in name and name not in self._names:
            raise ImageError(f"{name} is used but not in the image")
        return self._names.get(name, name)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        node.id = self._renamed(node.id)
        return node

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.arg = self._renamed(node.arg)
        return self.generic_visit(node)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        if node.name is not None:
            node.name = self._renamed(node.name)
        return self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if "." in node.attr and node.attr not in self._attributes and node.attr not in self._names:
            raise ImageError(f"{node.attr} is used but not in the image")
        node.attr = self._attributes.get(node.attr, self._names.get(node.attr, node.attr))
        return self.generic_visit(node)

    def visit_alias(self, node: ast.alias) -> ast.AST:
        bound = self._renamed(node.asname or node.name)
        name = self._names.get(node.name, node.name)
        node.name, node.asname = name, None if bound == name else bound
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.name = self._names[node.name]
        node.bases = [self.visit(each) for each in node.bases]
        for each in node.body:
            if isinstance(each, ast.Assign):
                for target in each.targets:
                    assert isinstance(target, ast.Name)
                    target.id = self._attributes.get(target.id, target.id)
                each.value = self.visit(each.value)
            else:
                self.visit(each)
                if isinstance(each, ast.FunctionDef):
                    each.name = self._attributes.get(each.name, each.name)
        return node

    def _visit_inside(self, node: ast.AST) -> Any:
        made = super()._visit_inside(node)
        if isinstance(node, ast.FunctionDef):
            if len(self._scopes) > 1:
                node.name = next(
                    scope[node.name] for scope in self._scopes[-2::-1] if node.name in scope
                )
            else:
                node.name = self._names.get(node.name, node.name)
        return made


def shorten(
    program: Program,
    roots: dict[str, str],
    lent: tuple[str, ...],
    unit_of: dict[str, str],
    *,
    public: bool,
) -> dict[str, str]:
    """Rename in place; returns what the definitions are called now.

    `roots` tells what definitions that others use are to be called, `lent` are classes besides that
    they know. With `public`, attributes are renamed that are not private.
    """
    kept = _Keywords()
    for node in program.definitions.values():
        kept.visit(node)
    outside = set(program.imports) | kept.keywords | set(roots.values())
    pool = [name for name, _ in zip(_short(), range(2000), strict=False) if name not in outside]
    below = max(_locals(node) for node in program.definitions.values())
    names = _of_definitions(program, roots, unit_of, pool[below:])
    known = (*roots, *lent)
    renamer = _Renamer(names, _attributes(program, kept, known, pool, public), kept.keywords, pool)
    for node in program.definitions.values():
        renamer.visit(node)
    return names


def _of_definitions(
    program: Program, roots: dict[str, str], unit_of: dict[str, str], pool: list[str]
) -> dict[str, str]:
    """The short names of definitions: files share them, but for what one takes from the other."""
    names = dict(roots)
    for unit in sorted(set(unit_of.values())):
        own = [name for name in program.definitions if unit_of[name] == unit]
        named = {
            part.id
            for name in own
            for part in ast.walk(program.definitions[name])
            if isinstance(part, ast.Name)
        }
        taken = {names[name] for name in named if name in names}
        free = (name for name in pool if name not in taken)
        names.update((name, next(free)) for name in own if name not in names)
    return names


def _attributes(
    program: Program, kept: _Keywords, known: tuple[str, ...], pool: list[str], public: bool
) -> dict[str, str]:
    """The short names of attributes: classes that are no relatives use the same ones."""
    fixed = kept.strings | _hardware()
    for name in known:
        own = program.attributes.get(name, [])
        fixed.update(each for each in own if is_public(each))
    groups = families(program)
    shared = [
        name
        for name in groups.pop("")
        if name not in fixed
        and not name.startswith("__")
        and (name.startswith("_") or (public and name not in _FOREIGN))
    ]
    found = dict(zip(shared, pool, strict=False))
    for group in groups.values():
        found.update(zip(group, pool[len(shared) :], strict=False))
    return found


def _locals(node: ast.AST) -> int:
    """The most local names that any function in a node and those around it have."""
    inside = max((_locals(each) for each in ast.iter_child_nodes(node)), default=0)
    if isinstance(node, ast.FunctionDef | ast.Lambda | ast.ListComp | ast.GeneratorExp):
        return inside + len(bound_names(node))
    if isinstance(node, ast.SetComp | ast.DictComp):
        return inside + len(bound_names(node))
    return inside


def known_outside(program: Program, classes: tuple[str, ...]) -> set[str]:
    """The attributes that others than the image may mean, who know these classes."""
    found = _hardware() | _FOREIGN
    for name in classes:
        found.update(public_of(program.definitions[name]))
    return found


def _hardware() -> set[str]:
    """The public attributes that the boards' sources name."""
    names: set[str] = set()
    for path in (source_of("main"), *sorted(source_of("boards.stm32").parent.glob("*.py"))):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute):
                names.add(node.attr)
            elif isinstance(node, ast.FunctionDef):
                names.add(node.name)
    return {name for name in names if not name.startswith("_")}
