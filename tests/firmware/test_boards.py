"""The boards on MicroPython, with peripherals that remember what they were told."""

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BOARDS = HERE.parents[1] / "firmware" / "boards"
MODULES = ("on_board", "on_board_storage")
#: What only one of the boards has.
OF_ONE = {"on_sectors": "pybv11", "on_littlefs": "pybv11"}
FILES = (
    BOARDS,
    *(HERE / f"{module}.py" for module in (*MODULES, *OF_ONE)),
    *sorted((HERE / "fakes").glob("*.py")),
    HERE.parent / "both" / "refusal.py",
)


def named_in(module: str) -> list[str]:
    body = ast.parse((HERE / f"{module}.py").read_text()).body
    functions = [node.name for node in body if isinstance(node, ast.FunctionDef)]
    return [name for name in functions if name.startswith("test_")]


TESTS = [
    (board, module, name)
    for module in (*MODULES, *OF_ONE)
    for board in ("pybv11", "nucleo_g474re")
    for name in named_in(module)
    if OF_ONE.get(module, board) == board
]


@pytest.mark.parametrize(("board", "module", "name"), TESTS)
def test_board(micropython, board, module, name):
    printed = micropython(f"import {module}; {module}.run({board!r}, {name!r})", *FILES)
    assert printed.endswith("done\n")
