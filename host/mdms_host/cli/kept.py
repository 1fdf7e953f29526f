"""The last minute and the log files of `run` and `serve`, by `--log` and `--log-dir`."""

import os
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from mdms_array.report import Reporter
from mdms_host.can_link.bus_log import LogWriter
from mdms_host.can_link.link import LinkCounts
from mdms_host.can_link.recent import Recent
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.log_files import LogFolder
from mdms_host.cli.options import LOGS
from mdms_host.cli.report_requests import ReportRequests
from mdms_host.cli.streams import say
from mdms_host.clock import wall_s
from mdms_host.layout import Layout
from mdms_host.programs.program import Main
from mdms_model.run.folder import BUS_LOG
from mdms_model.scenario.scenario import Scenario
from mdms_protocol.codecs.frame import Frame


def level_of(arguments: Namespace) -> str:
    """The level of `--log`: by default all frames with a run folder, else the last minute."""
    chosen: str | None = arguments.log
    return chosen or ("all" if arguments.out is not None else "ring")


def keeps_frames(arguments: Namespace) -> bool:
    """Whether a run folder gets a bus log."""
    return level_of(arguments) == "all"


def say_log_ends(folder: Path) -> Callable[[OSError], None]:
    """A function that says why the bus log of a run folder ends before its run."""

    def failed(error: OSError) -> None:
        say(f"mdms: {folder / BUS_LOG}: cannot be written: {error.strerror}; it ends here")

    return failed


def check_log(arguments: Namespace) -> None:
    """Raise `CommandError` for files that have no place."""
    if arguments.log in ("events", "all") and arguments.log_dir is None and arguments.out is None:
        raise CommandError(
            f"--log {arguments.log}: there is no place for its files; give --log-dir DIR",
            ExitCode.USAGE,
        )
    if arguments.log == "none" and arguments.log_dir is not None:
        raise CommandError("--log none keeps nothing; leave --log-dir out", ExitCode.USAGE)


def reports_folder(arguments: Namespace) -> Path:
    """Where reports are written: beside the log files, or in the user's own folder."""
    if arguments.log_dir is not None:
        return Path(arguments.log_dir).absolute()
    base = os.environ.get("XDG_STATE_HOME")
    home = Path(base) if base else Path.home() / ".local" / "state"
    return home / "mdms-array" / "reports"


class _Logged(Recent):
    """The last minute, and all frames in files."""

    def __init__(self, buses: int, writer: LogWriter) -> None:
        super().__init__(buses)
        self._writer = writer

    def on_received(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """See `Recent`."""
        super().on_received(frame, now_s, bus)
        self._writer.on_frame(frame, now_s, bus)

    def on_sent(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """See `Recent`."""
        super().on_sent(frame, now_s, bus)
        self._writer.on_frame(frame, now_s, bus, sent=True)


class Kept:
    """The last minute in memory (`recent`, None without), log files, and reports.

    The driver of the table calls `attend` as often as it can. Nothing of it waits but `close`.
    """

    def __init__(
        self,
        scenario: Scenario,
        layout: Layout,
        arguments: Namespace,
        *,
        main: Main | None = None,
        array_file: Path | None = None,
    ) -> None:
        level = LOGS.index(level_of(arguments))
        self.recent: Recent | None = None
        #: The counts of the link, once there is one.
        self.counts: Callable[[], LinkCounts | None] = lambda: None
        self._files: LogFolder | None = None
        self._reporter: Reporter | None = None
        self._requests: ReportRequests | None = None
        self._reopens = False
        self._now_s = 0.0
        if arguments.log_dir is not None and level >= LOGS.index("events"):
            self._files = LogFolder(arguments.log_dir, say)
        if level >= LOGS.index("ring"):
            self.recent = self._recent(layout.bus_count, level == LOGS.index("all"))
            self._reporter = Reporter(
                self.recent,
                (scenario, main),
                layout,
                reports_folder(arguments),
                lambda text: say(f"mdms: {text}"),
                array_file=array_file,
            )
            self._reporter.counts = self._counted
            self._requests = ReportRequests(scenario.title)

    def _recent(self, buses: int, all_frames: bool) -> Recent:
        if self._files is None or not all_frames:
            return Recent(buses)
        writer = LogWriter(self._files.frames, buses, directions=True, start_s=wall_s())
        return _Logged(buses, writer)

    @property
    def on_hangup(self) -> Callable[[], object] | None:
        """The reaction of a service to SIGHUP; None where there are no files to open again."""
        return None if self._files is None else self._ask_reopen

    def run_by(
        self, jobs: Mapping[str, tuple[Scenario, Main | None]], running: Callable[[], str]
    ) -> None:
        """Have reports name the job that runs: one of these, by name."""
        if self._reporter is not None:
            self._reporter.run_by(jobs, running)

    def _counted(self) -> LinkCounts | None:
        return self.counts()

    def _ask_reopen(self) -> None:
        self._reopens = True

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Something has happened."""
        if self.recent is not None:
            self.recent.note(time_s, kind, text)
        if self._files is not None:
            self._files.event(time_s, kind, text)

    def after_fault(self, now_s: float, reason: str) -> None:
        """The table has a fault, or was aborted: a report is due."""
        if self._reporter is not None:
            self._reporter.after_fault(now_s, reason)

    def attend(self, now_s: float) -> None:
        """Carry out requests, write reports that are due, open files again where asked to."""
        self._now_s = now_s
        if self._reopens and self._files is not None:
            self._reopens = False
            self._files.reopen()
        if self._reporter is None or self._requests is None:
            return
        for request in self._requests.take():
            self._reporter.begin(now_s, "on request", request.folder, request.done)
        self._reporter.attend(now_s)

    def close(self) -> None:
        """Write the reports that are due, and close all files."""
        try:
            if self._requests is not None:
                self._requests.close()
            if self._reporter is not None:
                self._reporter.close(self._now_s)
        finally:
            if self._files is not None:
                self._files.close()


@contextmanager
def keeping(
    scenario: Scenario,
    layout: Layout,
    arguments: Namespace,
    *,
    main: Main | None = None,
    array_file: Path | None = None,
) -> Iterator[Kept]:
    """Keep the last minute, log files and reports while a command runs. Raises `CommandError`."""
    kept = Kept(scenario, layout, arguments, main=main, array_file=array_file)
    try:
        yield kept
    finally:
        kept.close()
