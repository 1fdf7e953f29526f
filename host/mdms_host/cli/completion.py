"""`mdms completion SHELL`: a script that has a shell complete verbs, options and files."""

from argparse import Action, Namespace, _SubParsersAction
from collections.abc import Iterator
from pathlib import Path

import shtab

from mdms_host.cli.exits import Exit
from mdms_host.cli.parser import Parser


def run(arguments: Namespace) -> Exit:
    """Print the script; nothing is installed."""
    from mdms_host.cli.verbs import build_parser  # noqa: PLC0415 - the table names this module

    parser = build_parser()
    for each in _parsers(parser):
        each.add_late_options()
        for action in each._actions:
            _complete(action)
    print(shtab.complete(parser, shell=arguments.shell), end="")
    return Exit.OK


def _parsers(parser: Parser) -> Iterator[Parser]:
    """A parser and those of all its verbs."""
    yield parser
    for action in parser._actions:
        if isinstance(action, _SubParsersAction):
            for own in action.choices.values():
                yield from _parsers(own)


def _complete(action: Action) -> None:
    """Where a path is wanted files are completed; scenarios may be files."""
    if action.type is Path or action.metavar == "SCENARIO":
        action.complete = shtab.FILE  # type: ignore[attr-defined]
