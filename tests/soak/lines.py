"""Which lines of the cell's firmware run in a function, on CPython."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any


def missed(folder: Path, function: Callable[[], object]) -> dict[str, tuple[list[int], int]]:
    """Call `function`; by module of `folder`, the lines of functions that did not run, and of all.

    Modules are told by their file names; those whose functions all ran are not left out.
    """
    ran: set[tuple[str, int]] = set()
    inside = str(folder)

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        if not frame.f_code.co_filename.startswith(inside):
            return None
        if event == "line":
            ran.add((frame.f_code.co_filename, frame.f_lineno))
        return trace

    sys.settrace(trace)
    try:
        function()
    finally:
        sys.settrace(None)
    return {path.name: _compare(path, ran) for path in sorted(folder.glob("*.py"))}


def _compare(path: Path, ran: set[tuple[str, int]]) -> tuple[list[int], int]:
    lines = set(_lines(compile(path.read_text(), str(path), "exec"), outermost=True))
    return sorted(line for line in lines if (str(path), line) not in ran), len(lines)


def _lines(code: CodeType, outermost: bool) -> Iterator[int]:
    """Lines of functions; those of modules and classes run when they are imported."""
    function = code.co_flags & 0x02  # CO_NEWLOCALS
    if not outermost and function:
        # The first line is that of `def`, which belongs to the code around it.
        yield from (line for _, _, line in code.co_lines() if line and line > code.co_firstlineno)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _lines(constant, outermost=False)
