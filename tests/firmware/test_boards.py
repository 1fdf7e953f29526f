"""The boards on MicroPython, with peripherals that remember what they were told."""

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BOARDS = HERE.parents[1] / "firmware" / "boards"
MODULES = ("on_board", "on_board_storage")
FILES = (
    BOARDS,
    *(HERE / f"{module}.py" for module in MODULES),
    *sorted((HERE / "fakes").glob("*.py")),
)
TESTS = [
    (module, node.name)
    for module in MODULES
    for node in ast.parse((HERE / f"{module}.py").read_text()).body
    if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
]


@pytest.mark.parametrize("board", ["pybv11", "nucleo_g474re"])
@pytest.mark.parametrize(("module", "name"), TESTS)
def test_board(micropython, board, module, name):
    printed = micropython(f"import {module}; {module}.run({board!r}, {name!r})", *FILES)
    assert printed.endswith("done\n")
