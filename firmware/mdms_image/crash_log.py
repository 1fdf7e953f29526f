"""What a board wrote into `crash.log`, in the words of the sources.

An image keeps no line numbers and has short names, which classes share. But each function of a
traceback is called by the one before it. That tells most names for sure, and the line of every
call that its function makes in one place only.
"""

import ast
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mdms_image.compiler import ImageError
from mdms_image.image import BOARDS, merged
from mdms_image.merge import Merged
from mdms_image.origin import Function, Origins, Place, own_parts, place_of, spelled

_FRAME = re.compile(r'  File "(?P<file>[^"]*)", line \d+, in (?P<name>\S+)')
_HEADER = re.compile(r"mdms (?P<version>\S+)")
_QUOTED = re.compile(r"'(\w+)'")


@dataclass(frozen=True, slots=True)
class Crash:
    """One entry: the version of the image that wrote it, if it says, and the traceback's lines."""

    version: str | None
    lines: tuple[str, ...]

    @property
    def interrupted(self) -> bool:
        """Whether it was but somebody who wanted the prompt."""
        return bool(self.lines) and self.lines[-1].startswith("KeyboardInterrupt")


def read_log(text: str) -> list[Crash]:
    """The entries of a log, oldest first."""
    found: list[tuple[str | None, list[str]]] = []
    headed = False
    for line in text.splitlines():
        header = _HEADER.fullmatch(line)
        if header:
            found.append((header["version"], []))
        elif not found or (line.startswith("Traceback ") and not headed):
            found.append((None, [line]))
        else:
            found[-1][1].append(line)
        headed = header is not None
    return [Crash(version, tuple(lines)) for version, lines in found]


class Decoder:
    """Tells tracebacks of the image that is made of these merged sources; `version` names it."""

    def __init__(self, merged: Merged) -> None:
        self.version = merged.version
        self._origins = Origins(merged.bodies)

    def decode(self, crash: Crash) -> list[str]:
        """The lines in the words of the sources; what is not of the image stays as it is."""
        layers = [self._functions(line) for line in crash.lines]
        self._narrow(layers)
        made: list[str] = []
        for at, line in enumerate(crash.lines):
            if layers[at]:
                following = layers[at + 1] if at + 1 < len(layers) else []
                made += self._frame(layers[at], following, crash.lines[-1])
            else:
                made.append(self._in_words(line, layers[at - 1] if at else []))
        return made

    def _functions(self, line: str) -> list[Function]:
        """What may be meant by a frame; nothing by any other line."""
        frame = _FRAME.fullmatch(line)
        if frame is None:
            return []
        return self._origins.functions.get((frame["file"], frame["name"]), [])

    def _narrow(self, layers: list[list[Function]]) -> None:
        """Keep what the frame before may call, and then what may call the frame after.

        The first frame is that of `main`, which catches the error and writes the log.
        """
        sites = self._origins.sites
        for at, layer in enumerate(layers):
            if layer:
                layers[at] = [each for each in layer if each.place.module == "main"] or layer
                break
        for at in range(1, len(layers)):
            callers = layers[at - 1]
            linked = [each for each in layers[at] if any(sites(one, each) for one in callers)]
            layers[at] = linked or layers[at]
        for at in reversed(range(len(layers) - 1)):
            called = layers[at + 1]
            linked = [each for each in layers[at] if any(sites(each, one) for one in called)]
            layers[at] = linked or layers[at]

    def _frame(self, layer: list[Function], following: list[Function], error: str) -> Iterator[str]:
        """The lines for a frame, one for each function that it may be."""
        told: dict[str, None] = {}
        for function in layer:
            places = {place for each in following for place in self._origins.sites(function, each)}
            if not following:
                places = self._raised(function, error)
            place = places.pop() if len(places) == 1 else None
            told[_told(function, place)] = None
        for number, text in enumerate(told):
            yield f"    or {text}" if number else f"  {text}"

    def _raised(self, function: Function, error: str) -> set[Place | None]:
        """Where a function raises this error itself, if that is sure."""
        kind, _, message = error.partition(": ")
        found = set()
        for part in own_parts(function.node):
            if not isinstance(part, ast.Raise) or not isinstance(part.exc, ast.Call):
                continue
            said = [each.value for each in part.exc.args if isinstance(each, ast.Constant)]
            ours = isinstance(part.exc.func, ast.Name) and part.exc.func.id == kind
            if ours and (kind in self._origins.classes or said == [message]):
                found.add(place_of(part))
        return found

    def _in_words(self, line: str, layer: Sequence[Function]) -> str:
        """A line that is no frame, as that of the error, with the sources' names."""
        classes = self._origins.classes
        kind, _, rest = line.partition(":")
        if kind in classes:
            line = f"{_either(classes[kind])}:{rest}"

        def words(match: re.Match[str]) -> str:
            meant = _spellings(match[1], layer) or classes.get(match[1], set())
            return f"'{_either(meant)}'" if meant else match[0]

        return _QUOTED.sub(words, line)


def decoder_for(board: str) -> Decoder:
    """What tells tracebacks of a board's image, if that is made of these sources.

    Raises ImageError for an unknown board.
    """
    if board not in BOARDS:
        raise ImageError(f"there is no board {board!r}; there are {', '.join(BOARDS)}")
    return Decoder(merged(board, emits=True))


def _told(function: Function, place: Place | None) -> str:
    own = function.place
    within = ""
    if place is None:
        place = own
    elif place.function != own.function:
        within = f", within {own.function}"
    lines = f"line {place.line}"
    if place.last_line > place.line and place is own:
        lines = f"lines {place.line}-{place.last_line}"
    path = place.module.replace(".", "/")
    return f'File "{path}.py", {lines}, in {place.function}{within}'


def _spellings(name: str, layer: Sequence[Function]) -> set[str]:
    """What a short name may mean in these functions."""
    return {
        str(spelled(part)).rpartition(".")[2]
        for function in layer
        for part in own_parts(function.node)
        if name in (getattr(part, "attr", None), getattr(part, "id", None)) and spelled(part)
    }


def _either(names: set[str]) -> str:
    return " or ".join(sorted(names))
