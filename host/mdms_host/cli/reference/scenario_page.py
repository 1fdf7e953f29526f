"""`docs/scenarios.md`: every key of a scenario, from the dataclasses that check them."""

from mdms_host.cli.reference.keys import list_in, table_of
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.file import builtin_names, load_scenario
from mdms_model.scenario.motion import Motion, Part, Region
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
    Wheel,
    Wire,
)

_HEAD = """\
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


def text() -> str:
    """The whole page; the same dataclasses give the same text."""
    sections = [
        "\n\n".join(part for part in (f"## {title}", words, table_of(kind)) if part)
        for title, kind, words in _TABLES
    ]
    return "\n".join((_HEAD, _builtin(), *sections, _REST))


def _builtin() -> str:
    rows = [f"| `{name}` | {load_scenario(name).title} |" for name in builtin_names()]
    return "\n".join(("## Built in", "", "| name | title |", "| --- | --- |", *rows, ""))
