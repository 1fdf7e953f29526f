"""The boards on MicroPython, with peripherals that remember what they were told."""

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BOARDS = HERE.parents[1] / "firmware" / "boards"
FILES = (BOARDS, HERE / "on_board.py", *sorted((HERE / "fakes").glob("*.py")))
TESTS = [
    node.name
    for node in ast.parse((HERE / "on_board.py").read_text()).body
    if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
]


@pytest.mark.parametrize("board", ["pybv11", "nucleo_g474re"])
@pytest.mark.parametrize("name", TESTS)
def test_board(micropython, board, name):
    printed = micropython(f"import on_board; on_board.run({board!r}, {name!r})", *FILES)
    assert printed == "done\n"
