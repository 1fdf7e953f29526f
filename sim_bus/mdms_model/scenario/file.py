"""Scenario files: from a name, a TOML file or an earlier run's folder to a checked `Scenario`."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from mdms_model.errors import InputError
from mdms_model.scenario.rules import check_rules
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_model.scenario.tree import build, spell_out

SCENARIOS = Path(__file__).parent / "builtin"
#: A scenario may be based on another, and that on a third, but not without end.
_MOST_BASES = 3


def builtin_names() -> list[str]:
    """The names of the scenarios that come with the package."""
    return sorted(path.stem for path in SCENARIOS.glob("*.toml"))


def builtin_text(name: str) -> str:
    """A built-in scenario as its file has it, comments and all. Raises `ScenarioError`."""
    if name not in builtin_names():
        raise ScenarioError(
            f"{name}: no such built-in scenario; there are {', '.join(builtin_names())}"
        )
    return (SCENARIOS / f"{name}.toml").read_text("utf-8")


def load_scenario(name_or_path: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read and check a scenario: a built-in name, a TOML file, or the folder of an earlier run.

    `overrides` are texts KEY=VALUE, where KEY is a dotted path (items of lists by number) and
    VALUE is written as in TOML, or bare text. Raises `ScenarioError`.
    """
    tree = read_tree(name_or_path)
    if overrides:
        tree = spell_out(Scenario, tree)
    for override in overrides:
        set_value(tree, override)
    try:
        return scenario_from(tree)
    except ScenarioError as error:
        raise ScenarioError(f"{name_or_path}: {error}") from None


def scenario_from(tree: Any) -> Scenario:
    """The checked scenario that plain tables describe. Raises `ScenarioError`.

    Tables may name another `scenario`, as a file may.
    """
    try:
        scenario: Scenario = build(Scenario, _on_base(tree, None, _MOST_BASES))
    except RecursionError:
        raise ScenarioError("motion.part is nested too deeply; take fewer parts in parts") from None
    check_rules(scenario)
    return scenario


def read_tree(name_or_path: str | Path) -> Any:
    """The unchecked tables of a scenario. Raises `ScenarioError` when they cannot be read.

    A file may name another `scenario`, built in or beside it, and has only what differs then: its
    tables add to those of the other, and its lists take their place.
    """
    return _read_tree(name_or_path, _MOST_BASES)


def _read_tree(name_or_path: str | Path, bases: int) -> Any:
    path = _locate(name_or_path)
    return _on_base(_tables(path), path, bases)


def _on_base(tree: Any, path: Path | None, bases: int) -> Any:
    """The tables of a file, or of none, with those of the scenario that they name."""
    if not isinstance(tree, Mapping) or "scenario" not in tree:
        return tree
    base, own = tree["scenario"], {key: tree[key] for key in tree if key != "scenario"}
    if not isinstance(base, str) or not bases:
        where = "" if path is None else f"{path}: "
        raise ScenarioError(
            f"{where}scenario is {base!r}, but must be the name of a scenario, or of a file "
            f"beside this one, that is based on {_MOST_BASES} others at most"
        )
    beside = Path(base) if path is None else path.parent / base
    return _merged(_read_tree(beside if beside.is_file() else base, bases - 1), own)


def _merged(base: Any, own: Any) -> Any:
    """Tables of both, key by key; of everything else the own."""
    if not (isinstance(base, dict) and isinstance(own, dict)):
        return own
    return base | {key: _merged(base.get(key), value) for key, value in own.items()}


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises `InputError` that names the file."""
    try:
        return tomllib.loads(path.read_text("utf-8-sig"))
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no text in UTF-8; give a TOML file") from None
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: is nested too deeply; take fewer lists in lists") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _tables(path: Path) -> Any:
    try:
        if path.suffix != ".json":
            return read_toml(path)
        return json.loads(path.read_text("utf-8"))["scenario"]
    except InputError as error:
        raise ScenarioError(str(error)) from None
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ScenarioError(
            f"{path}: holds no scenario; give a TOML file or a run folder"
        ) from None


def _locate(name_or_path: str | Path) -> Path:
    if str(name_or_path) in builtin_names():
        return SCENARIOS / f"{name_or_path}.toml"
    path = Path(name_or_path)
    try:
        if (path / "meta.json").is_file():
            return path / "meta.json"
        there, is_folder = path.exists(), path.is_dir()
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    if not there:
        close = get_close_matches(str(name_or_path), builtin_names(), n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise ScenarioError(
            f"{path}: no such scenario file; {hint}built-in scenarios: {', '.join(builtin_names())}"
        )
    if is_folder:
        raise ScenarioError(
            f"{path}: not a run folder: it has no meta.json; give a TOML file or a run folder"
        )
    return path


def set_value(tree: Any, override: str) -> None:
    """Change one value of the tables by KEY=VALUE. Raises `ScenarioError` for a bad path."""
    key, equals, text = override.partition("=")
    if not equals or not all(key.strip().split(".")):
        raise ScenarioError(f"--set {override}: write KEY=VALUE, as in parcel.0.x_m=-0.30")
    set_key(tree, key.strip(), _value(text.strip()))


def set_key(tree: Any, key: str, value: Any) -> None:
    """Change the value of a dotted path into the tables. Raises `ScenarioError` for a bad path."""
    parts = key.split(".")
    if parts[0] == "scenario":
        # All keys are written out by now, and would replace those of the other.
        raise ScenarioError(
            f"{key} is {value!r}, but no key changes which scenario a run begins with; give the "
            "other scenario in place of this one"
        )
    at = tree
    for depth, part in enumerate(parts[:-1]):
        at = _step_into(at, part, ".".join(parts[:depth]))
    _assign(at, parts[-1], value, ".".join(parts[:-1]))


def _step_into(at: Any, part: str, path: str) -> Any:
    if isinstance(at, dict):
        return at.setdefault(part, {})
    return _list(at, path)[_index(at, part, path)]


def _assign(at: Any, part: str, value: Any, path: str) -> None:
    if isinstance(at, dict):
        at[part] = value
    else:
        _list(at, path)[_index(at, part, path)] = value


def _list(at: Any, path: str) -> list[Any]:
    if not isinstance(at, list):
        raise ScenarioError(f"{path} is {at!r} and has nothing inside to set")
    return at


def _index(items: list[Any], part: str, path: str) -> int:
    if not part.isdecimal() or int(part) >= len(items):
        raise ScenarioError(
            f"{path}.{part}: there is no such item; number {path} from 0 to {len(items) - 1}"
        )
    return int(part)


def _value(text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if len(parsed) == 1 else text
