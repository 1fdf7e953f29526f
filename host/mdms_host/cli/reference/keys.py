"""Keys of a table of a scenario and their units, read off the dataclass that checks them."""

import ast
import dataclasses
import inspect
import textwrap
from types import NoneType, UnionType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from mdms_model.scenario.limit import Limit

#: Ending of a name and the unit, longer endings before those that they end with.
UNITS = (
    ("_kg_m2", "kg m2"),
    ("_nm_per_a", "N m/A"),
    ("_vs_per_m", "V s/m"),
    ("_s_per_m", "s/m"),
    ("_rad_s2", "rad/s2"),
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s2"),
    ("_m_s", "m/s"),
    ("_per_s", "1/s"),
    ("_n_s", "N s"),
    ("_nms", "N m s"),
    ("_ohm", "ohm"),
    ("_ppm", "ppm"),
    ("_deg", "degrees"),
    ("_rad", "rad"),
    ("_kg", "kg"),
    ("_mm", "mm"),
    ("_ms", "ms"),
    ("_ns", "ns"),
    ("_m2", "m2"),
    ("_m", "m"),
    ("_s", "s"),
    ("_n", "N"),
    ("_v", "V"),
    ("_a", "A"),
)


def unit_of(name: str) -> str:
    """The unit that a name ends with; empty for a name without one."""
    return next((unit for ending, unit in UNITS if name.endswith(ending)), "")


_WORDS = {float: "number", int: "whole number", str: "text", bool: "true or false", dict: "table"}
_MANY = {float: "numbers", int: "whole numbers", str: "texts"}
_SIGNS = {"above": "> ", "at_least": ">= ", "at_most": "<= "}
COLUMNS = ("key", "type", "unit", "limits", "default", "meaning")


class Key(NamedTuple):
    """One key, in words."""

    name: str
    type: str
    unit: str
    limits: str
    default: str
    meaning: str


def keys_of(kind: type[Any]) -> list[Key]:
    """The keys of a table, in the order of its fields."""
    hints, meanings = get_type_hints(kind), meanings_of(kind)
    return [
        Key(
            f"`{item.name}`",
            _type(hints[item.name]),
            unit_of(item.name),
            _limits(item.metadata),  # type: ignore[arg-type]
            _default(item),
            meanings.get(item.name, ""),
        )
        for item in dataclasses.fields(kind)
    ]


def meanings_of(kind: type[Any]) -> dict[str, str]:
    """The line below each field of a dataclass, and of those that it is derived from."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        if dataclasses.is_dataclass(each):
            found |= _below_fields(each)
    return found


def _below_fields(kind: type[Any]) -> dict[str, str]:
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(node, ast.ClassDef)
    return {
        field.target.id: text.value.value
        for field, text in zip(node.body, node.body[1:], strict=False)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def table_of(kind: type[Any]) -> str:
    """The keys of a table as a table of Markdown."""
    rows = [COLUMNS, ("---",) * len(COLUMNS), *keys_of(kind)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def list_in(kind: type[Any]) -> str:
    """The list in a dataclass's docstring: what each kind of it is."""
    text = inspect.getdoc(kind) or ""
    begin = text.index("- ")
    lines = text[begin:].split("\n\n")[0]
    return "\n".join(_bold(line) for line in lines.splitlines()) + "\n"


def _bold(line: str) -> str:
    if not line.startswith("- "):
        return line
    name, colon, meaning = line[2:].partition(":")
    return f"- `{name}`{colon}{meaning}"


def _type(kind: Any) -> str:
    if isinstance(kind, UnionType):
        kind = next(choice for choice in get_args(kind) if choice is not NoneType)
    if dataclasses.is_dataclass(kind):
        return "table"
    if get_origin(kind) is tuple:
        return _list(get_args(kind))
    return _WORDS[get_origin(kind) or kind]


def _list(kinds: tuple[Any, ...]) -> str:
    first, many = kinds[0], kinds[-1] is Ellipsis
    if dataclasses.is_dataclass(first) or isinstance(first, str):
        return "list of tables"
    if get_origin(first) is tuple:
        inner = get_args(first)
        within = "lists" if inner[-1] is Ellipsis else "pairs"
        return f"{'list of' if many else len(kinds)} {within} of {_MANY[inner[0]]}"
    return f"list of {_MANY[first]}" if many else f"pair of {_MANY[first]}"


def _limits(limit: Limit) -> str:
    if choices := limit.get("choices"):
        return ", ".join(f"`{choice}`" for choice in choices)
    bounds = [f"{sign}{limit[name]:.10g}" for name, sign in _SIGNS.items() if name in limit]  # type: ignore[literal-required]
    if items := limit.get("items"):
        bounds.append(f"{items[0]} to {items[1]} items")
    return ", ".join(bounds)


def _default(item: dataclasses.Field[Any]) -> str:
    if item.default_factory is not dataclasses.MISSING:
        return "its defaults" if dataclasses.is_dataclass(item.default_factory) else "empty"
    value = item.default
    if value is dataclasses.MISSING:
        return "required"
    if value is None or value == ():
        return "none"
    if isinstance(value, tuple) and dataclasses.is_dataclass(value[0]):
        return f"{len(value)} with its defaults"
    return _shown(value)


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    return (f"`{value}`" if value else "empty") if isinstance(value, str) else f"{value:.10g}"
