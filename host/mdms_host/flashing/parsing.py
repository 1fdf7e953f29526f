"""Python that is read and never run: sources of the firmware, and replies of boards.

CPython 3.11 counts the depth of a tree in one place for all threads: two that parse at once may
both fail with a SystemError, where boards are flashed side by side.
"""

import ast
from threading import Lock
from typing import Any

_ONE_AT_A_TIME = Lock()


def tree_of(source: str) -> ast.Module:
    """The tree of a module. Raises SyntaxError."""
    with _ONE_AT_A_TIME:
        return ast.parse(source)


def value_of(text: str) -> Any:
    """The value of a literal of plain types. Raises ValueError, SyntaxError."""
    with _ONE_AT_A_TIME:
        return ast.literal_eval(text)
