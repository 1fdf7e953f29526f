"""Plain tables to frozen dataclasses and back, checked by the fields' types and limits.

Nothing here depends on the scenario: a key that is added to its dataclasses needs no word here.
"""

import dataclasses
import difflib
import math
import operator
import sys
from collections.abc import Mapping
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from mdms_model.scenario.scenario import ScenarioError

KINDS: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    str: "text",
    bool: "true or false",
}
BOUNDS = {"above": operator.gt, "at_least": operator.ge, "at_most": operator.le}


def build(kind: type[Any], tree: Any, path: str = "") -> Any:
    """The dataclass `kind` filled from a table. Raises `ScenarioError` with the key's full path."""
    _table(tree, path or "the scenario")
    values = build_values(kind, tree, path)
    for item in dataclasses.fields(kind):
        if item.name not in tree and _is_required(item):
            expected = _expected(get_type_hints(kind)[item.name])
            raise ScenarioError(f"{_join(path, item.name)} is missing; give it {expected}")
    return kind(**values)


def build_values(kind: type[Any], tree: Mapping[str, Any], path: str) -> dict[str, Any]:
    """The fields of `kind` that a table gives, checked. Raises `ScenarioError`."""
    hints = get_type_hints(kind)
    _refuse_unknown(tree, hints, path)
    return {
        item.name: _value(hints[item.name], tree[item.name], item.metadata, _join(path, item.name))
        for item in dataclasses.fields(kind)
        if item.name in tree
    }


def spell_out(kind: Any, tree: Any) -> Any:
    """The same tables with every default written out, unchecked."""
    if isinstance(tree, list) and get_origin(kind) is tuple:
        return [spell_out(get_args(kind)[0], item) for item in tree]
    if not isinstance(tree, dict) or not dataclasses.is_dataclass(kind):
        return tree
    hints = get_type_hints(kind)
    full = {key: spell_out(_present(hints.get(key)), value) for key, value in tree.items()}
    for item in dataclasses.fields(kind):
        if item.name not in full and not _is_required(item):
            default = item.default_factory if callable(item.default_factory) else None
            value = plain(default() if default else item.default)
            full |= {} if value is None else {item.name: value}
    return full


def plain(value: Any) -> Any:
    """Dataclasses as tables and tuples as lists, `None` left out; what `build` reads back."""
    if dataclasses.is_dataclass(value):
        pairs = ((item.name, getattr(value, item.name)) for item in dataclasses.fields(value))
        return {name: plain(member) for name, member in pairs if member is not None}
    return [plain(item) for item in value] if isinstance(value, tuple) else value


def _value(kind: Any, value: Any, limit: Mapping[str, Any], key: str) -> Any:
    kind = _present(kind)
    if dataclasses.is_dataclass(kind):
        return build(kind, value, key)  # type: ignore[arg-type]
    if get_origin(kind) is tuple:
        return _items(get_args(kind), value, limit, key)
    if get_origin(kind) is dict:
        # Its keys are names of the scenario, which whoever reads it checks.
        return _table(value, key)
    if not _is_a(kind, value):
        raise ScenarioError(f"{key} is {_shown(value)}, but must be {_expected(kind)}")
    if kind is str:
        return _choice(value, limit, key)
    return value if kind is bool else _number(kind, value, limit, key)


def _table(value: Any, key: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ScenarioError(f"{key} is {_shown(value)}, but must be a table")
    return value


def _items(kinds: tuple[Any, ...], value: Any, limit: Mapping[str, Any], key: str) -> Any:
    if not isinstance(value, list):
        raise ScenarioError(f"{key} is {_shown(value)}, but must be a list")
    if kinds[-1] is not Ellipsis:
        low = high = len(kinds)
    else:
        kinds = (kinds[0],) * len(value)
        low, high = limit.get("items", (0, math.inf))
    if not low <= len(value) <= high:
        count = f"{low}" if low == high else f"{low} to {high}"
        raise ScenarioError(f"{key} has {len(value)} items, but must have {count}")
    inner = {name: bound for name, bound in limit.items() if name != "items"}
    pairs = enumerate(zip(kinds, value, strict=True))
    return tuple(_value(kind, item, inner, f"{key}.{number}") for number, (kind, item) in pairs)


def _number(kind: Any, value: Any, limit: Mapping[str, Any], key: str) -> Any:
    if not abs(value) <= sys.float_info.max:
        raise ScenarioError(f"{key} is {_shown(value)}, but must be a finite number")
    if any(name in limit and not holds(value, limit[name]) for name, holds in BOUNDS.items()):
        hint = degrees_hint(value) if key.endswith("_rad") else ""
        raise ScenarioError(f"{key} is {_shown(value)}, but must be {_range(limit)}{hint}")
    return kind(value)


def degrees_hint(value: float) -> str:
    """The radians of an angle that was written in degrees."""
    return f"; {value:g} degrees are {math.radians(value):.4g} rad"


def _range(limit: Mapping[str, Any]) -> str:
    bounds = (f"{name.replace('_', ' ')} {limit[name]:g}" for name in BOUNDS if name in limit)
    return " and ".join(bounds)


def _choice(value: str, limit: Mapping[str, Any], key: str) -> str:
    choices = limit.get("choices")
    if choices and value not in choices:
        raise ScenarioError(f"{key} is {value!r}, but must be one of {', '.join(choices)}")
    return value


def _refuse_unknown(tree: Mapping[str, Any], known: Mapping[str, Any], path: str) -> None:
    for name in tree:
        if name not in known:
            close = difflib.get_close_matches(str(name), known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"known here: {', '.join(known)}"
            raise ScenarioError(f"{_join(path, name)} is not a known key; {hint}")


def _is_a(kind: Any, value: Any) -> bool:
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is kind


def _present(kind: Any) -> Any:
    """The type of an optional key's value."""
    if get_origin(kind) is UnionType:
        return next(choice for choice in get_args(kind) if choice is not NoneType)
    return kind


def _is_required(item: dataclasses.Field[Any]) -> bool:
    return item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING


def _expected(kind: Any) -> str:
    return KINDS.get(kind, "a list" if get_origin(kind) is tuple else "a table")


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name
