"""Joins modules: every reference to something of ours becomes its full name.

After this a name with a dot is ours, `mdms_cell.cell.Cell`, and a name without one is local,
built in, or imported from what is not ours. Imports of ours are gone, but for those inside
functions, which may become files of their own: `from mdms_cell.lss_slave import
mdms_cell.lss_slave.LssSlave as LssSlave`.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from mdms_image.compiler import ImageError
from mdms_image.scopes import Scoped
from mdms_image.sources import is_ours, source_of

#: What `main.py` does when it is not imported becomes this function.
START = "main.start"


@dataclass
class Program:
    """Definitions by their full names, in the order in which they are made.

    `imports` has the lines that import what is not ours, by the name that they bind; `namespaces`
    the classes that stand for modules, which come last; `attributes` those of classes whose methods
    have partly been taken out.
    """

    definitions: dict[str, ast.stmt] = field(default_factory=dict)
    imports: dict[str, ast.stmt] = field(default_factory=dict)
    namespaces: dict[str, ast.stmt] = field(default_factory=dict)
    attributes: dict[str, list[str]] = field(default_factory=dict)


class _Module:
    """One module: what its names mean, and its definitions."""

    def __init__(self, name: str) -> None:
        self.name = name
        source = source_of(name).read_text(encoding="utf-8")
        self.body = [each for node in ast.parse(source).body for each in _without_shim(node)]
        self.own: dict[str, ast.stmt] = {}
        self.means: dict[str, tuple[str, str]] = {}
        self.outside: dict[str, ast.stmt] = {}
        for node in self.body:
            self._take(node)

    def _take(self, node: ast.stmt) -> None:
        if isinstance(node, ast.Import | ast.ImportFrom):
            self._take_import(node)
        elif not _is_docstring(node):
            name, made = self._definition(node)
            if name in self.own:
                raise ImageError(f"{self.name}.{name} is bound twice")
            self.own[name] = made

    def _definition(self, node: ast.stmt) -> tuple[str, ast.stmt]:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            return node.name, node
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value:
            return node.target.id, ast.Assign([node.target], node.value)
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target = node.targets[0]
            if isinstance(target, ast.Name):
                return target.id, node
        if self.name == "main" and isinstance(node, ast.If) and not node.orelse:
            start = ast.parse("def start(): pass").body[0]
            assert isinstance(start, ast.FunctionDef)
            start.body = node.body
            return start.name, start
        raise ImageError(
            f"{self.name}, line {node.lineno}: only imports, definitions and assignments to one "
            "name can be merged"
        )

    def _take_import(self, node: ast.Import | ast.ImportFrom) -> None:
        for alias in node.names:
            bound = alias.asname or alias.name
            kind, target = meaning(node, alias)
            if kind == "outside":
                self.outside[bound] = one_import(node, alias)
            self.means[bound] = (kind, target)


def meaning(node: ast.Import | ast.ImportFrom, alias: ast.alias) -> tuple[str, str]:
    """What an import binds a name to: ('module' or 'name' or 'outside', its full name)."""
    if isinstance(node, ast.Import):
        if is_ours(alias.name):
            raise ImageError(f"import {alias.name}: import names from packages of ours instead")
        return "outside", alias.name
    assert node.module is not None
    full = f"{node.module}.{alias.name}"
    if is_ours(full):
        return "module", full
    return ("name" if is_ours(node.module) else "outside"), full


def one_import(node: ast.Import | ast.ImportFrom, alias: ast.alias) -> ast.stmt:
    """The part of an import that binds one name."""
    if isinstance(node, ast.Import):
        return ast.Import([alias])
    return ast.ImportFrom(node.module, [alias], node.level)


def _without_shim(node: ast.stmt) -> list[ast.stmt]:
    """What MicroPython makes of a statement: of a `try` around imports, the first part."""
    if not isinstance(node, ast.Try):
        return [node]
    caught = [handler.type for handler in node.handlers]
    plain = [each.id for each in caught if isinstance(each, ast.Name)]
    if plain != ["ImportError"] or node.orelse or node.finalbody:
        raise ImageError(f"line {node.lineno}: only `except ImportError` may guard a definition")
    return node.body


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


class _Linker(Scoped):
    """Gives the references of one module their full names."""

    def __init__(self, module: _Module, modules: dict[str, _Module], program: Program) -> None:
        super().__init__()
        self._module = module
        self._modules = modules
        self._program = program

    def _resolve(self, module: str, name: str) -> tuple[str, str]:
        """What a name means in a module, followed through imports."""
        where = self._modules[module]
        if name in where.own:
            return "name", f"{module}.{name}"
        kind, target = where.means.get(name, ("builtin", name))
        if kind == "name":
            return self._resolve(*_split(target))
        return kind, target

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if self.is_local(node.id):
            return node
        kind, full = self._resolve(self._module.name, node.id)
        if kind == "module":
            raise ImageError(f"{self._module.name}, line {node.lineno}: {full} is used as a value")
        if kind == "name":
            return ast.copy_location(ast.Name(full, node.ctx), node)
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name) and not self.is_local(node.value.id):
            kind, module = self._resolve(self._module.name, node.value.id)
            if kind == "module":
                kind, full = self._resolve(module, node.attr)
                if kind != "name":
                    raise ImageError(f"{self._module.name}: {module} has no {node.attr}")
                return ast.copy_location(ast.Name(full, node.ctx), node)
        return self.generic_visit(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.bases = [self.visit(each) for each in node.bases]
        own: set[str] = set()
        for each in node.body:
            self._check_class_names(node, each, own)
            if isinstance(each, ast.FunctionDef):
                own.add(each.name)
            elif isinstance(each, ast.Assign) and isinstance(each.targets[0], ast.Name):
                own.add(each.targets[0].id)
                each.value = self.visit(each.value)
                continue
            elif not _is_docstring(each):
                raise ImageError(f"class {node.name}, line {each.lineno} cannot be merged")
            self.visit(each)
        node.body = [each for each in node.body if not _is_docstring(each)] or [ast.Pass()]
        return node

    def _check_class_names(self, node: ast.ClassDef, member: ast.stmt, own: set[str]) -> None:
        """Raises ImageError if making a member needs names of the class, which get others."""
        made_of: list[ast.AST] = [member]
        if isinstance(member, ast.FunctionDef):
            made_of = [*member.decorator_list, *member.args.defaults]
        for part in made_of:
            for each in ast.walk(part):
                if isinstance(each, ast.Name) and each.id in own:
                    raise ImageError(f"class {node.name} uses its own {each.id} while it is made")

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return None if _is_docstring(node) else self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        if node.value is None:
            return None
        return self.generic_visit(ast.copy_location(ast.Assign([node.target], node.value), node))

    def visit_ImportFrom(self, node: ast.ImportFrom) -> Any:
        """An import in a function: of a module that is its own file, or not ours."""
        made: list[ast.stmt] = []
        for alias in node.names:
            kind, full = meaning(node, alias)
            bound = alias.asname or alias.name
            if kind == "module" and full in self._modules:
                made.append(_assignment(bound, self._namespace(full)))
            elif kind == "name":
                kind, full = self._resolve(*_split(full))
                made.append(ast.ImportFrom(_split(full)[0], [ast.alias(full, bound)], 0))
            else:
                made.append(one_import(node, alias))
        return made

    def _namespace(self, module: str) -> str:
        """A class that stands for a module whose public names are asked of it at run time."""
        name = f"{module}.namespace"
        public = [each for each in self._modules[module].own if not each.startswith("_")]
        body: list[ast.stmt] = [_assignment(each, f"{module}.{each}") for each in public]
        self._program.namespaces[name] = ast.ClassDef(name, [], [], body, [])
        return name


def _assignment(name: str, value: str) -> ast.stmt:
    return ast.Assign([ast.Name(name, ast.Store())], ast.Name(value, ast.Load()))


def _split(full: str) -> tuple[str, str]:
    module, _, name = full.rpartition(".")
    return module, name


def link(modules: list[str]) -> Program:
    """The program that modules make, given in the order in which they are imported.

    Raises ImageError for what cannot be merged.
    """
    program = Program()
    read = {name: _Module(name) for name in modules}
    for module in read.values():
        linker = _Linker(module, read, program)
        for bound, line in module.outside.items():
            if ast.dump(program.imports.setdefault(bound, line)) != ast.dump(line):
                raise ImageError(f"{module.name} imports another {bound} than others do")
        for name, node in module.own.items():
            full = f"{module.name}.{name}"
            made = linker.visit(node)
            if isinstance(made, ast.FunctionDef | ast.ClassDef):
                made.name = full
            program.definitions[full] = made
    program.definitions.update(program.namespaces)
    _check_order(program)
    return program


def _check_order(program: Program) -> None:
    """Raises ImageError if making a definition needs one that comes later."""
    later = set(program.definitions)
    for name, node in program.definitions.items():
        later.discard(name)
        for part in _at_once(node):
            if isinstance(part, ast.Name) and part.id in later:
                raise ImageError(f"{name} needs {part.id}, which comes after it")


def _at_once(node: ast.AST) -> Iterator[ast.AST]:
    """What runs when a definition is made: all but what functions do."""
    if isinstance(node, ast.FunctionDef | ast.Lambda):
        parts: list[ast.AST | None] = [*node.args.defaults, *node.args.kw_defaults]
        if isinstance(node, ast.FunctionDef):
            parts += node.decorator_list
    else:
        yield node
        parts = list(ast.iter_child_nodes(node))
    for part in parts:
        if part is not None:
            yield from _at_once(part)
