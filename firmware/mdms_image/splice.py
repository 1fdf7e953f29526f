"""Makes the body of a function fit into another function."""

import ast
import copy

from mdms_image.scopes import COMPREHENSIONS, Scoped, bound_names

Body = list[ast.stmt]


class _Substitute(Scoped):
    """Puts expressions in place of local names."""

    def __init__(self, names: dict[str, ast.expr]) -> None:
        super().__init__()
        self._names = names

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id not in self._names:
            return node
        made = copy.deepcopy(self._names[node.id])
        if isinstance(made, ast.Name):
            made.ctx = node.ctx
        return made

    def visit_alias(self, node: ast.alias) -> ast.AST:
        renamed = self._names.get(node.asname or node.name)
        if isinstance(renamed, ast.Name):
            node.asname = renamed.id
        return node

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        if node.name in self._names:
            renamed = self._names[node.name]
            assert isinstance(renamed, ast.Name)
            node.name = renamed.id
        return self.generic_visit(node)


def substituted(body: Body, names: dict[str, ast.expr]) -> Body:
    """Statements with expressions in place of local names."""
    return [_Substitute(names).visit(each) for each in body]


def written(body: Body) -> dict[str, None]:
    """The names that statements bind, in the order in which they come up."""
    function = ast.parse("def f(): pass").body[0]
    assert isinstance(function, ast.FunctionDef)
    function.body = body
    inside = [part for each in body for part in ast.walk(each) if isinstance(part, COMPREHENSIONS)]
    names = bound_names(function)
    for each in inside:
        names.update(bound_names(each))
    return names


def without_early_returns(body: Body) -> Body:
    """`if a: return` before other statements becomes `if not a:` around them."""
    for place, each in enumerate(body):
        if (
            isinstance(each, ast.If)
            and not each.orelse
            and len(each.body) == 1
            and isinstance(each.body[0], ast.Return)
            and each.body[0].value is None
            and body[place + 1 :]
        ):
            rest = without_early_returns(body[place + 1 :])
            return [*body[:place], ast.If(ast.UnaryOp(ast.Not(), each.test), rest, [])]
    return body


def with_value(body: Body, node: ast.Expr | ast.Assign) -> Body | None:
    """The body with what it returns at its end given to a statement; None if it returns before."""
    last = body[-1]
    value: ast.expr = ast.Constant(None)
    if isinstance(last, ast.Return):
        body, value = body[:-1], last.value or value
    if any(isinstance(part, ast.Return) for each in body for part in ast.walk(each)):
        return None
    if isinstance(node, ast.Assign):
        return [*body, ast.Assign(node.targets, value)]
    return body if isinstance(value, ast.Constant) else [*body, ast.Expr(value)]
