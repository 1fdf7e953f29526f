"""`docs/programs.md`: tasks of a file and what a program in Python has, from the code."""

from collections.abc import Iterable

from mdms_host.cli.reference.api_page import row_of
from mdms_host.cli.reference.keys import list_in, table_of
from mdms_host.cli.reference.names import Name, names_of
from mdms_model.scenario.run_rules import ALLOWED, NEEDED
from mdms_model.scenario.scenario import Task

_HEAD = """\
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
"""
#: Methods for the driver of a table, and not for programs.
_DRIVEN: set[str] = set()


def text() -> str:
    """The whole page; the same code gives the same text."""
    table = names_of("mdms_host.programs.table")
    tasks = names_of("mdms_host.programs.tasks")
    return "\n".join(
        (
            _HEAD,
            list_in(Task),
            _needs(),
            table_of(Task),
            _PYTHON,
            *(_names(f"`{each.name}`", each.words, each.members) for each in table if each.members),
            _names("`mdms_host.programs.tasks`", "Coroutines for the usual jobs.", tasks),
        )
    )


def _needs() -> str:
    rows = [f"| `{do}` | {_keys(NEEDED[do])} | {_keys(ALLOWED[do])} |" for do in NEEDED]
    return "\n".join(("| task | needs | may have |", "| --- | --- | --- |", *rows, ""))


def _keys(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "-"


def _names(title: str, words: str, names: Iterable[Name]) -> str:
    rows = [row_of(name) for name in names if name.name not in _DRIVEN]
    head = (f"### {title}", "", words, "", "| name | meaning |", "| --- | --- |")
    return "\n".join((*head, *rows, ""))
