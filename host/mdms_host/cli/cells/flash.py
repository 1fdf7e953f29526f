"""`mdms flash`: firmware onto boards over USB, each from its port to its restart."""

import json
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING

from mdms_host.cli.cells import flash_bus
from mdms_host.cli.console import bars, show
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.options import add_json
from mdms_host.cli.streams import say
from mdms_host.clock import MonotonicClock
from mdms_host.flashing.board_link import BoardError, BoardLink, BoardPort, NoBoardError
from mdms_host.flashing.board_survey import MACHINES, BoardInfo, identify, survey
from mdms_host.flashing.firmware import START, Firmware
from mdms_host.flashing.flashing import FlashPlan, VersionError, carry_out, firmware_for, plan_flash
from mdms_protocol.version import VERSION

if TYPE_CHECKING:
    from mdms_host.flashing.board_link import BoardPort
    from mdms_host.flashing.firmware import Firmware


@dataclass(frozen=True, slots=True)
class FlashOutcome:
    """The result of a board: versions of its firmware before and after, or what went wrong."""

    port: BoardPort
    info: BoardInfo | None = None
    before: str | None = None
    after: str | None = None
    plan: FlashPlan | None = None
    duration_s: float = 0.0
    dry: bool = False
    problem: str | None = None
    code: ExitCode = ExitCode.OK

    @property
    def standing(self) -> str:
        """The version of the firmware before, and how it compares with this host's."""
        if self.before is None:
            return "none"
        return f"{self.before} ({_compared(self.before)})"

    def line(self) -> str:
        """The message about a board that went well."""
        if self.info is None or self.plan is None:
            return self.port.device
        head = f"{self.port.device}: {self.info.board or self.info.machine}"
        if self.plan == FlashPlan():
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
class FlashJob:
    """A board to flash, the command line, what compiles for it, and a listener."""

    port: BoardPort
    arguments: Namespace
    compiled: Callable[[str], Firmware]
    progress: Callable[[float], None]


def flash_board(job: FlashJob) -> FlashOutcome:
    """Look at a board, flash it unless told otherwise, and restart it.

    Raises MpremoteMissingError, FirmwareError; all else that fails is told by the outcome.
    """
    clock = MonotonicClock()
    outcome = FlashOutcome(job.port, dry=job.arguments.dry_run)
    try:
        with BoardLink(job.port.device, clock) as link:
            try:
                info = identify(link)
                outcome = _flash_files(job, link, info, replace(outcome, info=info))
            finally:
                link.restart()
    except BoardError as error:
        return replace(outcome, problem=str(error), code=_code(error))
    return replace(outcome, duration_s=clock.now_s())


def _flash_files(
    job: FlashJob, link: BoardLink, info: BoardInfo, outcome: FlashOutcome
) -> FlashOutcome:
    if job.arguments.list:
        return replace(outcome, before=survey(link).version)
    _check_known(info, job.arguments.board)
    firmware = firmware_for(info, job.compiled)
    found = survey(link, firmware)
    if not job.arguments.ports and START in found.hashes and ADAPTER in link.read(START):
        return replace(outcome, before=found.version, problem=STAYS)
    plan = plan_flash(found, firmware, force=job.arguments.force)
    if plan != FlashPlan() and not job.arguments.dry_run:
        carry_out(link, firmware, plan, found, job.progress)
    job.progress(1.0)
    return replace(outcome, before=found.version, after=firmware.version, plan=plan)


def _check_known(info: BoardInfo, told: str | None) -> None:
    """Raises BoardError without firmware for the board, by its own report or by the user's."""
    if info.board and told not in (None, info.board):
        raise BoardError(f"it says that it is {info.machine}, not {told}")
    if info.board is None and told is None:
        raise BoardError(f"there is no firmware for {info.machine}; --board names a board like it")


def _compared(version: str) -> str:
    """A version beside this host's: as here, older, newer, or other where it is no number."""
    if version == VERSION:
        return "as here"
    try:
        theirs, ours = (tuple(map(int, each.split("."))) for each in (version, VERSION))
    except ValueError:
        return f"other than {VERSION} here"
    return f"{'older' if theirs < ours else 'newer'} than {VERSION} here"


def _code(error: BoardError) -> ExitCode:
    if isinstance(error, NoBoardError):
        return ExitCode.NO_DEVICE
    return ExitCode.NODE_FAULT if isinstance(error, VersionError) else ExitCode.FAILURE


JOBS = 8
#: What `adapter_main.py` begins with, of any version.
ADAPTER = b"Makes the board an SLCAN adapter"
STAYS = "it is a CAN adapter, and stays one; --port makes a cell of it"
NOBODY = (
    "no board is connected over USB (with MicroPython; docs/boards.md lists those that suit); "
    "--port names one that is not recognised, and `mdms serve array18` starts an array without any"
)
EPILOG = """\
The firmware that runs on a board is ended, which cuts its motors, and is started again at the end.
Settings and crash.log stay. An interrupted board does not start; flash it again.
Modules go into the ROMFS of a board that has one, else into its file system; a board with too
little memory for them needs a MicroPython that has them frozen in (firmware/FREEZING.md).
"""


def add_options(parser: ArgumentParser) -> None:
    """Those of `flash`."""
    parser.epilog = EPILOG
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--port",
        metavar="PORT",
        nargs="+",
        default=[],
        dest="ports",
        help="serial ports, or id: and a USB serial number",
    )
    which.add_argument("--all", action="store_true", help="all boards that are found")
    which.add_argument(
        "--bus", action="store_true", help="all cells on the CAN bus, if their boards have room"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--list", action="store_true", help="only show the boards, and restart them")
    what.add_argument("--dry-run", action="store_true", help="only print what would be written")
    parser.add_argument("--force", action="store_true", help="write every file, changed or not")
    parser.add_argument(
        "--board",
        choices=tuple(MACHINES.values()),
        help="the kind of an unnamed board",
    )
    parser.add_argument(
        "--jobs", metavar="N", type=_jobs, default=JOBS, help=f"boards at once (default {JOBS})"
    )
    add_json(parser)
    flash_bus.add_options(parser)


def run(arguments: Namespace) -> ExitCode:
    """Flash the boards at once, with a line for each as it is done."""
    if arguments.bus:
        return flash_bus.run(arguments)
    flash_bus.refuse_options(arguments)
    with _telling_of_missing_packages():
        outcomes = _flash(arguments, _chosen(arguments))
    if arguments.json:
        print(json.dumps({"boards": [outcome.row() for outcome in outcomes]}))
    elif arguments.list:
        _show(outcomes)
    failed = [outcome for outcome in outcomes if outcome.code is not ExitCode.OK]
    if failed and len(outcomes) > 1:
        names = ", ".join(outcome.port.device for outcome in failed)
        raise CommandError(
            f"{len(failed)} of {len(outcomes)} boards failed: {names}", failed[0].code
        )
    return failed[0].code if failed else ExitCode.OK


def _chosen(arguments: Namespace) -> "list[BoardPort]":
    """The ports to flash. Raises `CommandError` when there are none, or too many to guess."""
    from mdms_host.flashing.board_link import NoPortError, board_ports, list_ports, named_port

    ports = list_ports()
    if arguments.ports:
        try:
            return list(dict.fromkeys(named_port(name, ports) for name in arguments.ports))
        except NoPortError as error:
            raise CommandError(str(error), ExitCode.NO_DEVICE) from None
    found = board_ports(ports)
    if not found:
        raise CommandError(NOBODY, ExitCode.NO_DEVICE)
    if len(found) > 1 and not (arguments.all or arguments.list):
        names = ", ".join(port.device for port in found)
        raise CommandError(
            f"{len(found)} boards: {names}; name them with --port, or --all", ExitCode.USAGE
        )
    return found


def _flash(arguments: Namespace, ports: "Sequence[BoardPort]") -> "list[FlashOutcome]":
    """The results of the boards, in the order of the ports, each told as soon as it is there."""
    from concurrent.futures import ThreadPoolExecutor

    from mdms_host.flashing.firmware import compiler

    if not arguments.list:
        # A missing extra is told before any board is touched.
        compiler()
    devices = [port.device for port in ports]
    with bars(devices) as share, ThreadPoolExecutor(arguments.jobs) as pool:
        compiled = _Compiled()
        jobs = (FlashJob(port, arguments, compiled, partial(share, port.device)) for port in ports)
        try:
            return list(pool.map(_flashed, jobs))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            say(
                "mdms: boards that have begun are finished first; Ctrl-C again breaks them off, "
                "and they do not start then"
            )
            raise


def _flashed(job: FlashJob) -> FlashOutcome:
    outcome = flash_board(job)
    _tell(outcome, job.arguments)
    return outcome


class _Compiled:
    """The firmware for each architecture, compiled when it is first asked for, by any thread."""

    def __init__(self) -> None:
        self._made: dict[str, Firmware] = {}
        self._lock = Lock()

    def __call__(self, architecture: str) -> "Firmware":
        """Raises FirmwareError."""
        from mdms_host.flashing.firmware import compiled_firmware

        with self._lock:
            if architecture not in self._made:
                self._made[architecture] = compiled_firmware(architecture)
            return self._made[architecture]


def _tell(outcome: "FlashOutcome", arguments: Namespace) -> None:
    if outcome.problem:
        say(f"mdms: {outcome.port.device}: {outcome.problem}")
    elif not (arguments.json or arguments.list):
        print(outcome.line(), flush=True)


def _show(outcomes: "Sequence[FlashOutcome]") -> None:
    from rich.table import Table

    table = Table("port", "board", "serial", "firmware", "MicroPython", "chip", "USB serial")
    for outcome in outcomes:
        if outcome.info is not None:
            info = outcome.info
            table.add_row(
                outcome.port.device,
                info.board or info.machine,
                info.serial or "",
                outcome.standing,
                info.release,
                info.chip,
                outcome.port.usb_serial or "",
            )
    if table.row_count:
        show(table)


@contextmanager
def _telling_of_missing_packages() -> Iterator[None]:
    """Turns packages that are not installed into a `CommandError` (failure)."""
    from mdms_host.flashing.board_link import MpremoteMissingError
    from mdms_host.flashing.firmware import FirmwareError

    try:
        yield
    except (MpremoteMissingError, FirmwareError) as error:
        raise CommandError(str(error), ExitCode.FAILURE) from None


def _jobs(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text} is not 1 or more")
    return int(text)
