"""The boards on MicroPython, with peripherals that remember their commands."""

import ast
from pathlib import Path

import pytest

from mdms_host.flashing.board_survey import MACHINES

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
BOARDS = ROOT / "firmware" / "boards"
MODULES = ("on_board", "on_board_bus", "on_board_storage")
#: Modules of tests for a single board.
OF_ONE = {"on_sectors": "pybv11", "on_littlefs": "teensy41"}
NAMES = ("teensy41", "weact_h743", "nucleo_g474re", "pybv11")  # as in the table of the wiring
FILES = (
    BOARDS,
    ROOT / "firmware" / "main.py",
    *(HERE / f"{module}.py" for module in (*MODULES, *OF_ONE)),
    *sorted((HERE.parent / "fakes").glob("*.py")),
    ROOT / "tests" / "both" / "bench" / "refusal.py",
)


def named_in(module: str) -> list[str]:
    body = ast.parse((HERE / f"{module}.py").read_text()).body
    functions = [node.name for node in body if isinstance(node, ast.FunctionDef)]
    return [name for name in functions if name.startswith("test_")]


TESTS = [
    (board, module, name)
    for module in (*MODULES, *OF_ONE)
    for board in NAMES
    for name in named_in(module)
    if OF_ONE.get(module, board) == board
]


@pytest.mark.parametrize(("board", "module", "name"), TESTS)
def test_board(micropython, board, module, name):
    printed = micropython(f"import {module}; {module}.run({board!r}, {name!r})", *FILES)
    assert printed.endswith("done\n")


@pytest.mark.parametrize(
    ("machine", "name"),
    [
        ("Teensy 4.1 with MIMXRT1062DVJ6A", "teensy41"),
        ("WEACTSTUDIO_MINI_STM32H743 with STM32H743VIT6", "weact_h743"),
        ("PYBv1.1 with STM32F405RG", "pybv11"),
        ("NUCLEO-G474RE with STM32G474", "nucleo_g474re"),
    ],
)
def test_board_is_found_by_its_name_in_micropython(micropython, machine, name):
    asked = (
        f"from bench import Bench; Bench({name!r}); "
        f"from boards.detect import board_module; print(board_module({machine!r}).__name__)"
    )
    assert micropython(asked, *FILES).strip() == f"boards.{name}"
    found = next(module for part, module in MACHINES.items() if part in machine)
    assert found == name


def test_unknown_board_is_refused(micropython):
    code = """
from boards.detect import board_module
try:
    board_module("Raspberry Pi Pico with RP2040")
except RuntimeError as error:
    print(error)
"""
    assert micropython(code, *FILES) == (
        "there is no board module for Raspberry Pi Pico with RP2040\n"
    )
