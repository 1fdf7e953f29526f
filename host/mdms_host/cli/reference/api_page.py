"""`docs/api.md`: every public name of Python, from `__all__` and the docstrings."""

from collections.abc import Iterator

from mdms_host.cli.reference.names import Name, module_words, names_of

#: What is public, by what it is for; each module lists its names in `__all__`.
MODULES = {
    "`import mdms_array as mdms`": (
        "mdms_array.simulation",
        "mdms_array.connection",
        "mdms_array.table",
        "mdms_array.run",
        "mdms_model.errors",
    ),
    "Scenarios and records": (
        "mdms_model.scenario.file",
        "mdms_model.scenario.scenario",
        "mdms_array.figures",
        "mdms_model.run.record",
        "mdms_model.run.folder",
    ),
    "Programs": ("mdms_host.programs.table", "mdms_host.programs.tasks"),
    "The paper's bounds, fields and squeezes": (
        "mdms_model.motor",
        "mdms_model.statics.limits",
        "mdms_model.fields.command",
        "mdms_model.squeeze.turning",
        "mdms_model.squeeze.plan",
    ),
    "Parts of the host": (
        "mdms_host.layout",
        "mdms_host.estimation.tracker",
        "mdms_host.routes.planner",
    ),
    "The virtual array": ("mdms_sim.simulation",),
}
_HEAD = """\
# Python API

Written by `make generate` from the `__all__` and the docstrings of the modules named here; change
those. Names end with their SI unit; what has none has it in brackets. Shapes of arrays are in
parentheses. What stands in no `__all__` may change without a word.
"""


def text() -> str:
    """The whole page; the same sources give the same text."""
    parts = [_HEAD]
    for title, modules in MODULES.items():
        parts.append(f"## {title}\n")
        parts += [_section(module) for module in modules]
    return "\n".join(parts)


def _section(module: str) -> str:
    rows = [row for name in names_of(module) for row in _rows(name)]
    head = (f"### `{module}`", "", module_words(module), "", "| name | meaning |", "| --- | --- |")
    return "\n".join((*head, *rows, ""))


def _rows(name: Name) -> Iterator[str]:
    yield row_of(name)
    for member in name.members:
        yield row_of(member, ".")


def row_of(name: Name, dot: str = "") -> str:
    """One name as a row of a table; a member's begins with a dot."""
    call = f"{dot}{name.signature}".replace(" | ", " or ")
    return f"| {f'{name.waits} `{call}`'.strip()} | {name.words} |"
