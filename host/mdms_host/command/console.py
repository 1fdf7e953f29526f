"""What people see while a verb runs: messages and progress, on stderr and on a terminal only."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def say(message: str) -> None:
    """One line for people."""
    print(message, file=sys.stderr)


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """A bar to be told the share done, 0 to 1; nothing at all when stderr is no terminal."""
    if not sys.stderr.isatty():
        yield _ignore
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share: bar.update(task, completed=share)


def _ignore(_share: float) -> None:
    pass
