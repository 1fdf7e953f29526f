"""The command `mdms`. Only here are host and simulator put together.

Importing this is light: the modules of a verb are imported when it runs (`verbs`).
"""

from argparse import Namespace
from collections.abc import Sequence

from mdms_host.cli.exits import (
    INTERRUPTED,
    ExitCode,
    Terminated,
    ended_by_signals,
    ending_behind,
    exit_of,
    has_arrived,
    text_of,
)
from mdms_host.cli.streams import flushed, open_streams, say
from mdms_host.cli.verbs import build_parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit code; see `ExitCode`."""
    open_streams()
    with ended_by_signals():
        return flushed(_run(argv))


def _run(argv: Sequence[str] | None) -> int:
    try:
        arguments: Namespace = build_parser().parse_args(argv)
        return int(arguments.run(arguments))
    except KeyboardInterrupt as interrupt:
        return _ended_by(interrupt)
    except SystemExit as leaving:
        return leaving.code if isinstance(leaving.code, int) else ExitCode.OK
    except Exception as error:
        ending = ending_behind(error)
        if ending is not None:
            return _ended_by(ending)
        known = exit_of(error)
        if known is None:
            raise
        say(f"mdms: {text_of(error)}")
        return known


def _ended_by(interrupt: KeyboardInterrupt) -> int:
    has_arrived()
    if isinstance(interrupt, Terminated):
        say("mdms: terminated")
        return ExitCode.FAILURE
    say("mdms: interrupted")
    return INTERRUPTED
