"""Where the code of an image comes from: its functions in the sources, and who calls whom where."""

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mdms_image.linker import Program
from mdms_image.scopes import COMPREHENSIONS, FUNCTIONS

#: What linked code is marked with. Whatever moves and copies it takes the marks along.
_MODULE, _FUNCTION, _SPELLED = "mdms_module", "mdms_function", "mdms_spelled"
_NAMELESS = {
    ast.Lambda: "<lambda>",
    ast.ListComp: "<listcomp>",
    ast.SetComp: "<setcomp>",
    ast.DictComp: "<dictcomp>",
    ast.GeneratorExp: "<genexpr>",
}
_INSIDE = (*FUNCTIONS, *COMPREHENSIONS)
Bodies = Mapping[str, Sequence[ast.stmt]]


@dataclass(frozen=True, slots=True)
class Place:
    """A line of the sources, and the function that it is in; 0 where the line is not known."""

    module: str
    function: str
    line: int = 0
    last_line: int = 0


@dataclass(frozen=True, slots=True)
class Function:
    """A function of an image: its name there, where it comes from, and its class, if any."""

    called: str
    place: Place
    owner: str | None
    node: Any

    @property
    def name(self) -> str:
        """What the sources call it, without its class."""
        return self.place.function.rpartition(".")[2]

    @property
    def names(self) -> tuple[str, ...]:
        """How the sources name it where they call it: as a method, or in full, or by its class."""
        if self.owner is None:
            return (f"{self.place.module}.{self.place.function}",)
        return (self.name, self.owner) if self.name == "__init__" else (self.name,)

    def takes(self, call: ast.Call) -> bool:
        """Whether a call has the arguments that it needs."""
        arguments = getattr(self.node, "args", None)
        unpacked = any(isinstance(each, ast.Starred) for each in call.args)
        if not isinstance(arguments, ast.arguments) or arguments.vararg or unpacked:
            return True
        most = len(arguments.args) - (self.owner is not None and not self.nameless)
        given = len(call.args) + len(call.keywords)
        return given == most or most - len(arguments.defaults) <= given <= most

    @property
    def nameless(self) -> bool:
        """Whether it is a lambda, or made inside another function, so that anybody may have it."""
        return self.place.function.count(".") > (self.owner is not None)


def mark(program: Program) -> None:
    """Write into linked definitions, before anything is changed, where each part comes from."""
    for full, node in program.definitions.items():
        module, _, name = full.rpartition(".")
        _mark(node, module, name)


def _mark(node: ast.AST, module: str, function: str) -> None:
    if hasattr(node, "lineno"):
        setattr(node, _MODULE, module)
        setattr(node, _FUNCTION, function)
        setattr(node, _SPELLED, getattr(node, "attr", getattr(node, "id", None)))
    for child in ast.iter_child_nodes(node):
        inside = function
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            inside = f"{function}.{child.name}"
        elif isinstance(child, _INSIDE):
            inside = f"{function}.{_NAMELESS[type(child)]}"
        _mark(child, module, inside)


def spelled(node: ast.AST) -> str | None:
    """How the sources spell a name or an attribute."""
    return getattr(node, _SPELLED, None)


def place_of(node: ast.AST) -> Place | None:
    """Where a part of the code comes from; None for what only the image has."""
    if not hasattr(node, _MODULE):
        return None
    line = getattr(node, "lineno", 0)
    last = getattr(node, "end_lineno", line)
    return Place(getattr(node, _MODULE), getattr(node, _FUNCTION), line, last)


def own_parts(node: ast.AST) -> Iterator[ast.AST]:
    """What a function consists of, without the insides of functions inside it."""
    for child in ast.iter_child_nodes(node):
        yield child
        if not isinstance(child, _INSIDE):
            yield from own_parts(child)


class Origins:
    """The functions of an image, by file and name, and how they call each other."""

    def __init__(self, bodies: Bodies) -> None:
        self.functions: dict[tuple[str, str], list[Function]] = {}
        self.classes: dict[str, set[str]] = {}
        self._bases: dict[str, list[str]] = {}
        self._short: dict[str, str] = {}
        self._methods: set[tuple[str, str]] = set()
        self._values: set[tuple[str, str]] = set()
        self._variables: set[str] = set()
        for body in bodies.values():
            for node in body:
                self._take_class(node)
        for unit, body in bodies.items():
            for node in body:
                for part in ast.walk(node):
                    if isinstance(part, _INSIDE):
                        self._take_function(unit, part)
        for body in bodies.values():
            for node in body:
                self._take_values(node)

    def sites(self, caller: Function, callee: Function) -> list[Place | None]:
        """Where one function may call another."""
        found: list[Place | None] = []
        for part in own_parts(caller.node):
            if isinstance(part, ast.Call):
                calls = callee.takes(part) and self._may_call(caller, part.func, callee)
            elif isinstance(part, ast.Attribute):
                calls = _is_property(callee.node) and spelled(part) == callee.name
            else:
                calls = part is callee.node and isinstance(part, COMPREHENSIONS)
            if calls:
                found.append(place_of(part))
        return found

    def _take_class(self, node: ast.stmt) -> None:
        place = place_of(node)
        if isinstance(node, ast.ClassDef) and place is not None:
            full = f"{place.module}.{place.function}"
            self.classes.setdefault(node.name, set()).add(full)
            self._short[full] = node.name
            self._bases[full] = [spelled(base) or "" for base in node.bases]

    def _take_function(self, unit: str, node: ast.AST) -> None:
        place = place_of(node)
        if place is None:
            return
        called = node.name if isinstance(node, ast.FunctionDef) else _NAMELESS[type(node)]
        owner = f"{place.module}.{place.function.partition('.')[0]}"
        function = Function(called, place, owner if owner in self._bases else None, node)
        self.functions.setdefault((unit, called), []).append(function)
        for family in ("", self._family(function.owner)):
            self._methods.add((family, function.name))

    def _take_values(self, node: ast.stmt) -> None:
        """What is not called where it is named; any call of a variable may be one of it."""
        called = {id(part.func) for part in ast.walk(node) if isinstance(part, ast.Call)}
        place = place_of(node)
        family = self._family(f"{place.module}.{place.function}" if place else None)
        for part in ast.walk(node):
            if isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store):
                self._variables.add(spelled(part) or part.attr)
            elif id(part) in called or not isinstance(getattr(part, "ctx", None), ast.Load):
                continue
            elif isinstance(part, ast.Attribute):
                own = isinstance(part.value, ast.Name) and spelled(part.value) == "self"
                self._values.add((family if own else "", spelled(part) or part.attr))
            elif isinstance(part, ast.Name):
                self._values.add(("", spelled(part) or part.id))

    def _family(self, name: str | None) -> str:
        """The eldest of a class's relatives; nothing for what is no class."""
        if name not in self._bases:
            return ""
        for base in self._bases[name]:
            if base in self._bases:
                return self._family(base)
        return name

    def _may_call(self, caller: Function, target: ast.expr, callee: Function) -> bool:
        named = spelled(target)
        if named is None and _short(target) == callee.called:
            return True
        loaded = _loaded(caller, target)
        if loaded:
            return callee.called in loaded or self._short.get(callee.owner or "") in loaded
        if named is not None and named in callee.names:
            same = self._family(caller.owner) == self._family(callee.owner)
            return same or not _is_own(target)
        family = self._family(caller.owner) if _is_own(target) else ""
        if named is not None and ("." in named or (family, named) in self._methods):
            return False
        if isinstance(target, ast.Attribute) and named not in self._variables:
            return False
        return callee.nameless or any(
            (family, name) in self._values
            for family in ("", self._family(callee.owner))
            for name in (*callee.names, callee.called)
        )


def _loaded(caller: Function, target: ast.expr) -> set[str | None]:
    """The short names of what a variable has been given from another file."""
    return {
        part.value.attr
        for part in own_parts(caller.node)
        if isinstance(part, ast.Assign)
        and isinstance(part.value, ast.Attribute)
        and spelled(part.value) is None
        and isinstance(target, ast.Name)
        and _short(part.targets[0]) == target.id
    }


def _short(target: ast.expr) -> str | None:
    if isinstance(target, ast.Attribute):
        return target.attr
    return target.id if isinstance(target, ast.Name) else None


def _is_own(target: ast.expr) -> bool:
    """Whether an expression is an attribute of `self`."""
    return (
        isinstance(target, ast.Attribute)
        and isinstance(target.value, ast.Name)
        and spelled(target.value) == "self"
    )


def _is_property(node: Any) -> bool:
    return isinstance(node, ast.FunctionDef) and any(
        isinstance(each, ast.Name) and each.id == "property" for each in node.decorator_list
    )
