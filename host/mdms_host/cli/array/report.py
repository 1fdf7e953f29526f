"""`mdms report`: a running table writes its last minute as a run folder."""

import json
import socket
from argparse import Namespace

from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.report_requests import ANSWER_S, ask, running


def run(arguments: Namespace) -> ExitCode:
    """Ask the named command, or the only one that runs, for a report; print its folder."""
    if not hasattr(socket, "AF_UNIX"):
        raise CommandError(
            "mdms report asks over a Unix socket, which this system has not; a report is written "
            "after a fault in any case",
            ExitCode.FAILURE,
        )
    process = _process(arguments.process)
    folder = None if arguments.out is None else str(arguments.out.absolute())
    answer = ask(process, {"do": "report", "folder": folder}, ANSWER_S)
    if answer is None:
        raise CommandError(f"process {process} does not answer, or has ended", ExitCode.FAILURE)
    if "error" in answer:
        raise CommandError(
            f"process {process} wrote no report: {answer['error']}", ExitCode.FAILURE
        )
    print(json.dumps(answer) if arguments.json else answer["report"])
    return ExitCode.OK


def _process(named: int | None) -> int:
    commands = running()
    if named in commands:
        return int(named or 0)
    listed = "; ".join(f"{process} ({title})" for process, title in commands.items())
    if named is not None:
        raise CommandError(
            f"process {named} is no table that writes reports; there are: {listed or 'none'}",
            ExitCode.USAGE,
        )
    if not commands:
        raise CommandError(
            "no `mdms run` or `mdms serve` of yours keeps a last minute (--log ring or all)",
            ExitCode.FAILURE,
        )
    if len(commands) > 1:
        raise CommandError(f"several tables run; name one process: {listed}", ExitCode.USAGE)
    return next(iter(commands))
