"""Public names of modules and what their docstrings say, read off the sources: nothing is run."""

import ast
import re
from collections.abc import Iterable, Iterator
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
    #: How it is used, if it is not called plainly: `await`, `async for` or `with`.
    waits: str = ""
    #: The signature with its types, aliases of types written out.
    full: str = ""


def module_words(module: str) -> str:
    """The first paragraph of a module's docstring."""
    return _first(ast.get_docstring(_tree(module)))


def names_of(module: str, names: Iterable[str] = ()) -> list[Name]:
    """These names of a module, or else what it lists in `__all__`, in that order.

    Imported names are as their own module has them. Raises `LookupError` for a module without
    `__all__`, and for a name that it does not have.
    """
    tree = _tree(module)
    assigned = next((_strings(node) for node in tree.body if _assigns(node, "__all__")), None)
    listed = list(names) or assigned
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
    body = _statements(tree)
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, _Function | ast.ClassDef) and node.name == name:
            return _spelled(_defined(node), tree)
        if isinstance(node, ast.ImportFrom) and name in _imported(node):
            origin = _imported(node)[name]
            if _is_module(f"{node.module}.{origin}"):
                words = module_words(f"{node.module}.{origin}")
                return Name(name, name, words, tuple(names_of(f"{node.module}.{origin}")))
            return _named(str(node.module), _tree(str(node.module)), origin)
        if _assigns(node, name):
            return Name(name, name, _below(after))
    raise LookupError(f"{module} lists {name} and does not have it")


def _statements(tree: ast.Module) -> list[ast.stmt]:
    """What stands at the top of a module, and below `if TYPE_CHECKING`."""
    nested = (node.body if isinstance(node, ast.If) else [node] for node in tree.body)
    return [node for nodes in nested for node in nodes]


def _imported(node: ast.ImportFrom) -> dict[str, str]:
    """The names that a statement imports, and what they are called where they come from."""
    return {each.asname or each.name: each.name for each in node.names}


def _is_module(module: str) -> bool:
    try:
        _tree(module)
    except LookupError:
        return False
    return True


def _spelled(name: Name, tree: ast.Module) -> Name:
    """The same with aliases of types written out, as a reader needs them."""
    members = tuple(_spelled(member, tree) for member in name.members)
    return name._replace(full=_without_aliases(name.full, tree), members=members)


def _without_aliases(text: str, tree: ast.Module) -> str:
    # A type in quotes is one that is imported late.
    text = re.sub(r"(?<=[:>] )(['\"])(.*?)\1", r"\2", text)
    text = re.sub(r"(?<=\[)'(\w+)'", r"\1", text)
    words = re.split(r"(\w+)", text)
    return "".join(_alias(word, tree) or word for word in words)


def _alias(word: str, tree: ast.Module) -> str | None:
    """What a name in capitals stands for, where it is an alias of a type."""
    if not word[:1].isupper():
        return None
    for node in _statements(tree):
        if _assigns(node, word):
            assert isinstance(node, ast.Assign)
            text = ast.unparse(node.value)
            is_type = isinstance(node.value, ast.Subscript | ast.BinOp)
            return _without_aliases(text, tree) if is_type else None
        if isinstance(node, ast.ImportFrom) and word in _imported(node):
            ours = str(node.module).startswith("mdms_")
            return _alias(_imported(node)[word], _tree(str(node.module))) if ours else None
    return None


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
        # What has a constructor of its own is made by others than users.
        made = ", ".join(f"{field}: {kind}" for field, kind in fields)
        full = node.name if starts or not fields else f"{node.name}({made})"
        return Name(node.name, signature, words, tuple(_members(node)), typed, full=full)
    returns = ast.unparse(node.returns).strip("\"'") if node.returns else ""
    call = f"{node.name}({_arguments(node)})"
    if not isinstance(node, ast.AsyncFunctionDef):
        call += f" -> {returns}" if returns not in ("", "None") else ""
    full = _full(node, returns)
    return Name(node.name, call, words, (), tuple(_typed(node)), returns, _waits(node), full)


def _full(node: _Function, returns: str) -> str:
    """The signature with all types."""
    arguments = node.args
    own = [each for each in arguments.args if each.arg not in ("self", "cls")]
    shown = ast.arguments(
        posonlyargs=[],
        args=own,
        vararg=arguments.vararg,
        kwonlyargs=arguments.kwonlyargs,
        kw_defaults=arguments.kw_defaults,
        kwarg=arguments.kwarg,
        defaults=arguments.defaults,
    )
    text = ast.unparse(shown)
    if _waits(node) == "with":
        returns = returns.removeprefix("Iterator[").removesuffix("]")
    ends = f" -> {returns}" if returns not in ("", "None") else ""
    return f"{node.name}({text}){ends}"


def _waits(node: _Function) -> str:
    """How it is used; empty for a function that is called."""
    if any("contextmanager" in ast.unparse(mark) for mark in node.decorator_list):
        return "with"
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
                kind = f": {member.returns}" if member.returns else ""
                member = member._replace(signature=each.name, full=f"{each.name}{kind}")
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
    named = [f"**{node.args.kwarg.arg}"] if node.args.kwarg else []
    marked = ["*"] if node.args.kwonlyargs and not starred else []
    only = [
        each.arg + (f"={ast.unparse(default)}" if default else "")
        for each, default in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
    ]
    required = len(plain) - len(defaults)
    given = plain[:required] + [a + d for a, d in zip(plain[required:], defaults, strict=True)]
    return ", ".join((*given, *starred, *marked, *only, *named))


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
