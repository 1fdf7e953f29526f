"""Puts functions that one place calls into that place: each costs a board 50 bytes.

Left alone is whatever would need more than putting names in place of names: keywords, decorators,
functions inside functions, returns amid statements. A method of others than `self` is meant for
sure where only one class has its name, and nobody outside knows it.
"""

import ast
import copy
from collections import Counter
from collections.abc import Iterator
from typing import Any

from mdms_image.linker import Program
from mdms_image.reach import is_public
from mdms_image.scopes import COMPREHENSIONS, FUNCTIONS, bound_names
from mdms_image.splice import Body, substituted, with_value, without_early_returns, written


class _Callee:
    """A function that one place calls; `name` is that of a method, or a full name."""

    def __init__(self, name: str, owner: ast.ClassDef | None, node: ast.FunctionDef) -> None:
        self.name = name
        self.owner = owner
        self.node = node


def fold(program: Program, roots: tuple[str, ...], known: set[str]) -> None:
    """Fold what can be folded, until nothing can; the roots and the `known` attributes stay."""
    folding = _Folding(program, roots, known)
    while folding.pass_over():
        pass


def _functions(program: Program) -> Iterator[tuple[ast.ClassDef | None, ast.FunctionDef]]:
    for node in program.definitions.values():
        if isinstance(node, ast.FunctionDef):
            yield None, node
        elif isinstance(node, ast.ClassDef):
            for member in node.body:
                if isinstance(member, ast.FunctionDef):
                    yield node, member


def _foldable(program: Program, roots: tuple[str, ...], known: set[str]) -> dict[str, _Callee]:
    """The functions and methods that are named once, by their name in calls."""
    named: Counter[str] = Counter()
    for node in program.definitions.values():
        for part in ast.walk(node):
            if isinstance(part, ast.Attribute):
                named[part.attr] += 1
            elif isinstance(part, ast.Name):
                named[part.id] += 1
            elif isinstance(part, ast.ImportFrom):
                named.update(alias.name for alias in part.names)
            elif isinstance(part, ast.Constant) and isinstance(part.value, str):
                named[part.value] += 1
    defined: Counter[str] = Counter()
    found: dict[str, _Callee] = {}
    for owner, node in _functions(program):
        defined[node.name] += 1
        stays = node.name in roots or node.name in known or node.name.startswith("__")
        if not stays and _plain(node):
            found[node.name] = _Callee(node.name, owner, node)
    return {name: each for name, each in found.items() if named[name] == 1 and defined[name] == 1}


def _plain(node: ast.FunctionDef) -> bool:
    arguments = node.args
    if node.decorator_list or arguments.defaults or arguments.kwonlyargs or arguments.posonlyargs:
        return False
    if arguments.vararg or arguments.kwarg:
        return False
    inside = [part for each in node.body for part in ast.walk(each)]
    return not any(isinstance(part, (*FUNCTIONS, ast.Yield, ast.YieldFrom)) for part in inside)


class _Folding:
    """What is folded in one pass over all functions."""

    def __init__(self, program: Program, roots: tuple[str, ...], known: set[str]) -> None:
        self._program = program
        self._roots = roots
        self._known = known
        self._serial = 0
        self.foldable: dict[str, _Callee] = {}

    def pass_over(self) -> bool:
        """Fold into every function once; returns whether there was anything."""
        self.foldable = _foldable(self._program, self._roots, self._known)
        before = len(self.foldable)
        gone = {id(each.node) for each in self.foldable.values()}
        for owner, node in list(_functions(self._program)):
            still = {id(each.node) for each in self.foldable.values()}
            if id(node) not in gone or id(node) in still:
                while _Caller(owner, node, self).fold():
                    pass
        return len(self.foldable) < before

    def fresh(self, name: str) -> str:
        """A local name that nothing has."""
        self._serial += 1
        return f"{name}_{self._serial}"

    def drop(self, callee: _Callee) -> None:
        """Take a function away that has been folded."""
        del self.foldable[callee.name]
        if callee.owner is None:
            del self._program.definitions[callee.name]
        else:
            callee.owner.body.remove(callee.node)


class _Caller:
    """A function into which others are folded."""

    def __init__(
        self, owner: ast.ClassDef | None, node: ast.FunctionDef, folding: _Folding
    ) -> None:
        self._owner = owner
        self._node = node
        self._folding = folding
        self._own = node.args.args[0].arg if owner is not None and node.args.args else None
        self._folded = False

    def fold(self) -> bool:
        """Fold what this function calls; returns whether there was anything."""
        if not self._node.decorator_list:
            self._node.body = self._statements(self._node.body)
            if not self._folded:
                _Expressions(self).visit(self._node)
        return self._folded

    def _statements(self, body: Body) -> Body:
        made: Body = []
        for place, each in enumerate(body):
            if self._folded:
                return made + body[place:]
            made += self._statement(each)
        return made

    def _statement(self, node: ast.stmt) -> Body:
        if isinstance(node, ast.Expr | ast.Return | ast.Assign) and node.value is not None:
            folded = self._call(node, node.value)
            if folded is not None:
                return folded
        if not isinstance(node, FUNCTIONS):
            for field in ("body", "orelse", "finalbody"):
                inside = getattr(node, field, None)
                if isinstance(inside, list):
                    setattr(node, field, self._statements(inside))
            for handler in getattr(node, "handlers", []):
                handler.body = self._statements(handler.body)
        return [node]

    def _call(self, node: ast.Expr | ast.Return | ast.Assign, call: ast.expr) -> Body | None:
        callee = self.callee(call)
        if callee is None or not isinstance(call, ast.Call):
            return None
        body = self.bound(callee, call, without_early_returns(copy.deepcopy(callee.node.body)))
        ending: Body | None
        if isinstance(node, ast.Return):
            ends = isinstance(body[-1], ast.Return | ast.Raise)
            ending = body if ends else [*body, ast.Return(None)]
        else:
            ending = with_value(body, node)
        if ending is not None:
            self.drop(callee)
        return ending

    def callee(self, call: ast.expr) -> _Callee | None:
        """The function that a call folds, or None."""
        if not isinstance(call, ast.Call) or call.keywords:
            return None
        function = call.func
        if isinstance(function, ast.Name):
            callee = self._folding.foldable.get(function.id)
            fits = callee is not None and callee.owner is None
        elif isinstance(function, ast.Attribute):
            callee = self._folding.foldable.get(function.attr)
            own = isinstance(function.value, ast.Name) and function.value.id == self._own
            fits = callee is not None and (
                (own and callee.owner is self._owner)
                or (callee.owner is not None and is_public(callee.name))
            )
        else:
            return None
        if callee is None or not fits or callee.node is self._node:
            return None
        given = len(call.args) + (callee.owner is not None)
        starred = any(isinstance(each, ast.Starred) for each in call.args)
        return callee if given == len(callee.node.args.args) and not starred else None

    def bound(self, callee: _Callee, call: ast.Call, body: Body) -> Body:
        """The body with the caller's names in place of its own."""
        arguments: list[ast.expr] = list(call.args)
        if callee.owner is not None:
            assert isinstance(call.func, ast.Attribute)
            arguments.insert(0, call.func.value)
        names: dict[str, ast.expr] = {}
        before: Body = []
        bound_inside = written(body)
        for parameter, argument in zip(callee.node.args.args, arguments, strict=True):
            if isinstance(argument, ast.Name | ast.Constant) and parameter.arg not in bound_inside:
                names[parameter.arg] = argument
            else:
                fresh = self._folding.fresh(parameter.arg)
                names[parameter.arg] = ast.Name(fresh, ast.Load())
                before.append(ast.Assign([ast.Name(fresh, ast.Store())], argument))
        for name in (*bound_inside, *bound_names(callee.node)):
            if name not in names:
                names[name] = ast.Name(self._folding.fresh(name), ast.Load())
        return before + substituted(body, names)

    def drop(self, callee: _Callee) -> None:
        """Take a function away that has been folded."""
        self._folded = True
        self._folding.drop(callee)


class _Expressions(ast.NodeTransformer):
    """Folds functions that are one expression, wherever they are called."""

    def __init__(self, caller: _Caller) -> None:
        self._caller = caller

    def visit_Call(self, node: ast.Call) -> Any:
        self.generic_visit(node)
        callee = self._caller.callee(node)
        if callee is None or len(callee.node.body) != 1:
            return node
        returned = callee.node.body[0]
        if not isinstance(returned, ast.Return) or returned.value is None:
            return node
        if any(isinstance(part, COMPREHENSIONS) for part in ast.walk(returned)):
            return node
        made = self._caller.bound(callee, node, [copy.deepcopy(returned)])
        if len(made) != 1:
            return node
        self._caller.drop(callee)
        assert isinstance(made[0], ast.Return)
        return made[0].value
