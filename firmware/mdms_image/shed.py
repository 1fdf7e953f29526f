"""Takes out of classes what only the start calls, so that a board can forget it.

`boards.start` becomes a file that is loaded, called and forgotten. The objects that it makes live
on, and so do their classes, but not the constructors: `Cell(board)` becomes a call of a function in
that file with an empty `Cell()`. Private methods that only constructors call go there with them.
"""

import ast
from collections.abc import Iterator

from mdms_image.compiler import ImageError
from mdms_image.linker import Program
from mdms_image.reach import attributes_of
from mdms_image.scopes import FUNCTIONS
from mdms_image.units import imported_later, reached

#: The module whose functions are called at the start only.
START_MODULE = "boards.start"
_MAKE = "__init__"


def shed(program: Program, roots: tuple[str, ...]) -> tuple[str, ...]:
    """Make functions of the methods that only the start calls.

    Returns the roots with what lives on of what the start makes.
    """
    program.attributes = {name: list(attributes_of(node)) for name, node in _classes(program)}
    while _Shedding(program, roots).round():
        pass
    for name, node in _classes(program):
        if node.bases and f"{name}.{_MAKE}" in program.definitions and _maker(program, node):
            raise ImageError(f"{name} can be made by the start only if what it inherits from is")
    return lasting(program, roots)


def lasting(program: Program, roots: tuple[str, ...]) -> tuple[str, ...]:
    """The roots, and what lives on that the start reaches: classes, functions used as values."""
    start = _of_start(program)
    called = _called(program, start)
    values = {
        part.id
        for name in start
        if not _is_namespace(program.definitions[name])
        for part in ast.walk(program.definitions[name])
        if isinstance(part, ast.Name) and id(part) not in called
    }
    stays = [
        name
        for name in start
        if (isinstance(node := program.definitions[name], ast.ClassDef) and any(_methods(node)))
        or (isinstance(node, ast.FunctionDef) and (name in values or not _keeps_nothing(node)))
    ]
    return (*roots, *sorted(stays))


def _classes(program: Program) -> list[tuple[str, ast.ClassDef]]:
    return [
        (name, node) for name, node in program.definitions.items() if isinstance(node, ast.ClassDef)
    ]


def _is_namespace(node: ast.stmt) -> bool:
    return isinstance(node, ast.ClassDef) and not any(_methods(node))


def _methods(node: ast.ClassDef) -> Iterator[ast.FunctionDef]:
    return (each for each in node.body if isinstance(each, ast.FunctionDef))


def _maker(program: Program, node: ast.ClassDef) -> bool:
    """Whether anything that a class inherits from still has a constructor."""
    bases = [program.definitions.get(each.id) for each in node.bases if isinstance(each, ast.Name)]
    return not all(
        isinstance(base, ast.ClassDef)
        and _MAKE not in [each.name for each in _methods(base)]
        and not _maker(program, base)
        for base in bases
    )


def _of_start(program: Program) -> set[str]:
    return reached(program, imported_later(program).get(START_MODULE, []))


def _called(program: Program, names: set[str]) -> set[int]:
    """What functions of these names call, by the identity of its expression."""
    return {
        id(part.func)
        for name in names
        if isinstance(program.definitions[name], ast.FunctionDef)
        for part in ast.walk(program.definitions[name])
        if isinstance(part, ast.Call)
    }


def _keeps_nothing(node: ast.FunctionDef) -> bool:
    """Whether a function makes no other, which could outlive it."""
    inside = (part for each in node.body for part in ast.walk(each))
    return not any(isinstance(part, (*FUNCTIONS, ast.GeneratorExp)) for part in inside)


class _Shedding:
    """What can be shed of a program as it stands."""

    def __init__(self, program: Program, roots: tuple[str, ...]) -> None:
        self._program = program
        start = _of_start(program) - reached(program, list(lasting(program, roots)))
        self._calls = {
            id(part.func): part
            for name in sorted(start)
            if isinstance(program.definitions[name], ast.FunctionDef)
            for part in ast.walk(program.definitions[name])
            if isinstance(part, ast.Call)
        }
        self._uses: dict[str, list[ast.AST]] = {}
        for node in program.definitions.values():
            for name, part in _uses(node):
                self._uses.setdefault(name, []).append(part)

    def round(self) -> bool:
        """Shed what can be shed; returns whether there was anything."""
        found = False
        for name, node in _classes(self._program):
            for method in list(_methods(node)):
                calls = self._calls_of(name, method)
                if calls:
                    _take_out(self._program, node, method, name, calls)
                    found = True
        return found

    def _calls_of(self, name: str, method: ast.FunctionDef) -> list[ast.Call]:
        """All calls of a method, if only what is forgotten calls it; else none."""
        if method.decorator_list or not _keeps_nothing(method):
            return []
        if method.name == _MAKE:
            returns = any(isinstance(part, ast.Return) for part in ast.walk(method))
            uses = [] if returns else self._uses.get(name, [])
        else:
            # Only a private name that tells its class is sure to mean this method.
            uses = self._uses.get(method.name, []) if "." in method.name else []
        calls = [self._calls[id(each)] for each in uses if id(each) in self._calls]
        return calls if len(calls) == len(uses) else []


def _uses(node: ast.stmt) -> Iterator[tuple[str, ast.AST]]:
    """What is named of ours: definitions, constructors as those of their classes, attributes.

    Where a class inherits that has no constructor, that of its base is not used.
    """
    skipped: set[int] = set()
    if isinstance(node, ast.ClassDef) and _MAKE not in [each.name for each in _methods(node)]:
        skipped.update(id(base) for base in node.bases)
    for part in ast.walk(node):
        if isinstance(part, ast.Attribute):
            if part.attr == _MAKE and isinstance(part.value, ast.Name):
                skipped.add(id(part.value))
                yield part.value.id, part
            elif "." in part.attr:
                yield part.attr, part
        elif isinstance(part, ast.Name) and id(part) not in skipped:
            yield part.id, part


def _is(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _take_out(
    program: Program, node: ast.ClassDef, method: ast.FunctionDef, owner: str, calls: list[ast.Call]
) -> None:
    """Make a function of a method, and have it called."""
    node.body = [each for each in node.body if each is not method] or [ast.Pass()]
    own = method.args.args[0].arg
    full = f"{owner}.{method.name.rpartition('.')[2]}"
    if method.name == _MAKE:
        _Super(node, own).visit(method)
        method.body.append(ast.Return(ast.Name(own, ast.Load())))
    method.name = full
    program.definitions[full] = method
    positions = [each.arg for each in (*method.args.args, *method.args.kwonlyargs)]
    for call in calls:
        function = call.func
        if isinstance(function, ast.Name):
            call.args.insert(0, ast.Call(function, [], []))
        elif isinstance(function, ast.Attribute) and not _is(function.value, owner):
            call.args.insert(0, function.value)
        call.func = ast.Name(full, ast.Load())
        if not method.args.defaults:
            by_name = {str(each.arg): each.value for each in call.keywords}
            call.args += [by_name[each] for each in positions[len(call.args) :]]
            call.keywords = []
    if not method.args.defaults:
        method.args.args += method.args.kwonlyargs
        method.args.kwonlyargs, method.args.kw_defaults = [], []


class _Super(ast.NodeTransformer):
    """Writes `super().__init__(...)` as `Base.__init__(self, ...)`."""

    def __init__(self, node: ast.ClassDef, own: str) -> None:
        self._bases = node.bases
        self._own = own

    def visit_Call(self, node: ast.Call) -> ast.AST:
        function = node.func
        of = function.value if isinstance(function, ast.Attribute) else None
        if isinstance(of, ast.Call) and _is(of.func, "super"):
            (base,) = self._bases
            assert isinstance(function, ast.Attribute)
            assert isinstance(base, ast.Name)
            function.value = ast.Name(base.id, ast.Load())
            node.args.insert(0, ast.Name(self._own, ast.Load()))
        return self.generic_visit(node)
