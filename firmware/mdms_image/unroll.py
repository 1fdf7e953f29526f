"""Makes loops of list comprehensions, and of `any`: each is a function, and costs a board 80 bytes.

Only where nothing else of the statement runs before: `name = [...]`, `self.name = [...]`,
`return [...]` and `return any(...)`.
"""

import ast

from mdms_image.linker import Program
from mdms_image.scopes import FUNCTIONS, bound_names
from mdms_image.splice import Body, substituted


def unroll(program: Program) -> None:
    """Unroll in place in all functions."""
    for node in program.definitions.values():
        for part in list(ast.walk(node)):
            if isinstance(part, ast.FunctionDef) and not part.decorator_list:
                part.body = _Unrolling().statements(part.body)


class _Unrolling:
    """What is unrolled in one function."""

    def __init__(self) -> None:
        self._serial = 0

    def statements(self, body: Body) -> Body:
        """Statements with loops in place of comprehensions."""
        made: Body = []
        for each in body:
            if not isinstance(each, FUNCTIONS):
                for field in ("body", "orelse", "finalbody"):
                    inside = getattr(each, field, None)
                    if isinstance(inside, list):
                        setattr(each, field, self.statements(inside))
            made += self._unrolled(each) or [each]
        return made

    def _unrolled(self, node: ast.stmt) -> Body | None:
        value = node.value if isinstance(node, ast.Assign | ast.Return) else None
        if isinstance(value, ast.ListComp) and _stands_alone(value):
            return self._list(node, value)
        if isinstance(node, ast.Return) and isinstance(value, ast.Call) and len(value.args) == 1:
            given = value.args[0]
            called = value.func.id if isinstance(value.func, ast.Name) else None
            if called == "any" and isinstance(given, ast.GeneratorExp) and _stands_alone(given):
                return self._any(given)
        return None

    def _list(self, node: ast.stmt, value: ast.ListComp) -> Body:
        found = self._fresh("found")
        append = ast.Attribute(ast.Name(found, ast.Load()), "append", ast.Load())
        add = ast.Expr(ast.Call(append, [value.elt], []))
        assert isinstance(node, ast.Assign | ast.Return)
        node.value = ast.Name(found, ast.Load())
        begin = ast.Assign([ast.Name(found, ast.Store())], ast.List([], ast.Load()))
        return [begin, *self._loops(value, [add]), node]

    def _any(self, value: ast.GeneratorExp) -> Body:
        found = ast.If(value.elt, [ast.Return(ast.Constant(True))], [])
        return [*self._loops(value, [found]), ast.Return(ast.Constant(False))]

    def _loops(self, value: ast.ListComp | ast.GeneratorExp, body: Body) -> Body:
        for each in reversed(value.generators):
            for condition in reversed(each.ifs):
                body = [ast.If(condition, body, [])]
            body = [ast.For(each.target, each.iter, body, [])]
        names = {name: ast.Name(self._fresh(name), ast.Load()) for name in bound_names(value)}
        return substituted(body, dict(names))

    def _fresh(self, name: str) -> str:
        """A local name that nothing has: those of `fold` have no letter after their number."""
        self._serial += 1
        return f"{name}_{self._serial}u"


def _stands_alone(value: ast.ListComp | ast.GeneratorExp) -> bool:
    """Whether what is looped over is named otherwise than what the loop binds."""
    bound = bound_names(value)
    walked = ast.walk(value.generators[0].iter)
    return not any(isinstance(part, ast.Name) and part.id in bound for part in walked)
