"""Cells on a table of three columns, and functions for the tests of `mdms commission`."""

import io

import pytest

from mdms_protocol import indices
from mdms_protocol.codecs import cob

NONE = cob.NODE_NONE
GRID = ("--columns", "3", "--rows", "1")
#: Serial numbers of the bank's cells are 1 to 3, as their node ids; so they stand, along x first.
ORDER = (2, 3, 1)
#: In the table of two rows.
ORDER_6 = (4, 2, 6, 1, 3, 5)
blank = pytest.mark.parametrize("cells", [(NONE,) * 6], indirect=True)


def serials(bus, cells=3):
    return [bus.read(node_id, indices.IDENTITY, 4) for node_id in range(1, cells + 1)]


def answered(monkeypatch, *answers):
    """A terminal at which somebody types these lines."""
    terminal = io.StringIO("".join(f"{answer}\n" for answer in answers))
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
