"""Stdout and stderr as they come: closed, full, without a reader, or of few characters."""

import io
import logging
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from math import inf

from mdms_host.cli.exits import ExitCode
from mdms_model.log import LOG


class Output(io.TextIOWrapper):
    """Stdout that takes anything: what cannot be written is dropped, and `failure` says why.

    So a verb comes to its end, and to its own exit code, though nobody reads its output.
    """

    failure: OSError | None = None

    def write(self, text: str) -> int:
        """See `io.TextIOWrapper`."""
        try:
            return super().write(text) if self.failure is None else len(text)
        except OSError as error:
            self.failure = error
            return len(text)

    def flush(self) -> None:
        """See `io.TextIOWrapper`."""
        try:
            if self.failure is None:
                super().flush()
        except OSError as error:
            self.failure = error


#: Reports of a kind are told once in this time [s].
ALIKE_S = 1.0
#: Emergencies of cells, and cells that are back: a stop of all brings one of each cell, or two.
_REPEATED = re.compile(r"(?P<sender>cell .*?) (?P<told>(sends |clears )?emergency .*|is back)")
_AXIS = re.compile(r"\(axis \d+\)")
_NUMBER = re.compile(r"(?<![\w.])\d+(\.\d+)?(?!\w)")


class EventLines:
    """Events as lines; repeated reports that differ by cell or axis alone are counted.

    The first of a kind is told, and so is a second if no third comes. `finish` tells the rest.
    """

    def __init__(self, tell: Callable[[str], object]) -> None:
        self._tell = tell
        #: When each kind was told, how many more came since, and the last of these.
        self._told: dict[str, tuple[float, int, str]] = {}

    def add(self, time_s: float, text: str) -> None:
        """Tell of an event, or count it."""
        if (kind := _kind(text)) is None:
            self.finish()
        else:
            told_s, more, _ = self._told.get(kind, (-inf, 0, ""))
            if time_s - told_s < ALIKE_S:
                self._told[kind] = told_s, more + 1, _line(time_s, text)
                return
            self.finish()
            self._told[kind] = time_s, 0, ""
        self._tell(_line(time_s, text))

    def finish(self) -> None:
        """Tell how many more came of each kind."""
        for kind, (told_s, more, last) in self._told.items():
            if more:
                self._tell(last if more == 1 else _line(told_s, f"{more} more: {kind}"))
                self._told[kind] = told_s, 0, ""


def _line(time_s: float, text: str) -> str:
    return f"{time_s:8.3f} s  {text}"


def _kind(text: str) -> str | None:
    """A repeated report without its cell and axis; None for any other event."""
    found = _REPEATED.fullmatch(text)
    if found is None:
        return None
    told = _AXIS.sub("(axis ...)", found["told"])
    return f"{_NUMBER.sub('...', found['sender'])} {told}"


class _Said(logging.Handler):
    """Warnings of the packages as lines for people."""

    def emit(self, record: logging.LogRecord) -> None:
        """See `logging.Handler`."""
        say(f"mdms: {record.getMessage()}")


_SAID = _Said()


def open_streams() -> None:
    """Have both streams take anything; output to a closed one goes nowhere."""
    LOG.addHandler(_SAID)
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - it stays open to the end
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    # A stream of somebody else, as of a test, is left to them.
    if type(sys.stdout) is io.TextIOWrapper and sys.stdout is sys.__stdout__:
        encoding, by_line = sys.stdout.encoding, sys.stdout.line_buffering
        sys.stdout = Output(sys.stdout.detach(), encoding, "replace", line_buffering=by_line)


@contextmanager
def kept_for_json(json: bool) -> Iterator[None]:
    """Send the prints of a program to stderr, if stdout is to have one JSON object alone."""
    if not json:
        yield
        return
    with redirect_stdout(sys.stderr):
        yield


def say(message: str) -> None:
    """One line for people on stderr; where it has no room, nobody reads it.

    Names in it may come from files and other programs: what controls a terminal is spelled out.
    """
    shown = "".join(
        each if each.isprintable() or each in "\n\t" else ascii(each)[1:-1] for each in message
    )
    with suppress(OSError):
        print(shown, file=sys.stderr)


def flushed(code: int) -> int:
    """Write what stdout still holds; the exit code, or that of a failure if there was no room.

    A reader that has gone away has read all it wanted.
    """
    sys.stdout.flush()
    failure = getattr(sys.stdout, "failure", None)
    if failure is None:
        return code
    # The interpreter's own last flush must not fail.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(failure, BrokenPipeError):
        return code
    say(f"mdms: stdout cannot be written: {failure.strerror}")
    return code or ExitCode.FAILURE
