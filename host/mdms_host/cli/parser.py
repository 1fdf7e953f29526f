"""The command line: which verbs there are and what they share."""

from argparse import Action, ArgumentParser
from collections.abc import Callable
from typing import Any, NoReturn

from mdms_host.cli.array import replay, run, scan, status, stop
from mdms_host.cli.configure import options as configure
from mdms_host.cli.exits import Exit
from mdms_host.cli.flash import flash
from mdms_host.cli.scenario import limits, map, scenarios
from mdms_host.cli.simulation import demo, export, plot, serve, simulate

VERBS = (
    demo,
    simulate,
    scenarios,
    limits,
    map,
    plot,
    export,
    serve,
    run,
    scan,
    status,
    stop,
    flash,
    configure,
    replay,
)
DESCRIPTION = "Modular distributed manipulator: simulate, run and look after an array of cells."
EPILOG = """\
Results go to stdout, messages to stderr. Exit codes: 0 ok, 1 failure, 2 usage or bad input,
3 time limit, 4 no bus or device, 5 node fault or protocol mismatch.
"""


class Parser(ArgumentParser):
    """An argument parser that complains in one line.

    `late` adds the options that are costly to know; it is called when this parser is used.
    """

    def __init__(
        self, *args: Any, late: Callable[[ArgumentParser], None] | None = None, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self._late = late

    def parse_known_args(self, *args: Any, **kwargs: Any) -> Any:
        """See `ArgumentParser`."""
        late, self._late = self._late, None
        if late is not None:
            late(self)
        return super().parse_known_args(*args, **kwargs)

    def error(self, message: str) -> NoReturn:
        """End with the exit code for bad usage."""
        self.exit(Exit.USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")


class _ShowVersion(Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: ArgumentParser, *_: Any) -> NoReturn:
        from importlib.metadata import version

        print(version("mdms-array"))
        parser.exit()


def build_parser() -> Parser:
    """The parser of all verbs; each stores its function under `run`."""
    parser = Parser(prog="mdms", description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="print the version")
    verbs = parser.add_subparsers(title="verbs", metavar="VERB", required=True)
    for verb in VERBS:
        verb.add_to(verbs)
    return parser
