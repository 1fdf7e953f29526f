"""Leaves out what costs memory on a board and changes nothing: hints, assertions, causes."""

import ast
from typing import Any

from mdms_image.scopes import Scoped, parameters

_EMITTERS = ("viper", "native")


class _Trimmer(Scoped):
    def __init__(self, emits: bool) -> None:
        super().__init__()
        self._emits = emits

    def visit_Assert(self, _node: ast.Assert) -> None:
        return None

    def visit_Raise(self, node: ast.Raise) -> Any:
        # MicroPython has no causes, and warns of them each time.
        node.cause = None
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> Any:
        if isinstance(node.func, ast.Name) and node.func.id == "const":
            return self.visit(node.args[0])
        return self.generic_visit(node)

    def _visit_outside(self, node: ast.AST) -> None:
        if isinstance(node, ast.FunctionDef):
            emitted = [each for each in node.decorator_list if _emitter(each)]
            node.returns = None
            if not self._emits:
                node.decorator_list = [each for each in node.decorator_list if each not in emitted]
            if not (emitted and self._emits):
                for argument in parameters(node.args):
                    argument.annotation = None
        super()._visit_outside(node)


def _emitter(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "micropython"
        and node.attr in _EMITTERS
    )


def trim(definitions: dict[str, ast.stmt], *, emits: bool) -> None:
    """Trim all definitions in place; without an emitter the functions for it become bytecode."""
    for node in definitions.values():
        _Trimmer(emits).visit(node)
