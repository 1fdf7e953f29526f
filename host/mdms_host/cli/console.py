"""Output while a verb runs: messages and progress, on stderr and on a terminal only."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

#: Columns of a table where there is no terminal.
WIDE = 200


def show(table: Table) -> None:
    """A table on stdout, as wide as the terminal, or as it needs to be where there is none."""
    console = Console()
    if not console.is_terminal:
        console.width = WIDE
    console.print(table)


def dots() -> tuple[str, str]:
    """The signs of a covered sensor and of a free one on stdout."""
    return ("#", ".") if Console().options.ascii_only else ("●", "○")


@contextmanager
def bars(names: Iterable[str]) -> Iterator[Callable[[str, float], None]]:
    """A bar for each name, which shows the share done, 0 to 1; nothing where there is no terminal.

    They may be advanced from any thread.
    """
    if not sys.stderr.isatty():
        yield lambda _name, _share: None
        return
    with Progress(console=Console(stderr=True), transient=True) as drawn:
        tasks = {name: drawn.add_task(name, total=1.0) for name in names}
        yield lambda name, share: drawn.update(tasks[name], completed=share)


@contextmanager
def progress(what: str, total: float = 1.0) -> Iterator[Callable[[float], None]]:
    """A bar that shows how much of `total` is done; nothing at all when stderr is no terminal."""
    if not sys.stderr.isatty():
        yield _ignore
        return
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def working(what: str) -> Iterator[None]:
    """A moving line for a step without a measure; nothing at all when stderr is no terminal."""
    if not sys.stderr.isatty():
        yield
        return
    with Console(stderr=True).status(escape(what)):
        yield


def _ignore(_share: float) -> None:
    pass
