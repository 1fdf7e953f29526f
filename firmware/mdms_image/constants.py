"""Puts constants where they are used, across modules."""

import ast
from typing import Any

from mdms_image.linker import Program

#: What takes no more room in the code than the name of a constant would.
_INLINED = (int, str, bool, type(None))
_KNOWN = (*_INLINED, bytes, float)


class _Inliner(ast.NodeTransformer):
    def __init__(self, values: dict[str, Any]) -> None:
        self._values = values

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if isinstance(node.ctx, ast.Load) and node.id in self._values:
            return ast.copy_location(_literal(self._values[node.id]), node)
        return node


def _literal(value: Any) -> ast.expr:
    if isinstance(value, int) and not isinstance(value, bool) and value < 0:
        return ast.UnaryOp(ast.USub(), ast.Constant(-value))
    return ast.Constant(value)


class _Value(ast.NodeVisitor):
    """The value of an expression over constants; LookupError if it is none."""

    def __init__(self, known: dict[str, Any]) -> None:
        self._known = known

    def visit_Constant(self, node: ast.Constant) -> Any:
        return node.value

    def visit_Name(self, node: ast.Name) -> Any:
        return self._known[node.id]

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        return self._run(ast.UnaryOp(node.op, self._literal(node.operand)))

    def visit_BinOp(self, node: ast.BinOp) -> Any:
        return self._run(ast.BinOp(self._literal(node.left), node.op, self._literal(node.right)))

    def visit_Call(self, node: ast.Call) -> Any:
        if isinstance(node.func, ast.Name) and node.func.id == "len" and len(node.args) == 1:
            return len(self.visit(node.args[0]))
        raise LookupError

    def generic_visit(self, node: ast.AST) -> Any:
        raise LookupError

    def _literal(self, node: ast.expr) -> ast.expr:
        return _literal(self.visit(node))

    def _run(self, node: ast.expr) -> Any:
        return eval(compile(ast.fix_missing_locations(ast.Expression(node)), "", "eval"), {})


def inline(program: Program) -> dict[str, Any]:
    """Replace the names of constants by their values; returns the constants that were inlined."""
    known: dict[str, Any] = {}
    for name, node in program.definitions.items():
        if isinstance(node, ast.Assign):
            try:
                value = _Value(known).visit(node.value)
            except LookupError:
                continue
            if isinstance(value, _KNOWN):
                known[name] = value
    inlined = {name: value for name, value in known.items() if isinstance(value, _INLINED)}
    for name, node in list(program.definitions.items()):
        if name in inlined:
            del program.definitions[name]
        else:
            _Inliner(inlined).visit(node)
    return inlined
