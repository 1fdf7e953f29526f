"""Leaves out the widening of registers where a machine word is as wide as they are.

`mdms_cell.speed_loop` shifts a register that it has loaded up and down again by as many bits as a
word has more than 32, a number that stands in a variable. Nothing else does so by a variable.
"""

import ast
from typing import Any

#: Architectures of 32 bits, as mpy-cross calls them.
_NARROW = ("armv", "xtensa", "rv32", "x86")


class _Narrower(ast.NodeTransformer):
    def visit_BinOp(self, node: ast.BinOp) -> Any:
        self.generic_visit(node)
        up = node.left
        if (
            isinstance(node.op, ast.RShift)
            and isinstance(up, ast.BinOp)
            and isinstance(up.op, ast.LShift)
            and isinstance(up.right, ast.Name)
            and isinstance(node.right, ast.Name)
            and up.right.id == node.right.id
        ):
            return up.left
        return node


def narrow(source: str, architecture: str | None) -> str:
    """A source for an architecture's machine code; unchanged for one of 64 bits or for bytecode."""
    if architecture is None or not architecture.startswith(_NARROW):
        return source
    return ast.unparse(_Narrower().visit(ast.parse(source)))
