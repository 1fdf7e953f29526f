"""Gives private attributes the name of their class, where it is sure which class they are of.

Then attributes of two classes are two, though they have one name in the sources, and may have one
short name in the image, though they have two in the sources.
"""

import ast
from collections.abc import Iterator

from mdms_image.linker import Program
from mdms_image.scopes import COMPREHENSIONS, FUNCTIONS, bound_names


def qualify(program: Program) -> None:
    """Write `_name` as `package.module.Class._name`, in place.

    Left alone are names that occur on anything but `self`, and in strings. Classes that inherit
    from each other count as one.
    """
    classes = {
        name: node for name, node in program.definitions.items() if isinstance(node, ast.ClassDef)
    }
    family = {name: _eldest(name, classes) for name in classes}
    own = {name: list(_own(node)) for name, node in classes.items()}
    sure = {id(part) for parts in own.values() for part in parts}
    unsure = {
        part.attr if isinstance(part, ast.Attribute) else str(part.value)
        for node in program.definitions.values()
        for part in ast.walk(node)
        if (isinstance(part, ast.Attribute) and id(part) not in sure)
        or (isinstance(part, ast.Constant) and isinstance(part.value, str))
    }
    for name, node in classes.items():
        for part in own[name]:
            if _is_private(part.attr) and part.attr not in unsure:
                part.attr = f"{family[name]}.{part.attr}"
        for member in node.body:
            if isinstance(member, ast.FunctionDef):
                if _is_private(member.name) and member.name not in unsure:
                    member.name = f"{family[name]}.{member.name}"
            elif isinstance(member, ast.Assign):
                for target in member.targets:
                    if isinstance(target, ast.Name) and _is_private(target.id):
                        unsure.add(target.id)


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _eldest(name: str, classes: dict[str, ast.ClassDef]) -> str:
    """The class that all relatives of a class name themselves after."""
    for base in classes[name].bases:
        if isinstance(base, ast.Name) and base.id in classes:
            return _eldest(base.id, classes)
    return name


def _own(node: ast.ClassDef) -> Iterator[ast.Attribute]:
    """The attributes of `self` in a class's methods."""
    for member in node.body:
        if isinstance(member, ast.FunctionDef) and member.args.args:
            own = member.args.args[0].arg
            inside = [
                part
                for part in ast.walk(member)
                if isinstance(part, (*FUNCTIONS, *COMPREHENSIONS)) and part is not member
            ]
            rebound = any(own in bound_names(part) for part in inside)
            if rebound or _is_static(member):
                continue
            for part in ast.walk(member):
                if not isinstance(part, ast.Attribute) or not isinstance(part.value, ast.Name):
                    continue
                if part.value.id == own:
                    yield part


def _is_static(node: ast.FunctionDef) -> bool:
    return any(
        isinstance(each, ast.Name) and each.id in ("staticmethod", "classmethod")
        for each in node.decorator_list
    )


def families(program: Program) -> dict[str, list[str]]:
    """The attributes that carry a class's name, by that class; those of no class under ''."""
    found: dict[str, dict[str, None]] = {"": {}}
    for attributes in program.attributes.values():
        for name in attributes:
            found.setdefault(name.rpartition(".")[0], {})[name] = None
    return {family: list(names) for family, names in found.items()}
