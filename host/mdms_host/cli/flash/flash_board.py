"""One board of `mdms flash`, from its port to its restart."""

from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mdms_host.cli.exits import Exit
from mdms_host.cli.flash.flash_crash import ToldCrash, read_crashes
from mdms_host.clock import MonotonicClock
from mdms_host.flashing.board_link import BoardError, BoardLink, NoBoardError
from mdms_host.flashing.board_port import BoardPort
from mdms_host.flashing.board_survey import BoardInfo, VersionError, check_suits, identify, survey
from mdms_host.flashing.flashing import Plan, carry_out, plan_flash

if TYPE_CHECKING:
    from mdms_host.flashing.board_survey import Firmware


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a board: versions of its firmware before and after, or what went wrong."""

    port: BoardPort
    info: BoardInfo | None = None
    before: str | None = None
    after: str | None = None
    plan: Plan | None = None
    crashes: tuple[ToldCrash, ...] | None = None
    duration_s: float = 0.0
    dry: bool = False
    problem: str | None = None
    code: Exit = Exit.OK

    def line(self) -> str:
        """What people are told of a board that went well."""
        if self.info is None or self.plan is None:
            return self.port.device
        head = f"{self.port.device}: {self.info.board or self.info.machine}"
        if not self.plan.written:
            return f"{head} has {self.after} already"
        files = f"{len(self.plan.written)} files, {self.plan.size / 1000:.1f} KB"
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
            "firmware": self.before,
            "wanted": self.after,
            "written": list(plan.written) if plan else [],
            "removed": list(plan.stale) if plan else [],
            "dry_run": self.dry,
            "problem": self.problem,
            **({} if self.crashes is None else {"crashes": [each.row() for each in self.crashes]}),
        }


@dataclass(frozen=True, slots=True)
class Job:
    """A board to flash: what the command line says, the firmware by kind of board, a listener."""

    port: BoardPort
    arguments: Namespace
    firmware_of: "Callable[[str], Firmware]"
    progress: Callable[[float], None]


def flash_board(job: Job) -> Outcome:
    """Look at a board, flash it unless told otherwise, and restart it.

    Raises MpremoteMissingError, ImageError; all else that fails is told by the outcome.
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
    if job.arguments.crash_log:
        return replace(outcome, crashes=read_crashes(link, info, job.arguments.board))
    firmware = job.firmware_of(_kind(info, job.arguments.board))
    check_suits(info, firmware)
    found = survey(link, firmware.files)
    plan = plan_flash(found, firmware, force=job.arguments.force)
    if plan.written and not job.arguments.dry_run:
        carry_out(link, firmware, plan, found, job.progress)
    job.progress(1.0)
    return replace(outcome, before=found.version, after=firmware.version, plan=plan)


def _kind(info: BoardInfo, told: str | None) -> str:
    """The name of the board, by what it says or by what the user says. Raises BoardError."""
    if info.board and told not in (None, info.board):
        raise BoardError(f"it says that it is {info.machine}, not {told}")
    kind = info.board or told
    if kind is None:
        raise BoardError(f"there is no firmware for {info.machine}; --board says what it is like")
    return kind


def _code(error: BoardError) -> Exit:
    if isinstance(error, NoBoardError):
        return Exit.NO_DEVICE
    return Exit.NODE_FAULT if isinstance(error, VersionError) else Exit.FAILURE
