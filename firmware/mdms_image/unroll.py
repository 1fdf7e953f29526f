"""Makes loops of list comprehensions, `any` and `all`: each is a function, and costs 80 bytes.

Only where nothing else of the statement runs before: `name = [...]`, `self.name = [...]`,
`return [...]`, `return any(...)`.
"""

import ast

from mdms_image.linker import Program
from mdms_image.scopes import FUNCTIONS, bound_names
from mdms_image.splice import Body, substituted

Comprehension = ast.ListComp | ast.SetComp | ast.GeneratorExp


def unroll(program: Program) -> None:
    """Unroll in place in all functions."""
    for node in program.definitions.values():
        for part in list(ast.walk(node)):
            if isinstance(part, ast.FunctionDef) and _is_bytecode(part):
                part.body = _Unrolling().statements(part.body)


def _is_bytecode(node: ast.FunctionDef) -> bool:
    return all(isinstance(each, ast.Name) and each.id == "property" for each in node.decorator_list)


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
        if not isinstance(node, ast.Assign | ast.Return):
            return None
        value = node.value
        if isinstance(value, ast.ListComp | ast.SetComp) and _stands_alone(value):
            return self._collection(node, value)
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name):
            given = value.args[0] if len(value.args) == 1 else None
            decides = value.func.id in ("any", "all")
            if decides and isinstance(given, ast.GeneratorExp) and _is_one_loop(given):
                return self._decision(node, given, value.func.id == "any")
        return None

    def _collection(self, node: ast.Assign | ast.Return, value: ast.ListComp | ast.SetComp) -> Body:
        found = self._fresh("found")
        empty: ast.expr = ast.List([], ast.Load())
        method = "append"
        if isinstance(value, ast.SetComp):
            empty, method = ast.Call(ast.Name("set", ast.Load()), [], []), "add"
        add = ast.Attribute(ast.Name(found, ast.Load()), method, ast.Load())
        begin = ast.Assign([ast.Name(found, ast.Store())], empty)
        node.value = ast.Name(found, ast.Load())
        return [begin, *self._loops(value, [ast.Expr(ast.Call(add, [value.elt], []))]), node]

    def _decision(self, node: ast.Assign | ast.Return, value: ast.GeneratorExp, told: bool) -> Body:
        """What `any` tells, or `all`: that is, `told` by the first element that is so."""
        found = self._fresh("found")
        begin = ast.Assign([ast.Name(found, ast.Store())], ast.Constant(not told))
        end = ast.Assign([ast.Name(found, ast.Store())], ast.Constant(told))
        test = value.elt if told else ast.UnaryOp(ast.Not(), value.elt)
        node.value = ast.Name(found, ast.Load())
        return [begin, *self._loops(value, [ast.If(test, [end, ast.Break()], [])]), node]

    def _loops(self, value: Comprehension, body: Body) -> Body:
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


def _is_one_loop(value: ast.GeneratorExp) -> bool:
    """Whether one `break` ends it."""
    return len(value.generators) == 1 and _stands_alone(value)


def _stands_alone(value: Comprehension) -> bool:
    """Whether what is looped over is named otherwise than what the loop binds."""
    bound = bound_names(value)
    walked = ast.walk(value.generators[0].iter)
    return not any(isinstance(part, ast.Name) and part.id in bound for part in walked)
