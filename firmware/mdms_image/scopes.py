"""Which names a function binds, and walking through code with that in mind."""

import ast
from typing import Any

from mdms_image.compiler import ImageError

FUNCTIONS = (ast.FunctionDef, ast.Lambda)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_REFUSED = (
    ast.Global,
    ast.Nonlocal,
    ast.NamedExpr,
    ast.AsyncFunctionDef,
    ast.Match,
    ast.TryStar,
    ast.JoinedStr,
)


class _Bound(ast.NodeVisitor):
    """Collects the names that a scope binds, in the order in which they come up."""

    def __init__(self) -> None:
        self.names: dict[str, None] = {}

    def visit_Name(self, node: ast.Name) -> None:
        if not isinstance(node.ctx, ast.Load):
            self.names[node.id] = None

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        if node.name is not None:
            self.names[node.name] = None
        self.generic_visit(node)

    def visit_alias(self, node: ast.alias) -> None:
        self.names[node.asname or node.name] = None

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self.names[node.name] = None

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        raise ImageError(f"class {node.name} lies inside a function; move it to the module")

    def visit_Lambda(self, node: ast.Lambda) -> None:
        pass

    def visit_ListComp(self, node: ast.ListComp) -> None:
        pass

    def visit_SetComp(self, node: ast.SetComp) -> None:
        pass

    def visit_DictComp(self, node: ast.DictComp) -> None:
        pass

    def visit_GeneratorExp(self, node: ast.GeneratorExp) -> None:
        pass


def parameters(arguments: ast.arguments) -> list[ast.arg]:
    """All parameters, in their order."""
    starred = [each for each in (arguments.vararg, arguments.kwarg) if each is not None]
    return [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, *starred]


def bound_names(node: ast.AST) -> dict[str, None]:
    """What a function, lambda or comprehension binds, its parameters first."""
    bound = _Bound()
    if isinstance(node, COMPREHENSIONS):
        for each in node.generators:
            bound.visit(each.target)
        return bound.names
    assert isinstance(node, FUNCTIONS)
    for argument in parameters(node.args):
        bound.names[argument.arg] = None
    for part in node.body if isinstance(node, ast.FunctionDef) else [node.body]:
        bound.visit(part)
    return bound.names


class Scoped(ast.NodeTransformer):
    """Walks through code; `is_local(name)` tells whether a function around binds the name."""

    def __init__(self) -> None:
        self._scopes: list[Any] = []

    def is_local(self, name: str) -> bool:
        """Whether a function around binds the name."""
        return any(name in scope for scope in self._scopes)

    def scope(self, node: ast.AST) -> Any:
        """What is kept about the names that a function binds."""
        return bound_names(node)

    def visit(self, node: ast.AST) -> Any:
        """Visit a node, in the scope that it makes."""
        if isinstance(node, _REFUSED):
            line = getattr(node, "lineno", 0)
            raise ImageError(f"{type(node).__name__} in line {line} cannot go into an image")
        if not isinstance(node, (*FUNCTIONS, *COMPREHENSIONS)):
            return super().visit(node)
        self._visit_outside(node)
        self._scopes.append(self.scope(node))
        made = self._visit_inside(node)
        self._scopes.pop()
        return made

    def _visit_outside(self, node: ast.AST) -> None:
        """What is taken from around when a function is made, or a comprehension begins."""
        if isinstance(node, COMPREHENSIONS):
            node.generators[0].iter = self.visit(node.generators[0].iter)
        if isinstance(node, FUNCTIONS):
            node.args.defaults = [self.visit(each) for each in node.args.defaults]
            node.args.kw_defaults = [each and self.visit(each) for each in node.args.kw_defaults]
        if isinstance(node, ast.FunctionDef):
            node.decorator_list = [self.visit(each) for each in node.decorator_list]

    def _visit_inside(self, node: ast.AST) -> Any:
        if isinstance(node, COMPREHENSIONS):
            first = node.generators[0]
            outside, first.iter = first.iter, ast.Constant(None)
            self.generic_visit(node)
            first.iter = outside
            return node
        assert isinstance(node, FUNCTIONS)
        for argument in parameters(node.args):
            self.visit(argument)
        if isinstance(node, ast.Lambda):
            node.body = self.visit(node.body)
        else:
            made = [self.visit(each) for each in node.body]
            node.body = [
                each
                for part in made
                for each in (part if isinstance(part, list) else [part])
                if each is not None
            ] or [ast.Pass()]
        return node
