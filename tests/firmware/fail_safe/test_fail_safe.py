"""The fail-safe table of docs/faults.md, row by row on a real MicroPython process."""

import ast
import re
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FIRMWARE = HERE.parents[2] / "firmware"
DOCS = HERE.parents[2] / "docs"
#: Where the tests of the rows about cells that steer are.
STEERING = (HERE.parents[1] / "both" / "neighbours", HERE.parents[1] / "system" / "cells")
#: Where the tests of the rows are.
MODULES = ("fail_safe_bus", "fail_safe_wheels", "fail_safe_program")
FILES = (
    FIRMWARE / "boards",
    HERE / "fail_safe_bench.py",
    *(HERE / f"{module}.py" for module in MODULES),
    HERE / "pauses.py",
    *sorted((HERE.parent / "fakes").glob("*.py")),
)


def rows() -> list[str]:
    """The last column of the table under the heading 'Fail safe'."""
    text = (DOCS / "faults.md").read_text().split("\n## Fail safe")[1].split("\n## ")[0]
    return re.findall(r"\| `(\w+)` \|$", text, re.MULTILINE)


def functions() -> dict[str, str]:
    """The module of each function that takes a bench alone, by the function's name."""
    return {
        node.name: module
        for module in MODULES
        for node in ast.parse((HERE / f"{module}.py").read_text()).body
        if isinstance(node, ast.FunctionDef)
        and [each.arg for each in node.args.args] == ["bench"]
        and node.args.vararg is None
    }


def test_every_row_has_a_test_and_every_test_a_row():
    assert set(rows()) == set(functions())


def test_every_row_about_cells_that_steer_has_its_test():
    text = (DOCS / "cells.md").read_text().split("## What feeds the wheels")[1].split("\n\n")[2]
    lines = text.splitlines()[2:]
    names = [re.findall(r"\| `(test_\w+)` \|$", line) for line in lines]
    sources = [path.read_text() for folder in STEERING for path in folder.glob("test_*.py")]
    assert len(lines) > 10
    for line, name in zip(lines, names, strict=True):
        assert name, f"no test: {line}"
        assert any(f"def {name[0]}(" in source for source in sources), name


@pytest.mark.parametrize("board", ["pybv11", "teensy41"])
@pytest.mark.parametrize("row", rows())
def test_row(micropython, row, board):
    module = functions()[row]
    code = f"import fail_safe_bench, {module}; fail_safe_bench.run({module}.{row}, {board!r})"
    assert micropython(code, *FILES) == "done\n"


def test_collection_between_any_two_steps_delays_no_tick_and_loses_no_frame(micropython):
    printed = micropython("import pauses; pauses.run()", *FILES)
    assert int(printed.split()[1]) >= 10
