"""Each pin of a board is that of the wiring table, as MicroPython finds its name."""

import ast
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
BOARDS = ROOT / "firmware" / "boards"
PAGE = (ROOT / "docs" / "boards.md").read_text()
FAKES = ROOT / "tests" / "firmware" / "fakes"
#: The processor's pin of a board's name.
found = runpy.run_path(str(FAKES / "pin_names.py"))["found"]
COLUMNS = ("teensy41", "weact_h743", "nucleo_g474re", "pybv11")
CAN_ROW = "CAN RX, TX (transceiver at 3.3 V, its standby pin low)"
LED_ROW = "run LED, error LED"
#: The rows of the wiring table, with the signals in their order.
ROWS = {
    "encoder 1 A, B": ("encoders 0", "encoders 1"),
    "encoder 2 A, B": ("encoders 2", "encoders 3"),
    "bridge 1 enable (PWM), phase": ("pulses 0", "phases 0"),
    "bridge 2 enable (PWM), phase": ("pulses 1", "phases 1"),
    "both bridges sleep, 10 kOhm to ground": ("wake 0",),
    "both bridges fault": ("fault 0",),
    "current sense 1, 2": ("currents 0", "currents 1"),
    "motor supply over 100 kOhm / 8.2 kOhm": ("supply 0",),
    "presence: centre, +x+y, -x+y, -x-y, +x-y": tuple(f"sensors {bit}" for bit in range(5)),
    "place code, bits 0 to 5 and parity, each jumper to ground is a 1": tuple(
        f"place {bit}" for bit in range(7)
    ),
    LED_ROW: ("run_led 0", "error_led 0"),
}


def pins(board):
    """All pins of a board's wiring but CAN's, by their purpose."""
    for node in ast.parse((BOARDS / f"{board}.py").read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PINS":
            assert isinstance(node.value, ast.Call)
            values = {each.arg: each.value for each in node.value.keywords}
            values = {
                key: ast.literal_eval(value)
                for key, value in values.items()
                if key not in {"filters", "receive"}
            }
            return dict(named_in(values))
    raise AssertionError(board)


def named_in(values):
    """Names of pins and the purpose of each, without numbers."""
    for key, value in values.items():
        items = value if isinstance(value, tuple) else (value,)
        flat = [each for item in items for each in (item if isinstance(item, tuple) else (item,))]
        for number, name in enumerate(each for each in flat if isinstance(each, str)):
            yield f"{key} {number}", name


def wired(board):
    """The pins in the wiring table, by row, as the processor's."""
    rows = {}
    for line in PAGE.split("## Wiring")[1].split("\n## ")[0].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == len(COLUMNS) + 1:
            cell = cells[1 + COLUMNS.index(board)]
            names = re.findall(r"\bP[A-E]\d+\b", cell) or re.findall(r"\b[DXY]\d+\b", cell)
            rows[cells[0]] = [
                name if name.startswith("P") else found(board, name) for name in names
            ]
    return rows


@pytest.mark.parametrize("board", COLUMNS)
def test_no_two_signals_share_a_pin(board):
    used = [found(board, name) for name in pins(board).values()] + wired(board)[CAN_ROW]
    assert len(used) == len({*used}), sorted(used)


@pytest.mark.parametrize("board", COLUMNS)
def test_pins_are_those_of_the_wiring_table(board):
    rows, named = wired(board), pins(board)
    if board == "pybv11":  # the table has the colours of its LEDs
        rows[LED_ROW] = ["PA14", "PA13"]
    for row, signals in ROWS.items():
        assert rows[row] == [found(board, named.pop(signal)) for signal in signals], row
    assert not named
