"""The pages of `docs/` that are made of the code: `python -m mdms_host.cli.reference_pages`.

`docs/scenarios.md` has every key of a scenario, from the dataclasses that check them. So has
`docs/programs.md` of tasks. `docs/line-registers.md` has the registers and nodes of a line. It runs
in a checkout. With `--check` it writes nothing and names stale pages.
"""

import ast
import dataclasses
import inspect
import sys
import textwrap
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from asyncua.ua import VariantType

from mdms_host.commissioning.doctor.findings import troubleshooting_text
from mdms_host.line.opcua import LINE_METHODS, METHODS, SHOWN
from mdms_host.line.packml import TRANSITIONS, Command, Done, State
from mdms_host.line.registers import ANSWERS, MAP, MAP_VERSION, Register
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import builtin_names, load_scenario
from mdms_model.scenario.limit import Limit
from mdms_model.scenario.motion import Motion, Part, Region
from mdms_model.scenario.run_rules import ALLOWED, NEEDED
from mdms_model.scenario.scenario import (
    Array,
    Cell,
    Exit,
    Goal,
    Parcel,
    Patch,
    Run,
    Scenario,
    Signal,
    Stop,
    Stream,
    Task,
    Wheel,
    Wire,
)
from mdms_protocol.generators.generate import write_or_check

# Keys of a table and their units, read off the dataclass that checks them -------------------------

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


# Pages --------------------------------------------------------------------------------------------

_PROGRAM_HEAD = """\
# Programs

Written by `make generate` from the code that checks and runs them; change that. A program moves
many parcels. It is a file of tasks, or Python. Both run in virtual time (`mdms simulate`), on a
served array and on hardware (`mdms run`). [Integrator](integrator.md) leads from a sorter to a
program.

## Files of tasks

A scenario with `motion.field = "program"` and its `[[task]]`s, which follow one another:

```toml
scenario = "swap2"           # its table and parcels; keys here are added, or replace its own
title = "Two parcels change places, and back"

[[task]]
do = "swap"
parcels = ["box", "disc"]

[[task]]
do = "swap"
parcels = ["box", "disc"]
```
"""
_PYTHON = """\
## Python

A file with `SCENARIO`, a name or a file beside it, and `main`:

```python
SCENARIO = "array18"


async def main(table):
    box = table["box"]
    await box.move(0.10, 0.0, 0.2)  # x [m], y [m], yaw [rad]
    await table.sleep(1.0)
    await box.move(-0.10, 0.0, 0.0)
```

An `await` takes as long as the table takes for it. A started routine goes on beside all else. There
is no clock and no thread in a program: use `table.sleep` and `table.now_s`. An impossible order is
a `ProgramError`: catch it, or the program ends with it and all parcels are brought to rest.

[Many parcels](parcels.md#programs) lists the calls of a table and of a parcel. `mdms_array.tasks`
has the tasks above as coroutines. [The reference](python.rst) has all of it with types and errors.
"""


def program_text() -> str:
    """The whole page; the same code gives the same text."""
    return "\n".join((_PROGRAM_HEAD, list_in(Task), _needs(), table_of(Task), _PYTHON))


def _needs() -> str:
    rows = [f"| `{do}` | {_keys(NEEDED[do])} | {_keys(ALLOWED[do])} |" for do in NEEDED]
    return "\n".join(("| task | needs | may have |", "| --- | --- | --- |", *rows, ""))


def _keys(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "-"


_SCENARIO_HEAD = """\
# Scenarios

Written by `make generate` from the dataclasses of `sim_bus/mdms_model/scenario` that check every
file; change those. A scenario is a TOML file: the table, its parcels, the motion, and the run.
Everything is in SI units, which the keys end with. Places are in the table frame. Its origin is the
centre of the array, x runs along the columns, and angles are counterclockwise. Cells are numbered
from 1, along x first.

```sh
mdms scenarios                               # the built-in ones
mdms scenarios --show array18 > box.toml     # one of them as a file to start from
mdms simulate box.toml --set parcel.0.x_m=-0.05 --set run.duration_s=2
```

`--set` takes a dotted path into the file, items of lists by number from 0. An unknown key, a wrong
type and a value out of its limits are refused (exit code 2). The message has the key's full path
and the expected value. Keys that contradict each other are refused too. A file may begin with
`scenario = "array18"`, the name of a scenario or of a file beside it. Then it has only the
differences: its tables add to those of the other, and its lists take their place.
"""
_TABLES = (
    ("The file", Scenario, ""),
    ("`[array]`", Array, ""),
    ("`[cell]`", Cell, "Only `firmware` uses the keys between a voltage and a push."),
    ("`[[cell.wheel]]`", Wheel, ""),
    ("`[[patch]]`", Patch, ""),
    ("`[[parcel]]`", Parcel, "At rest at the start, or in stock of a stream."),
    ("`goal` of a parcel", Goal, ""),
    (
        "`[motion]`",
        Motion,
        "References are the paper's r: a free wheel runs at (a/b) r, 0.775 r for its motor.",
    ),
    ("`[[motion.part]]`", Part, "Parts of `sum` and `regions`, which may have parts themselves."),
    ("`region`", Region, ""),
    ("`[run]`", Run, ""),
    ("`[wire]`", Wire, "Two SYNC periods fit into the 50 ms for which a cell keeps a setpoint."),
    ("`[stop]`", Stop, "Counts with `firmware`. An array file has the same table."),
    ("`[[stream]]`", Stream, "Needs `firmware`. A parcel that has left is in stock again."),
    ("`[[exit]]`", Exit, "An exit takes a parcel once no support holds it any more."),
    ("`[[signal]]`", Signal, "A program waits for it by `await table.signal(name)`."),
    ("`[[fault]]`", Fault, "Needs `firmware`. By kind:\n\n" + list_in(Fault).rstrip()),
)
_REST = """\
## `[[task]]`

One task of a program; see [programs](programs.md).

## `[belief]`

The host's beliefs that differ from the scenario: keys of `[cell]`, and of parcels by name, as in
`belief.box.length_m = 0.35`. The host has no data of a parcel with `belief.box.known = false`.
"""


def scenario_text() -> str:
    """The whole page; the same dataclasses give the same text."""
    sections = [
        "\n\n".join(part for part in (f"## {title}", words, table_of(kind)) if part)
        for title, kind, words in _TABLES
    ]
    return "\n".join((_SCENARIO_HEAD, _builtin(), *sections, _REST))


def _builtin() -> str:
    rows = [f"| `{name}` | {load_scenario(name).title} |" for name in builtin_names()]
    return "\n".join(("## Built in", "", "| name | title |", "| --- | --- |", *rows, ""))


_LINE_HEAD = """\
# Registers and nodes of a line

Written by `make generate` from the tables of `host/mdms_host/line` that serve them; change those.
[The table in a line](line.md) explains them.

## States and commands

Parcels may move in Execute and Completing alone. States without a command end by themselves.

| state | number | command | next state |
| --- | --- | --- | --- |
"""
_REGISTERS_HEAD = f"""
## Modbus TCP

Holding registers from address 0, version {MAP_VERSION} of the map. The functions are 3, 6, 16 and
23. Numbers of two registers have the high half first. Texts are ASCII, two characters a register,
filled up with 0. Requests with other characters are refused (`request_result` 2). A write to any
other register is answered by exception 2, a value that is refused by exception 3. Such a write
changes nothing. No state takes a mode and a recipe in one write.

| address | registers | name | access | meaning |
| --- | --- | --- | --- | --- |
"""
_NODES_HEAD = """
## OPC UA

The object `Table` has the type `PackMLBaseObjectType` of OPC 30050. Commands are methods of its
state machines. A command that is refused has the status `BadInvalidState`, and an event with the
reason. Arguments of a wrong type or number have the status `BadInvalidArgument`.

| object | method | command |
| --- | --- | --- |
"""
_LINE_NODES_HEAD = """
Its object `Line` (namespace `urn:mdms-array:line`) has what PackML has no place for. A client
writes another number into `ClientHeartbeat` at least twice a second. Its status must be good.
`Exits`, `ExitsFull`, `Recipes`, `Parcels` (with `X`, `Y`, `Yaw`, `Kind`) and `Cells` (with
`Enabled`) show the table. Events of the type `ParcelEvent` report parcels that are found, under
way, arrived, left, refused or lost. A parcel that was found by mistake is withdrawn, and expected
again. The event `unannounced` says that a parcel is not expected any more. Announce it again, if it
has not come.

| variable | type | meaning |
| --- | --- | --- |
"""


def line_text() -> str:
    """The whole page; the same tables give the same text."""
    states = [
        f"| {_word(state)} | {int(state)} | {_word(cause)} | {_word(after)} |"
        for (state, cause), after in sorted(TRANSITIONS.items(), key=lambda row: row[0][0])
    ]
    registers = [
        f"| {one.address} | {one.words} | `{one.name}` | {_access(one)} | {one.meaning} |"
        for one in sorted((*MAP, *ANSWERS), key=lambda one: one.address)
    ]
    methods = [
        f"| `{'/'.join(path)}` | `{name}` | {_word(command)} |" for path, name, command in METHODS
    ]
    shown = [f"| `{one.name}` | {one.kind.name} | {one.meaning} |" for one in SHOWN]
    calls = [
        f"| `{one.name}` | {_arguments(one.inputs)} | {_arguments(one.outputs)} | {one.meaning} |"
        for one in LINE_METHODS
    ]
    head = "\n| method | arguments | results | does |\n| --- | --- | --- | --- |\n"
    tables = (states, registers, methods, shown, calls)
    heads = (_LINE_HEAD, _REGISTERS_HEAD, _NODES_HEAD, _LINE_NODES_HEAD, head)
    return "".join(head + "\n".join(rows) + "\n" for head, rows in zip(heads, tables, strict=True))


def _word(cause: State | Command | Done) -> str:
    return "-" if isinstance(cause, Done) else cause.name.capitalize()


def _access(register: Register) -> str:
    return "write" if register.value is None and register in MAP else "read"


def _arguments(arguments: tuple[tuple[str, VariantType], ...]) -> str:
    return ", ".join(f"`{name}` {kind.name}" for name, kind in arguments) or "-"


_FOLDER = Path(__file__).parents[3] / "docs"


def outputs() -> dict[Path, str]:
    """The text of every page that is generated."""
    return {
        _FOLDER / "line-registers.md": line_text(),
        _FOLDER / "programs.md": program_text(),
        _FOLDER / "scenarios.md": scenario_text(),
        _FOLDER / "troubleshooting.md": troubleshooting_text(),
    }


if __name__ == "__main__":
    sys.exit(write_or_check(outputs(), sys.argv[1:]))
