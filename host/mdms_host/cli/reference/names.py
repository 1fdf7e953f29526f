"""Public names of modules and what their docstrings say, read off the sources: nothing is run."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

#: The folders that the packages lie in, seen from this one.
_ROOT = Path(__file__).parents[4]
_FOLDERS = ("host", "protocol", "sim_bus")
_Function = ast.FunctionDef | ast.AsyncFunctionDef


class Name(NamedTuple):
    """One public name: of a function or class with its arguments, of a member, of a value."""

    name: str
    signature: str
    words: str
    members: tuple["Name", ...] = ()
    #: Each argument or field that has a type, and that type.
    typed: tuple[tuple[str, str], ...] = ()
    returns: str = ""
    waits: str = ""


def module_words(module: str) -> str:
    """The first paragraph of a module's docstring."""
    return _first(ast.get_docstring(_tree(module)))


def names_of(module: str) -> list[Name]:
    """What a module lists in `__all__`, in that order; imported names as their own module has them.

    Raises `LookupError` for a module without `__all__`, and for a name that it does not have.
    """
    tree = _tree(module)
    listed = next((_strings(node) for node in tree.body if _assigns(node, "__all__")), None)
    if listed is None:
        raise LookupError(f"{module} has no __all__")
    return [_named(module, tree, name) for name in listed]


def _tree(module: str) -> ast.Module:
    for folder in _FOLDERS:
        path = _ROOT / folder / module.replace(".", "/")
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if file.is_file():
                return ast.parse(file.read_text(encoding="utf-8"))
    raise LookupError(f"{module}: no such module")


def _named(module: str, tree: ast.Module, name: str) -> Name:
    for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, _Function | ast.ClassDef) and node.name == name:
            return _defined(node)
        if isinstance(node, ast.ImportFrom) and name in {each.name for each in node.names}:
            return _named(str(node.module), _tree(str(node.module)), name)
        if _assigns(node, name):
            return Name(name, name, _below(after))
    raise LookupError(f"{module} lists {name} and does not have it")


def _defined(node: _Function | ast.ClassDef) -> Name:
    words = _first(ast.get_docstring(node))
    if isinstance(node, ast.ClassDef):
        fields = tuple(_fields(node))
        starts = [
            each for each in node.body if isinstance(each, _Function) and each.name == "__init__"
        ]
        arguments = _arguments(starts[0]) if starts else _joined(fields)
        typed = tuple(_typed(starts[0])) if starts else fields
        signature = f"{node.name}({arguments})" if arguments else node.name
        return Name(node.name, signature, words, tuple(_members(node)), typed)
    returns = ast.unparse(node.returns).strip("\"'") if node.returns else ""
    call = f"{node.name}({_arguments(node)})"
    if not isinstance(node, ast.AsyncFunctionDef):
        call += f" -> {returns}" if returns not in ("", "None") else ""
    return Name(node.name, call, words, (), tuple(_typed(node)), returns, _waits(node))


def _waits(node: _Function) -> str:
    """How a coroutine is waited for; empty for a function."""
    if not isinstance(node, ast.AsyncFunctionDef):
        return ""
    yields = any(isinstance(each, ast.Yield) for each in ast.walk(node))
    return "async for" if yields else "await"


def _members(node: ast.ClassDef) -> Iterator[Name]:
    for each, after in zip(node.body, [*node.body[1:], None], strict=True):
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name) and _below(after):
            yield Name(each.target.id, each.target.id, _below(after))
        if isinstance(each, _Function) and not each.name.startswith("_"):
            member = _defined(each)
            if any("property" in ast.unparse(mark) for mark in each.decorator_list):
                member = member._replace(signature=each.name)
            yield member


def _fields(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for each in node.body:
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
            yield each.target.id, ast.unparse(each.annotation)


def _typed(node: _Function) -> Iterator[tuple[str, str]]:
    for each in (*node.args.args, *node.args.kwonlyargs):
        if each.annotation is not None:
            yield each.arg, ast.unparse(each.annotation)


def _joined(fields: tuple[tuple[str, str], ...]) -> str:
    return ", ".join(name for name, _ in fields)


def _arguments(node: _Function) -> str:
    plain = [each.arg for each in node.args.args if each.arg not in ("self", "cls")]
    defaults = [f"={ast.unparse(each)}" for each in node.args.defaults]
    starred = [f"*{node.args.vararg.arg}"] if node.args.vararg else []
    marked = ["*"] if node.args.kwonlyargs and not starred else []
    only = [
        each.arg + (f"={ast.unparse(default)}" if default else "")
        for each, default in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
    ]
    required = len(plain) - len(defaults)
    given = plain[:required] + [a + d for a, d in zip(plain[required:], defaults, strict=True)]
    return ", ".join((*given, *starred, *marked, *only))


def _assigns(node: ast.stmt, name: str) -> bool:
    targets = node.targets if isinstance(node, ast.Assign) else ()
    return any(isinstance(each, ast.Name) and each.id == name for each in targets)


def _strings(node: ast.stmt) -> list[str]:
    assert isinstance(node, ast.Assign)
    return list(ast.literal_eval(node.value))


def _below(node: ast.stmt | None) -> str:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return _first(str(node.value.value))
    return ""


def _first(docstring: str | None) -> str:
    """The whole docstring as one line, without examples."""
    text = (docstring or "").split(">>>")[0]
    return " ".join(text.split())
