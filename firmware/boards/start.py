"""What only the start needs: `main` loads it at power-up and forgets it before the loop begins."""

import sys

from mdms_cell.cell import Cell
from mdms_cell.runner import Runner


def this_board():
    """The board that this runs on, or None while its user button is held."""
    module = board_module()
    return None if module.held() else module.board()


def board_module():
    """The module of the board that this runs on."""
    machine = sys.implementation._machine
    if "PYBv1.1" in machine:
        from boards import pybv11 as module
    elif "G474" in machine:
        from boards import nucleo_g474re as module
    else:
        raise RuntimeError("there is no board module for " + machine)
    return module


def cell_on(board, node_id):
    """A cell on a board, and what runs both."""
    cell = Cell(board, node_id)
    return cell, Runner(board, cell)
