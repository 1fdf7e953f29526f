"""Gives the names that code uses most the first places in a file's table of names.

In bytecode a name is its place in that table: one byte for the first 128 places, two for others.
The compiler gives places in the order in which names come up.
"""

import ast
from collections import Counter
from typing import Any

from mdms_image.scopes import Scoped

#: A few places are the compiler's own.
_PLACES = 122


class _Uses(Scoped):
    """Counts the names in what stays when a file has been loaded: the code of functions."""

    def __init__(self) -> None:
        super().__init__()
        self.count: Counter[str] = Counter()

    def _use(self, name: str) -> None:
        if self._scopes:
            self.count[name] += 1

    def scope(self, node: ast.AST) -> Any:
        if isinstance(node, ast.FunctionDef):
            self.count[node.name] += 1
        return super().scope(node)

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if not self.is_local(node.id):
            self._use(node.id)
        return node

    def visit_arg(self, node: ast.arg) -> ast.AST:
        self._use(node.arg)
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self._use(node.attr)
        return self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        if node.arg is not None:
            self._use(node.arg)
        return self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, str) and node.value.isidentifier():
            self._use(node.value)
        return node


def names_first(body: list[ast.stmt]) -> list[str]:
    """What does nothing but name what functions use most, most used first."""
    uses = _Uses()
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            uses.visit(node)
    if len(uses.count) <= _PLACES:
        return []
    names = [name for name, _ in uses.count.most_common(_PLACES)]
    return [f"if not __name__:\n    __name__.{'.'.join(names)}"]
