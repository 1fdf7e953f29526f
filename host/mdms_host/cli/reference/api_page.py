"""`docs/api.md`: what `import mdms_array as mdms` offers, from its `__all__` and the docstrings."""

from collections.abc import Iterator

from mdms_host.cli.reference.names import Name, names_of

#: The package that users import.
PACKAGE = "mdms_array"
#: The names of the package, by what they are for.
SECTIONS = {
    "Run a scenario": ("simulate", "Run", "ParcelRun", "WheelRun", "Incident"),
    "Sweeps": (
        *("sweep", "SweepResult", "Progress", "Distribution"),
        *("uniform", "log_uniform", "integers", "run_seed"),
    ),
    "A table by hand": ("virtual", "connect", "BlockingTable", "BlockingParcel"),
    "Programs": ("Table", "TableParcel", "Newcomer", "tasks"),
    "Run folders": ("read_run", "write_run", "StoredRun"),
    "Errors": (
        *("Error", "InputError", "ProgramError", "RunError", "TimeLimitError", "FaultError"),
        *("LostError", "StoppedError", "FailedError", "ViolationError"),
    ),
}
#: What objects of the package hold, by the module that defines it.
HELD = {
    "mdms_model.run.record": ("Record", "Contact", "Event", "Plan", "Tile"),
    "mdms_host.motion.outcome": ("GoalOutcome",),
    "mdms_sim.simulation": ("BusFigures",),
    "mdms_sim.referee.rules": ("Violation",),
}
_HEAD = """\
# Python API

`import mdms_array as mdms` is the one package to import. All else may change without a word.

Written by `make generate` from the `__all__` and the docstrings of `mdms_array`; change those.
Names end with their SI unit; what has none has it in brackets. Shapes of arrays are in parentheses.
[Programs](programs.md) says how programs are written, [scenarios](scenarios.md) has every key of a
`Scenario`, and [researcher](researcher.md) where the paper's equations are.
"""


def text() -> str:
    """The whole page; the same sources give the same text."""
    public = {name.name: name for name in names_of(PACKAGE)}
    parts = [_HEAD]
    for title, listed in SECTIONS.items():
        parts.append(_section(title, [public[name] for name in listed]))
    parts.append(_section("What a run holds", held()))
    return "\n".join(parts)


def held() -> list[Name]:
    """What objects of the package hold, and is no name of it."""
    return [name for module, listed in HELD.items() for name in names_of(module, listed)]


def _section(title: str, names: list[Name]) -> str:
    rows = [row for name in names for row in _rows(name)]
    return "\n".join((f"## {title}", "", "| name | meaning |", "| --- | --- |", *rows, ""))


def _rows(name: Name) -> Iterator[str]:
    yield row_of(name)
    for member in name.members:
        yield row_of(member, ".")


def row_of(name: Name, dot: str = "") -> str:
    """One name as a row of a table; a member's begins with a dot."""
    call = f"{dot}{name.full or name.signature}".replace(" | ", " or ")
    return f"| {f'{name.waits} `{call}`'.strip()} | {name.words} |"
