"""One board of `mdms flash`, from its port to its restart."""

from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, replace

from mdms_host.cli.exits import Exit
from mdms_host.clock import MonotonicClock
from mdms_host.flashing.board_link import BoardError, BoardLink, BoardPort, NoBoardError
from mdms_host.flashing.board_survey import BoardInfo, identify, survey
from mdms_host.flashing.firmware import Firmware
from mdms_host.flashing.flashing import Plan, VersionError, carry_out, firmware_for, plan_flash
from mdms_protocol.version import VERSION


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a board: versions of its firmware before and after, or what went wrong."""

    port: BoardPort
    info: BoardInfo | None = None
    before: str | None = None
    after: str | None = None
    plan: Plan | None = None
    duration_s: float = 0.0
    dry: bool = False
    problem: str | None = None
    code: Exit = Exit.OK

    @property
    def standing(self) -> str:
        """The version of the firmware before, and how it compares with this host's."""
        if self.before is None:
            return "none"
        return f"{self.before} ({_compared(self.before)})"

    def line(self) -> str:
        """What people are told of a board that went well."""
        if self.info is None or self.plan is None:
            return self.port.device
        head = f"{self.port.device}: {self.info.board or self.info.machine}"
        if self.plan == Plan():
            return f"{head} has {self.after} already"
        count = "1 file" if len(self.plan.written) == 1 else f"{len(self.plan.written)} files"
        image = " and a ROMFS image" if self.plan.rom else ""
        files = f"{count}{image}, {self.plan.size / 1000:.1f} KB"
        change = f"{self.before or 'no firmware'} -> {self.after}"
        stale = f", {len(self.plan.stale)} stale files removed" if self.plan.stale else ""
        if self.dry:
            return f"{head}, {change}: would write {files}{stale.replace('removed', 'to remove')}"
        return f"{head}, {change}: {files} written and verified{stale} in {self.duration_s:.1f} s"

    def row(self) -> dict[str, object]:
        """The same for programs."""
        info, plan = self.info, self.plan
        return {
            "port": self.port.device,
            "usb_serial": self.port.usb_serial,
            "board": info and info.board,
            "machine": info and info.machine,
            "micropython": info and info.release,
            "chip": info and info.chip,
            "serial": info and info.serial,
            "firmware": self.before,
            "wanted": self.after,
            "frozen": info and info.frozen,
            "written": list(plan.written) if plan else [],
            "romfs": bool(plan and plan.rom),
            "removed": list(plan.stale) if plan else [],
            "dry_run": self.dry,
            "problem": self.problem,
        }


@dataclass(frozen=True, slots=True)
class Job:
    """A board to flash, the command line, what compiles for it, and a listener."""

    port: BoardPort
    arguments: Namespace
    compiled: Callable[[str], Firmware]
    progress: Callable[[float], None]


def flash_board(job: Job) -> Outcome:
    """Look at a board, flash it unless told otherwise, and restart it.

    Raises MpremoteMissingError, FirmwareError; all else that fails is told by the outcome.
    """
    clock = MonotonicClock()
    outcome = Outcome(job.port, dry=job.arguments.dry_run)
    try:
        with BoardLink(job.port.device, clock) as link:
            try:
                info = identify(link)
                outcome = _flash(job, link, info, replace(outcome, info=info))
            finally:
                link.restart()
    except BoardError as error:
        return replace(outcome, problem=str(error), code=_code(error))
    return replace(outcome, duration_s=clock.now_s())


def _flash(job: Job, link: BoardLink, info: BoardInfo, outcome: Outcome) -> Outcome:
    if job.arguments.list:
        return replace(outcome, before=survey(link).version)
    _check_known(info, job.arguments.board)
    firmware = firmware_for(info, job.compiled)
    found = survey(link, firmware)
    plan = plan_flash(found, firmware, force=job.arguments.force)
    if plan != Plan() and not job.arguments.dry_run:
        carry_out(link, firmware, plan, found, job.progress)
    job.progress(1.0)
    return replace(outcome, before=found.version, after=firmware.version, plan=plan)


def _check_known(info: BoardInfo, told: str | None) -> None:
    """Raises BoardError unless there is firmware for what the board says it is, or the user."""
    if info.board and told not in (None, info.board):
        raise BoardError(f"it says that it is {info.machine}, not {told}")
    if info.board is None and told is None:
        raise BoardError(f"there is no firmware for {info.machine}; --board says what it is like")


def _compared(version: str) -> str:
    """A version beside this host's: as here, older, newer, or other where it is no number."""
    if version == VERSION:
        return "as here"
    try:
        theirs, ours = (tuple(map(int, each.split("."))) for each in (version, VERSION))
    except ValueError:
        return f"other than {VERSION} here"
    return f"{'older' if theirs < ours else 'newer'} than {VERSION} here"


def _code(error: BoardError) -> Exit:
    if isinstance(error, NoBoardError):
        return Exit.NO_DEVICE
    return Exit.NODE_FAULT if isinstance(error, VersionError) else Exit.FAILURE
