"""The pages of `docs/` that are made of the code: `python -m mdms_host.cli.reference.pages`.

`docs/scenarios.md` has every key of a scenario, from the dataclasses that check them. So has
`docs/programs.md` of tasks. `docs/line-registers.md` has the registers and nodes of a line. It runs
in a checkout. With `--check` it writes nothing and names stale pages.
"""

import sys
from pathlib import Path

from asyncua.ua import VariantType

from mdms_host.cli.reference.keys import list_in, table_of
from mdms_host.commissioning.doctor.findings import troubleshooting_text
from mdms_host.line.opcua import LINE_METHODS, METHODS, SHOWN
from mdms_host.line.packml import TRANSITIONS, Command, Done, State
from mdms_host.line.registers import ANSWERS, MAP, MAP_VERSION, Register
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import builtin_names, load_scenario
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

[Many parcels](parcels.md#programs) has what a table and a parcel offer. `mdms_array.tasks` has the
tasks above as coroutines. [The reference](python.rst) has all of it with types and errors.
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
filled up with 0. A write to any other register is answered by exception 2, a value that is refused
by exception 3.

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
again. One that is unannounced is not expected any more: announce it again, if it has not come.

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


_FOLDER = Path(__file__).parents[4] / "docs"


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
