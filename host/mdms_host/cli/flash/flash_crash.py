"""What `mdms flash --crash-log` reads from a board, and tells in the words of the sources."""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from mdms_host.flashing.board_link import BoardLink
from mdms_host.flashing.board_survey import BoardInfo

if TYPE_CHECKING:
    from mdms_host.cli.flash.flash_board import Outcome
    from mdms_image import Crash, Decoder

LOG = "crash.log"
_INTERRUPTED = "somebody took the prompt (Ctrl-C), as `mdms flash` does"
_SOURCES = "unmerged"


@dataclass(frozen=True, slots=True)
class ToldCrash:
    """One entry of the log: what wrote it, its lines as told, and whether they are the sources'."""

    version: str | None
    origin: str
    decoded: bool
    interrupted: bool
    lines: tuple[str, ...]

    def row(self) -> dict[str, object]:
        """The same for programs."""
        return {
            "image": self.version,
            "origin": self.origin,
            "decoded": self.decoded,
            "interrupted": self.interrupted,
            "lines": list(self.lines),
        }


def read_crashes(link: BoardLink, info: BoardInfo, told: str | None) -> tuple[ToldCrash, ...]:
    """The entries of a board's log, oldest first; none where there is no log.

    `told` is the kind of a board that does not say it. Raises BoardError.
    """
    from mdms_image import read_log

    if LOG not in link.ask("_files('', [])"):
        return ()
    text = link.read(f"{info.root}/{LOG}").decode("utf-8", "replace")
    kind = info.board or told
    return tuple(_told(crash, _decoder(kind) if kind else None) for crash in read_log(text))


def tell_crashes(outcome: "Outcome") -> str:
    """What people are told of a board's log."""
    crashes = outcome.crashes or ()
    info = outcome.info
    board = f"{outcome.port.device}: {info and (info.board or info.machine)}"
    if not crashes:
        return f"{board} has no error in {LOG}"
    lines = [f"{board} has {len(crashes)} in {LOG}, oldest first"]
    for number, crash in enumerate(crashes, 1):
        lines.append(f"\n{number}. {crash.origin}")
        lines += [_INTERRUPTED] if crash.interrupted else crash.lines
    return "\n".join(lines)


def _told(crash: "Crash", decoder: "Decoder | None") -> ToldCrash:
    decoded = decoder is not None and crash.version == decoder.version
    lines = crash.lines
    if decoder is not None and decoded:
        lines = tuple(decoder.decode(crash))
    return ToldCrash(crash.version, _origin(crash, decoder), decoded, crash.interrupted, lines)


def _origin(crash: "Crash", decoder: "Decoder | None") -> str:
    """What wrote an entry, and so what its names mean."""
    if crash.version is None:
        return "of unknown firmware; names as they are"
    if crash.version == _SOURCES:
        return "of the sources themselves, without an image"
    if decoder is None:
        return f"of image {crash.version}; --board says what the board is like, to tell its names"
    if crash.version != decoder.version:
        return (
            f"of image {crash.version}, which is not that of this mdms ({decoder.version}); "
            "names as they are: the mdms that flashed it tells them"
        )
    return f"of image {crash.version}, as this mdms makes it"


@cache
def _decoder(board: str) -> "Decoder":
    """Raises ImageError."""
    from mdms_image import decoder_for

    return decoder_for(board)
