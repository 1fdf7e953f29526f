"""The questions to a person: where a cell is that blinks, how a wheel has turned; single keys.

`mdms identify` has cells blink, so that a person sees which they are.
"""

import os
import re
import select
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

from mdms_host.cli.cells.configure_cells import found_cells, refuse_failed
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.streams import say
from mdms_host.commissioning import commissioner as steps
from mdms_host.commissioning.array_file import FiledCell
from mdms_host.commissioning.network import (
    Commissioning,
    CommissioningError,
    counted,
    ranges,
)
from mdms_host.commissioning.node_ids import FoundCells
from mdms_host.commissioning.sightings import Spot
from mdms_host.commissioning.wheel_turn import REVERSED
from mdms_protocol import indices

_MS_PER_S = 1000


def identify(arguments: Namespace) -> ExitCode:
    """Have the cells blink; they end it by themselves."""
    with found_cells(arguments) as found:
        for each in found:
            for node_id in each.node_ids:
                try:
                    blink(each.commissioning, node_id, arguments.seconds)
                except CommissioningError as error:
                    each.fail(node_id, error)
            where = f"{each.bus.name}, " if each.where else ""
            print(
                f"{where}node {ranges(each.node_ids)}: both LEDs blink together for "
                f"{arguments.seconds:g} s"
            )
    refuse_failed(found, "the others blink")
    return ExitCode.OK


def blink(commissioning: Commissioning, node_id: int, seconds: float) -> None:
    """Have a cell blink for so long, 0 to end it. Raises SilentError, RefusedError."""
    commissioning.write(node_id, indices.IDENTIFY, 0, round(seconds * _MS_PER_S))


#: Longer than a person looks for a light; the answer ends it.
_BLINK_S = 60.0
#: Keys that end the dialogue.
LEAVE = ("q", "\x1b", "\x04")
#: Answers that end the dialogue, and that take the last answer back.
QUIT, UNDO = ("q", "quit"), ("u", "undo")
_NUMBER = re.compile(r"(\d+)(?:\s*[, ]\s*(\d+))?")


def ask_places(
    commissioning: Commissioning, roll: FoundCells, grid: Spot, *, again: bool
) -> dict[int, Spot]:
    """Column and row of each cell by its serial number; each is stored as soon as it is given.

    A cell that has a place of its own already keeps it, unless `again`. The last answer can be
    undone, and the one before, and so on. Raises `CommandError` when the person ends it; the
    answers so far are kept for the next time.
    """
    spots = {} if again else _stored(commissioning, roll, grid)
    if spots:
        have = counted(len(spots), "cell has its place", "cells have their places")
        say(f"{have} already (--again asks for all)")
    waiting = sorted(serial for serial in roll.serials if serial not in spots)
    answered: list[int] = []
    while waiting:
        serial = waiting[0]
        node_id = roll.node_ids[serial]
        spot = _ask(commissioning, serial, node_id, grid, spots)
        if spot is not None:
            spots[serial] = spot
            steps.tell_place(commissioning, node_id, spot)
            _echo(serial, spot, grid, len(spots))
            answered.append(waiting.pop(0))
        if spot is None or (not waiting and _undoes_last(len(spots))):
            _undo(commissioning, roll, spots, answered, waiting)
    return spots


def _echo(serial: int, spot: Spot, grid: Spot, count: int) -> None:
    columns, rows = grid
    say(
        f"  {serial:08X} is at place {_number(spot, columns)}, column {spot[0]} and row {spot[1]}: "
        f"{count} of {columns * rows}"
    )


def _undoes_last(count: int) -> bool:
    question = f"All {count} cells have their places. (Enter: go on; u: undo the last) "
    return _line(question).lower() in UNDO


def _undo(
    commissioning: Commissioning,
    roll: FoundCells,
    spots: dict[int, Spot],
    answered: list[int],
    waiting: list[int],
) -> None:
    """Take the last answer back, so that its cell is asked for next."""
    if not answered:
        say("there is no answer to undo; --again asks for all cells")
        return
    serial = answered.pop()
    del spots[serial]
    steps.forget_place(commissioning, roll.node_ids[serial])
    waiting.insert(0, serial)
    say(f"  {serial:08X} has no place any more")


def ask_directions(
    commissioning: Commissioning,
    cells: Sequence[FiledCell],
    axis: int,
    push: Callable[[], object],
) -> list[FiledCell]:
    """The cells, each with the polarity of this axis: the other one where a person says so.

    One question is for all of them. `push()` turns the wheels again. Raises `CommandError` when the
    person ends it.
    """
    node_ids = [cell.node_id for cell in cells]
    question = (
        f"node {ranges(node_ids)}, axis {axis}: did the top of each wheel move towards "
        f"+{'xy'[axis - 1]}? (Enter: each did; else the nodes that did not, as {node_ids[-1]}; "
        "r: push again; q: end) "
    )
    while True:
        answer = _line(question).lower()
        if answer in QUIT:
            raise CommandError(
                "ended; the places are kept, and the same command goes on", ExitCode.FAILURE
            )
        if answer == "r":
            push()
            continue
        backwards = _nodes_said(answer, node_ids)
        if backwards is None:
            say(f"{answer!r} names other nodes than {ranges(node_ids)}")
            continue
        if backwards:
            say(f"  node {ranges(sorted(backwards))}, axis {axis}: turned the other way round")
        return [_turned(commissioning, cell, axis, cell.node_id in backwards) for cell in cells]


def _nodes_said(answer: str, node_ids: Sequence[int]) -> set[int] | None:
    """The nodes of an answer, none for 'each did'; None for an answer that names others."""
    if answer in ("", "y", "yes"):
        return set()
    words = answer.replace(",", " ").split()
    if not all(word.isdecimal() and int(word) in node_ids for word in words):
        return None
    return set(map(int, words))


def _turned(commissioning: Commissioning, cell: FiledCell, axis: int, backwards: bool) -> FiledCell:
    parameter = steps.polarity_of(axis)
    before = cell.values.get(parameter, commissioning.read(cell.node_id, *parameter.place))
    polarity = before ^ REVERSED if backwards else before
    return replace(cell, values={**cell.values, parameter: polarity})


#: How a question shows its default.
_CHOICES = {None: "[y/n]", False: "[y/N]", True: "[Y/n]"}


def confirmed(arguments: Namespace, question: str, default: bool | None = None) -> bool:
    """Whether to go on: `--yes`, or y on a terminal; without a default Enter alone asks again.

    Raises `CommandError` without a terminal.
    """
    if arguments.yes:
        return True
    if not sys.stdin.isatty():
        raise CommandError("nobody can be asked here; say --yes", ExitCode.USAGE)
    while True:
        answer = _line(f"{question} {_CHOICES[default]} ").lower()
        if not answer and default is not None:
            return default
        if answer in ("y", "yes"):
            return True
        if answer in ("n", "no", *QUIT):
            return False
        say("answer y or n")


@contextmanager
def pressed_keys(without: str) -> Iterator[Callable[[], str]]:
    """Single keys of the terminal since the last call, without waiting.

    Raises `CommandError` with the text `without` where there is no terminal.
    """
    if not sys.stdin.isatty() or os.name != "posix":
        raise CommandError(without, ExitCode.USAGE)
    import termios
    import tty

    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)

    def pressed() -> str:
        if not select.select([descriptor], [], [], 0)[0]:
            return ""
        # The end of the input, or of the terminal, ends all as q does.
        with suppress(OSError):
            return os.read(descriptor, 64).decode("ascii", "replace") or LEAVE[0]
        return LEAVE[0]

    try:
        tty.setcbreak(descriptor)
        yield pressed
    finally:
        with suppress(termios.error):
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


class AtTerminal:
    """A person whose hands do as asked, and who says so by Enter; `pressed()` has keys."""

    def __init__(self, pressed: Callable[[], str]) -> None:
        self._pressed = pressed

    def ask(self, text: str) -> None:
        """Ask; keys that were pressed before count no more."""
        self._pressed()
        say(text)

    def answered(self) -> bool:
        """Whether Enter was pressed. Raises `CommandError` for q."""
        keys = self._pressed()
        if any(key in LEAVE for key in keys):
            raise CommandError("the test was broken off", ExitCode.FAILURE)
        return "\n" in keys or "\r" in keys


def _stored(commissioning: Commissioning, roll: FoundCells, grid: Spot) -> dict[int, Spot]:
    """The places that cells have stored, but for those beside the grid or given twice."""
    told: dict[int, Spot] = {}
    for serial, node_id in roll.node_ids.items():
        spot = steps.told_place(commissioning, node_id)
        if spot is not None and spot[0] <= grid[0] and spot[1] <= grid[1]:
            told[serial] = spot
    spots = list(told.values())
    return {serial: spot for serial, spot in told.items() if spots.count(spot) == 1}


def _ask(
    commissioning: Commissioning, serial: int, node_id: int, grid: Spot, spots: dict[int, Spot]
) -> Spot | None:
    """The place of a cell that blinks; None to undo the answer before."""
    columns, rows = grid
    taken = {*spots.values()}
    free = [(x + 1, y + 1) for y in range(rows) for x in range(columns)]
    default = next(spot for spot in free if spot not in taken)
    question = (
        f"Cell {len(spots) + 1} of {columns * rows}, {serial:08X}, blinks. Which place, 1 to "
        f"{columns * rows} along x first, or column,row? (Enter: {_number(default, columns)}; "
        "u: undo the last; q: end) "
    )
    while True:
        blink(commissioning, node_id, _BLINK_S)
        answer = _line(question)
        blink(commissioning, node_id, 0.0)
        if answer.lower() in QUIT:
            have = counted(len(spots), "cell has its place", "cells have their places")
            raise CommandError(f"{have}; the same command goes on", ExitCode.FAILURE)
        if answer.lower() in UNDO:
            return None
        spot = default if not answer else _spot(answer, columns)
        if spot is None or spot not in free:
            say(f"{answer!r} is no place of {columns} x {rows} cells")
        elif spot in taken:
            other = next(key for key, each in spots.items() if each == spot)
            say(f"{other:08X} has that place; --again begins anew")
        else:
            return spot


def _spot(answer: str, columns: int) -> Spot | None:
    match = _NUMBER.fullmatch(answer)
    if match is None:
        return None
    if match[2] is not None:
        return int(match[1]), int(match[2])
    number = int(match[1]) - 1
    return number % columns + 1, number // columns + 1


def _number(spot: Spot, columns: int) -> int:
    return (spot[1] - 1) * columns + spot[0]


def _line(question: str) -> str:
    """An answer from the terminal; the end of the input ends all."""
    print(question, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline()
    if not line:
        raise CommandError("the input has ended; the same command goes on", ExitCode.FAILURE)
    return line.strip()
